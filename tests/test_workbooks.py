"""Workbooks and MATLAB files are read as text is: layouts of the trade, choice of sheet or loop, refusals."""

from __future__ import annotations

import io
import json
import sys

import numpy as np
import pytest
from commands import run
from historian_files import ROWS, comma, record, wide
from workbook_files import Formula, compound, ods, xls, xlsx

from stictionid.errors import DataError, UsageError
from stictionid.historian import ReadOptions, loops_in, read

pytest.importorskip("python_calamine")
scipy_io = pytest.importorskip("scipy.io")

R = record()
OTHER = record(level=70.0, seed=9)
NAMES = ["timestamp", "FIC101.SP", "FIC101.PV", "FIC101.OP"]


def rows(r=R, names=NAMES, above=(), stamp=lambda t: t):
    return [*map(list, above), list(names), *([stamp(t), float(a), float(b), float(c)]
                                              for t, a, b, c in zip(r.stamps, r.sp, r.pv, r.op, strict=True))]


def mat(**content) -> bytes:
    sink = io.BytesIO()
    scipy_io.savemat(sink, content, do_compression=True)
    return sink.getvalue()


def vectors(r=R, **more):
    return {"SP": r.numbers("sp"), "PV": r.numbers("pv"), "OP": r.numbers("op")} | more


def isdb() -> bytes:
    """A file of the structure of the International Stiction Data Base, with two loops."""
    loops = {f"loop{k}": vectors(r, t=np.arange(ROWS, dtype=float), Ts=1.0, Comments="Flow control loop", Type=0.0)
             for k, r in ((1, R), (2, OTHER))}
    return mat(cdata={"chemicals": {"loop1": loops["loop1"]}, "power": {"loop2": loops["loop2"]}})


def _read(tmp_path, content, **options):
    path = tmp_path / "export.dat"
    path.write_bytes(content)
    return read(path, options=ReadOptions(**options))


def _same(reading, r=R):
    loop = reading.loop
    np.testing.assert_array_equal(loop.process_value, r.numbers("pv"))
    np.testing.assert_array_equal(loop.output, r.numbers("op"))
    np.testing.assert_array_equal(loop.setpoint, r.numbers("sp"))
    assert loop.step_s == pytest.approx(1.0, abs=1e-9)
    assert loop.used.all() and loop.starts == (0,)
    assert reading.rows["in"] == sum(v for k, v in reading.rows.items() if k != "in")


def _datalink() -> list[list]:
    """The layout of PI DataLink's compressed data: a time and a value column for each tag, tags above."""
    lines = [["FIC101.SP", None, "FIC101.PV", None, "FIC101.OP", None]]
    for t, a, b, c in zip(R.stamps, R.sp, R.pv, R.op, strict=True):
        lines.append([t, float(a), t, float(b), t, float(c)])
    return lines


def _sampled() -> list[list]:
    """The layout of PI DataLink's sampled data: tag, start, end and interval above the values."""
    head = [["PI DataLink, sampled data"], ["Start", R.stamps[0]], ["End", R.stamps[-1]], ["Interval", "1s"], []]
    return rows(above=head)


SAME = {
    "xlsx": xlsx({"Sheet1": rows()}),
    "ods": ods({"Sheet1": rows()}),
    "xls": xls({"Sheet1": rows()}),
    "merged title": xlsx({"Sheet1": rows(above=[["Trend of loop FIC101, area 3"], []])}, {"Sheet1": ["A1:D1"]}),
    "merged title in xls and units": xls({"Sheet1": rows(above=[["Trend of loop 101"]], )}),
    "group above names": xlsx({"Sheet1": rows(names=["time", "SP", "PV", "OP"], above=[[None, "FIC101", None, None]])},
                              {"Sheet1": ["B1:D1"]}),
    "second column on": xlsx({"Sheet1": [[], *([None, *row] for row in rows())]}),
    "units row": ods({"Sheet1": [NAMES, [None, "m3/h", "m3/h", "%"], *rows()[1:]]}),
    "numbers as text, decimal commas": xlsx(
        {"Sheet1": [NAMES, *([t, comma(a), comma(b), float(c)] for t, a, b, c in zip(R.stamps, R.sp, R.pv, R.op,
                                                                                  strict=True))]}),
    "stamps as text": ods({"Sheet1": rows(stamp=lambda t: t.strftime("%d.%m.%Y %H:%M:%S"))}),
    "paired, datalink": xlsx({"Sheet1": _datalink()}),
    "sampled, datalink": xlsx({"Sheet1": _sampled()}),
    "a cover and an empty sheet": xlsx({"Cover": [["Export of area 3"], ["by the historian"]], "Empty": [],
                                        "Data": rows()}),
    "a list of tags": xlsx({"Tags": [["tag", "unit"], ["FIC101.PV", "m3/h"], ["FIC101.OP", "%"]], "Data": rows()}),
    "mat with vectors": mat(**vectors(t=np.arange(ROWS, dtype=float))),
    "mat with columns and a step": mat(Ts=1.0, **{k: v[:, None] for k, v in vectors().items()}),
    "mat with datenum": mat(**vectors(time=739403.0 + np.arange(ROWS) / 86400.0)),
    "mat of version 4": b"",
    "mat with a struct": mat(data=vectors(t=np.arange(ROWS, dtype=float)), note="from area 3"),
}
_v4 = io.BytesIO()
scipy_io.savemat(_v4, vectors(t=np.arange(ROWS, dtype=float)), format="4")
SAME["mat of version 4"] = _v4.getvalue()


