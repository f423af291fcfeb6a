"""Exports as plants write them: names in DIN and ISA letters, units in names, code pages, empty cells, folders."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import run
from historian_files import comma, iso, record, wide

from stictionid.batch.plan.tasks import plan
from stictionid.batch.task import Work
from stictionid.errors import DataError
from stictionid.historian import Reading, ReadOptions, loops_in, read
from stictionid.historian.words.roles import take_apart, unit_in

R = record(240)


def _read(tmp_path: Path, content: str | bytes, **options: object) -> Reading:
    path = tmp_path / "export.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read(path, options=ReadOptions(**options))  # type: ignore[arg-type]


GERMAN = "Zeit,FIC7.Sollwert,FIC7.Istwert,FIC7.Stellgröße"


@pytest.mark.parametrize(("names", "encoding"), [
    (GERMAN, "cp1252"), ("Zeit,Größe.SP,Größe.PV,Größe.OP", "cp1252"), ("été,Débit.SP,Débit.PV,Débit.OP", "cp1252"),
    ("Tid,Läge_å.SP,Läge_å.PV,Läge_å.OP", "cp1252"), ("время,Расход.SP,Расход.PV,Расход.OP", "cp1251"),
    ("время,уставка,значение,выход", "cp1251"), ("Дата г,FIC1 уставка,FIC1.PV,FIC1 выход", "cp1251"),
    ("时间,设定值,测量值,输出", "gbk")])
def test_the_code_page_is_that_in_which_the_words_are_words(tmp_path: Path, names: str, encoding: str) -> None:
    reading = _read(tmp_path, wide(R, sep=";", names=names, cell=comma).encode(encoding))
    assert reading.encoding == encoding and reading.columns["output"] == names.split(",")[3]
    np.testing.assert_array_equal(reading.loop.output, R.numbers("op"))
    assert any(encoding in guess and "--encoding" in guess for guess in reading.assumptions)


def test_an_error_on_columns_names_the_encoding_and_the_option(tmp_path: Path) -> None:
    content = wide(R, names=GERMAN).encode("cp1252")
    with pytest.raises(DataError, match=r"read as cp1251, has no column for the controller output \(OP\)") as caught:
        _read(tmp_path, content, encoding="cp1251")
    assert "--op" in caught.value.hint and "--encoding" in caught.value.hint
    with pytest.raises(DataError) as caught:
        _read(tmp_path, wide(R, names="time,SP,PV,TI7"))
    assert "read as" not in caught.value.message and "--encoding" not in caught.value.hint


@pytest.mark.parametrize("names", ["Time,FIC204_SP,FIC204_PV,FIC204_Y", "t,w,x,y", "Zeit,R1.W,R1.X,R1.Y"])
def test_y_beside_another_process_value_is_the_output(tmp_path: Path, names: str) -> None:
    reading = _read(tmp_path, wide(R, names=names))
    np.testing.assert_array_equal(reading.loop.output, R.numbers("op"))
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv"))
    assert any("beside another process value (--op)" in guess for guess in reading.assumptions)


def test_y_is_the_process_value_beside_u_and_stays_it_beside_an_output(tmp_path: Path) -> None:
    for names in ("t,r,y,u", "t,FIC1_SP,FIC1_Y,FIC1_OP"):
        np.testing.assert_array_equal(_read(tmp_path, wide(R, names=names)).loop.process_value, R.numbers("pv"))


def test_several_loops_with_y_are_found_by_reader_and_batch(tmp_path: Path) -> None:
    rows = [f"{iso(m)},{R.pv[i]},{R.op[i]},{R.pv[i]},{R.op[i]}" for i, m in enumerate(R.stamps)]
    (tmp_path / "two.csv").write_text("\n".join(["Time,F1_PV,F1_Y,F2_PV,F2_Y", *rows]) + "\n")
    assert loops_in(tmp_path / "two.csv") == ("F1", "F2")
    assert read(tmp_path / "two.csv", options=ReadOptions(loop="F2")).columns["output"] == "F2_Y"
    assert [task.loop for task in plan([str(tmp_path)], Work()).tasks] == ["F1", "F2"]


def test_the_error_names_the_role_that_no_column_has(tmp_path: Path) -> None:
    for names, role in (("Time,F1_SP,F1_PV,F1_Q", "controller output"), ("Time,F1_SP,F1_Q,F1_OP", "process value")):
        with pytest.raises(DataError, match=f"no column for the {role}"):
            _read(tmp_path, wide(R, names=names))
    with pytest.raises(DataError, match="no loop with both") as caught:
        _read(tmp_path, wide(R, names="Time,F1_PV,F2_PV,F3_OP"))
    assert "--pv and --op" in caught.value.hint


@pytest.mark.parametrize(("name", "role", "loop", "unit"), [
    ("PV mA", "process_value", "", "mA"), ("OP_mA", "output", "", "mA"), ("FIC1.OP, %", "output", "FIC1", "%"),
    ("OP%", "output", "", "%"), ("FIC-1.PV m3/h", "process_value", "FIC-1", "m3/h"), ("ZT in mA", "position", "", "mA"),
    ("FIC1.MA", "mode", "FIC1", ""), ("FIC1 MA", "mode", "FIC1", ""), ("FT_1 bar", "process_value", "1", "bar"),
    ("FIC1.PV (m3/h)", "process_value", "FIC1", "m3/h"), ("OUT PCT", "output", "", "PCT"), ("t_min", "time", "", "")])
def test_a_unit_after_a_name_is_no_part_of_it(name: str, role: str, loop: str, unit: str) -> None:
    found = take_apart(name)
    assert (found.role, found.loop, unit_in(name)) == (role, loop, unit)


def test_an_output_in_ma_is_scaled_and_said(tmp_path: Path) -> None:
    op = R.numbers("op")
    live = "\n".join(["Time,PV mA,OP mA", *(f"{iso(m)},{R.pv[i]},{4 + 0.16 * op[i]:.6f}"
                                             for i, m in enumerate(R.stamps))]) + "\n"
    for text in (live, live.replace("OP mA", "OP [mA]")):
        reading = _read(tmp_path, text)
        np.testing.assert_allclose(reading.loop.output, op, atol=1e-4)
        assert reading.loop.units == {"output": "%", "process_value": "mA"} or "[mA]" in text
        assert [guess for guess in reading.assumptions if "mA" in guess] == [
            "OP in mA is 4 to 20 mA, scaled to % (--span-op 4,20, or --span-op 0,20)"]
        assert not any("perhaps" in f.code or "not-percent" in f.code for f in reading.findings)
    settled = _read(tmp_path, live, span_op=(0.0, 20.0), no_guess=True).loop
    np.testing.assert_allclose(settled.output, (4 + 0.16 * op) / 0.2, atol=1e-4)
    low = "\n".join(["Time,PV mA,OP mA", *(f"{iso(m)},{R.pv[i]},{0.2 * op[i] - 6:.6f}"
                                            for i, m in enumerate(R.stamps))]) + "\n"
    finding = next(f for f in _read(tmp_path, low).findings if f.code == "output-not-percent")
    assert "--span-op 0,20" in finding.statement


def test_read_writes_a_unit_once(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(wide(R, names="Time,FC204.SP [m3/h],FC204.PV m3/h,FC204.OP [%]"))
    shown = " ".join(run("read", "a.csv", "-q", cwd=tmp_path).stdout.split())
    assert "FC204.OP [%] (suffix" in shown and "FC204.PV m3/h (suffix" in shown and "] [" not in shown


def test_empty_cells_between_measurements_are_no_repeats(tmp_path: Path) -> None:
    rows = [f"{iso(m)},{R.pv[i] if i % 5 == 0 else ''},{R.op[i]}" for i, m in enumerate(R.stamps)]
    held = [f"{iso(m)},{R.pv[i - i % 5]},{R.op[i]}" for i, m in enumerate(R.stamps)]
    for lines, said in ((rows, "5 s, OP every 1 s: the PV cells in between are empty (80 % of the samples); the valve"),
                        (held, "5 s, OP every 1 s: a PV that repeats (80 % of the samples) is no measurement")):
        reading = _read(tmp_path, "\n".join(["Time,PV,OP", *lines]) + "\n")
        finding = next(f for f in reading.findings if f.code == "process-value-held")
        assert said in finding.statement and ("repeats" in finding.statement) == (lines is held)


def test_a_folder_called_dot_has_its_name(tmp_path: Path) -> None:
    for tag in ("a", "b"):
        (tmp_path / f"{tag}.csv").write_text("\n".join(["Time,Value", *(f"{iso(m)},1" for m in R.stamps)]) + "\n")
    done = run("identify", ".", cwd=tmp_path)
    assert done.returncode == 3 and f"stictionid: {tmp_path.name} has no column" in done.stderr