@pytest.mark.parametrize("name", SAME)
def test_reads_the_same_arrays_as_text(tmp_path, name):
    _same(_read(tmp_path, SAME[name]))


def test_a_bad_cell_is_booked_as_in_text(tmp_path):
    lines = rows()
    lines[10][2] = "Bad Input"
    reading = _read(tmp_path, xlsx({"Sheet1": lines}))
    text = _read(tmp_path, wide(R).replace(f"{R.pv[9]},{R.op[9]}", f"Bad Input,{R.op[9]}").encode())
    assert reading.rows == text.rows and reading.rows["filled"] == 1
    np.testing.assert_array_equal(reading.loop.process_value, text.loop.process_value)


TWO = {"xlsx": xlsx({"FIC101": rows(), "TIC 7": rows(OTHER, ["time", "SP", "PV", "OP"])}), "mat": isdb()}


@pytest.mark.parametrize("kind, names, wanted", [("xlsx", ("FIC101", "TIC 7"), ("fic101", "TIC 7")),
                                                 ("mat", ("chemicals.loop1", "power.loop2"), ("loop1", "power.loop2"))])
def test_loop_names_the_sheet_or_the_struct(tmp_path, kind, names, wanted):
    with pytest.raises(UsageError, match=rf"2 loops in 2 .*{names[1]}") as error:
        _read(tmp_path, TWO[kind])
    assert f"--loop {names[0]}" in error.value.hint
    assert loops_in(tmp_path / "export.dat") == names
    for name, one, full in zip(wanted, (R, OTHER), names, strict=True):
        reading = _read(tmp_path, TWO[kind], loop=name)
        _same(reading, one)
        assert reading.loop.name in (full, "FIC101")
    with pytest.raises(UsageError, match="no loop or"):
        _read(tmp_path, TWO[kind], loop="loop9")


def test_two_loops_in_one_sheet_are_named_and_chosen(tmp_path):
    both = [[t, *map(float, (a, b, c, d, e))] for t, a, b, c, d, e in
            zip(R.stamps, R.pv, R.op, R.sp, OTHER.pv, OTHER.op, strict=True)]
    one = [["time", "FIC101.PV", "FIC101.OP", "FIC101.SP", "FIC102.PV", "FIC102.OP"], *both]
    grouped = [[None, "FIC101", None, None, "FIC102"], ["time", "PV", "OP", "SP", "PV", "OP"], *both]
    for content in (xlsx({"Sheet1": one}), xlsx({"Sheet1": grouped}, {"Sheet1": ["B1:D1", "E1:F1"]})):
        with pytest.raises(UsageError, match="holds 2 loops: FIC101, FIC102") as error:
            _read(tmp_path, content)
        assert "--loop FIC101" in error.value.hint
        _same(_read(tmp_path, content, loop="FIC101"))
        np.testing.assert_array_equal(_read(tmp_path, content, loop="FIC102").loop.output, OTHER.numbers("op"))
    book = xlsx({"Data": one, "More": rows(names=["time", "FIC200.SP", "FIC200.PV", "FIC200.OP"])})
    with pytest.raises(UsageError, match=r"3 loops in 2 sheets: Data/FIC101, Data/FIC102, More"):
        _read(tmp_path, book)
    _same(_read(tmp_path, book, loop="Data/FIC101"))
    _same(_read(tmp_path, book, loop="FIC200"))


def _without_values() -> list[list]:
    return [NAMES, *([t, float(a), Formula("A2*2"), float(c)] for t, a, c in zip(R.stamps, R.sp, R.op, strict=True))]


REFUSED = {
    "empty workbook": (xlsx({"Sheet1": [], "Sheet2": []}), ["empty workbook", "2 sheets"]),
    "no table": (ods({"Sheet1": [["Dear colleague,"], ["see below"]]}), ["no sheet with a table"]),
    "formulas without values": (xlsx({"Sheet1": _without_values()}), ["formula without a saved value", "A2*2", "save"]),
    "ods formulas without values": (ods({"Sheet1": _without_values()}), ["formula without a saved value", "save"]),
    "password, xlsx": (compound({"EncryptionInfo": b"x", "EncryptedPackage": b"y"}), ["password", "save it again"]),
    "password, xls": (xls({"Sheet1": rows()}, locked=True), ["password", "save it again"]),
    "damaged xls": (b"\xd0\xcf\x11\xe0" + b"\0" * 600, ["damaged workbook", "CSV"]),
    "damaged xlsx": (xlsx({"Sheet1": rows()}).replace(b"sheetData", b"shoetData")[:-40], ["PK", "zip"]),
    "mat v7.3": (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n", ["7.3", "-v7"]),
    "mat without vectors": (mat(note="hello", S=3.0), ["no two vectors", "note", "save("]),
    "mat of two lengths": (mat(PV=np.arange(50.0), OP=np.arange(49.0), t=np.arange(50.0)), ["OP has 49", "50"]),
    "mat without a step": (mat(**vectors()), ["no time column", "--step"]),
    "damaged mat": (isdb()[:400], ["damaged MATLAB", "again"]),
}


@pytest.mark.parametrize("name", REFUSED)
def test_is_refused_with_the_next_step(tmp_path, name):
    content, words = REFUSED[name]
    with pytest.raises(DataError) as error:
        _read(tmp_path, content)
    text = f"{error.value.message} {error.value.hint}"
    assert "\n" not in text
    assert any(w in text for w in words) if name == "damaged xlsx" else all(w in text for w in words), text


def test_a_step_in_the_file_replaces_a_time_vector_that_stands_still(tmp_path):
    reading = _read(tmp_path, mat(Ts=1.0, **vectors(t=np.zeros(ROWS))))
    _same(reading)
    assert any("step of 1 s" in a for a in reading.assumptions)
    with pytest.raises(DataError, match="assumption"):
        _read(tmp_path, mat(Ts=1.0, **vectors(t=np.zeros(ROWS))), no_guess=True)


def test_without_the_reader_of_workbooks_it_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    with pytest.raises(DataError, match="not installed") as error:
        _read(tmp_path, SAME["xlsx"])
    assert "pip install python-calamine" in error.value.hint


def test_commands_read_them_and_remember_the_loop(tmp_path):
    (tmp_path / "isdb.mat").write_bytes(isdb())
    done = run("range", tmp_path / "isdb.mat", "--loop", "loop2", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["oscillating"] in (True, False)
    none = run("range", tmp_path / "isdb.mat")
    assert none.returncode == 2 and "chemicals.loop1" in none.stderr and "Traceback" not in none.stderr


def test_batch_finds_every_sheet_and_struct(tmp_path):
    from stictionid.batch.plan.tasks import plan
    from stictionid.batch.task import Work
    from stictionid.batch.work.worker import read_task

    (tmp_path / "a.mat").write_bytes(isdb())
    (tmp_path / "b.xlsx").write_bytes(TWO["xlsx"])
    (tmp_path / "c.ods").write_bytes(ods({"Sheet1": rows(names=["time", "SP", "PV", "OP"])}))
    (tmp_path / "~$b.xlsx").write_bytes(b"lock")
    (tmp_path / "d.xls").write_bytes(REFUSED["password, xls"][0])
    tasks = plan([str(tmp_path)], Work()).tasks
    assert [t.loop for t in tasks] == ["chemicals.loop1", "power.loop2", "FIC101", "TIC 7", "c", "d"]
    assert "password" in tasks[-1].problem
    for task, r in zip(tasks, (R, OTHER, R, OTHER, R), strict=False):
        _same(read_task(task, None), r)
