"""Records that are spoilt as a whole: start-ups, swapped columns, averages; faults that cap the verdict do so."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from historian_files import R_STAMP, Record, iso, record, wide

from stictionid import historian
from stictionid.historian import ReadOptions, read, read_loop
from stictionid.historian.words.findings import FINDINGS
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate

R = record(rows=400)
SAMPLES = Path(__file__).resolve().parents[1] / "sample_data"


def _read(tmp_path, content, **options):
    path = tmp_path / "export.csv"
    path.write_text(content)
    return read(path, options=ReadOptions(**options))


def _find(reading, code):
    return next((f for f in reading.findings if f.code == code), None)


@pytest.mark.parametrize("at_end", [False, True])
def test_start_up_and_shut_down_are_masked_and_can_be_kept(tmp_path, at_end):
    stamps = [R_STAMP + timedelta(seconds=i) for i in range(440)]
    ramp = [f"{v:.3f}" for v in np.concatenate([np.full(20, 3.0), np.linspace(3.0, 46.0, 20)])]
    order = slice(None, None, -1) if at_end else slice(None)
    columns = [(head + body[order])[order] for head, body in
               ((["50.0"] * 40, R.sp), (ramp, R.pv), (["0.00"] * 30 + ["5.00"] * 10, R.op))]
    text = wide(Record(stamps, *columns))
    reading = _read(tmp_path, text)
    assert reading.rows["start-up"] == 40 and reading.rows["used"] == 400
    assert reading.loop.used[order][40:].all() and not reading.loop.used[order][:40].any()
    assert _find(reading, "start-up").evidence["share"] == pytest.approx(40 / 440)
    assert "start-up" not in _read(tmp_path, text, keep_startup=True).rows


def test_a_setpoint_step_at_the_start_is_no_start_up():
    assert read(SAMPLES / "tank.csv").loop.used.all()


def test_setpoint_and_process_value_in_each_others_columns(tmp_path):
    crossed = Record(R.stamps, R.pv, R.sp, R.op)
    finding = _find(_read(tmp_path, wide(crossed)), "swapped-roles")
    assert finding.severity == "serious" and "FIC101.SP" in finding.statement and "--sp" in finding.statement
    assert _find(_read(tmp_path, wide(R)), "swapped-roles") is None


@pytest.mark.parametrize("name", ["foptd.csv", "foptd_scanned.parquet"])
def test_output_and_process_value_in_each_others_columns(name):
    assert _find(read(SAMPLES / name), "swapped-roles") is None
    crossed = _find(read(SAMPLES / name, options=ReadOptions(pv="OP", op="PV")), "swapped-roles")
    assert crossed is not None and crossed.caps_verdict


def test_mode_codes_that_are_no_whole_numbers_give_averages_away(tmp_path):
    codes = [2 if i % 50 else 1.4 for i in range(400)]
    text = "time,SP,PV,OP,MODE\n" + "".join(
        f"{iso(m)},{R.sp[i]},{R.pv[i]},{R.op[i]},{codes[i]}\n" for i, m in enumerate(R.stamps))
    finding = _find(_read(tmp_path, text, mode_map={"2": "AUTO", "1.4": "AUTO"}), "averaged")
    assert finding.evidence["fractions_share"] == pytest.approx(8 / 400)


@pytest.mark.parametrize("every", [12, 30, 60])
def test_the_digits_of_a_mean_of_snapshots_give_it_away(tmp_path, every):
    """Snapshots of seven digits: their sum is short, and its n-th part is not."""
    rng = np.random.default_rng(5)
    snapshots = np.round(50.0 + np.cumsum(rng.standard_normal((120 * every, 2)), axis=0), 5)
    for means in (True, False):
        values = snapshots.reshape(120, every, 2)
        # Thirds of one tag are as long: a change of its unit.
        values = values.mean(axis=1) if means else values[:, 0] / np.array([3.0, 1.0])
        text = "time_s,PV,OP\n" + "".join(
            f"{every * k},{y!r},{u!r}\n" for k, (y, u) in enumerate(values.tolist()))
        found = [f for f in _read(tmp_path, text).findings if f.code == "averaged"]
        assert [f.evidence.get("snapshots") for f in found] == ([every] if means else [])


@pytest.mark.parametrize("means", [True, False])
def test_the_noise_that_a_pi_law_leaves_gives_means_of_ten_short_numbers_away(tmp_path, means):
    """The tenth part of a sum of decimal numbers is no longer than they are: digits do not tell."""
    setting = Setting(Plant(1.2, 25.0, 10.0), Controller(0.9, 25.0, scan_s=1.0), S=2.5, J=1.5, duration_s=4000.0,
                      noise_sd=0.04, setpoint_moves=((0.0, 3.0),))
    loop = simulate(setting, seed=3).loop
    values = np.round(np.stack([loop.setpoint, loop.process_value, loop.output], axis=1), 4).reshape(-1, 10, 3)
    rows = (values.mean(axis=1) if means else values[:, 0]).tolist()
    path = tmp_path / "export.csv"
    path.write_text("time_s,SP,PV,OP\n" + "".join(f"{10 * k},{r!r},{y!r},{u!r}\n" for k, (r, y, u) in enumerate(rows)))
    found = [f for f in read_loop(path).origin.findings if f.code == "averaged"]
    assert [f.evidence["law_leaves_correlated"] < -0.45 for f in found] == ([True] if means else [])


def test_what_caps_the_verdict_does_cap_it(tmp_path):
    from stictionid.record.loop import Finding
    from stictionid.record.study import Verdict
    from stictionid.verdict.judge import cap_verdict

    loop = _read(tmp_path, wide(R)).loop
    sure = Verdict("stiction", "because", 0.9)
    assert cap_verdict(sure, loop) == sure
    averaged = Finding("averaged", "warning", "b", caps_verdict=True)
    for finding in (Finding("irregular-steps", "serious", "a"), averaged):
        spoilt = replace(loop, origin=replace(loop.origin, findings=(finding,)))
        verdict = cap_verdict(sure, spoilt)
        assert verdict.stiction == "undecided" and verdict.confidence < 0.5
        assert verdict.evidence.capped_by == finding.code and "because" in verdict.reason


def _file(cells, names="time,SP,PV,OP"):
    return names + "\n" + "".join(f"{iso(m)},{cells(i)}\n" for i, m in enumerate(R.stamps))


def test_of_rows_with_one_stamp_the_good_one_wins(tmp_path):
    lines = ["time,SP,PV,OP,Quality"]
    for i, m in enumerate(R.stamps):
        lines.append(f"{iso(m)},{R.sp[i]},{R.pv[i]},{R.op[i]},Good")
        if i % 50 == 7:
            lines.append(f"{iso(m)},{R.sp[i]},99.9,{R.op[i]},Bad")
    reading = _read(tmp_path, "\n".join(lines) + "\n")
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv"))
    assert reading.rows == {"in": 408, "used": 400, "duplicate": 8}
    long = ["Tag,Time,Value,Quality"]
    for i, m in enumerate(R.stamps):
        long += [f"A.{t},{iso(m)},{getattr(R, t.lower())[i]},Good" for t in ("PV", "OP")] + [f"A.PV,{iso(m)},7,Bad"]
    reading = _read(tmp_path, "\n".join(long) + "\n")
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv"))


@pytest.mark.parametrize("code", ["0", "-1"])
def test_failed_reads_written_as_zero_or_minus_one(tmp_path, code):
    reading = _read(tmp_path, _file(lambda i: f"{R.sp[i]},{code if i % 61 == 5 else R.pv[i]},{R.op[i]}"))
    assert reading.rows["filled"] == 7 and any("--sentinel" in a for a in reading.assumptions)
    stood = _read(tmp_path, _file(lambda i: f"{R.sp[i]},{0 if 100 < i < 120 else R.pv[i]},{R.op[i]}"))
    assert stood.loop.process_value[110] == 0.0


@pytest.mark.parametrize("name, true, false, manual", [
    ("AUTO", "EIN", "AUS", False), ("auto", "TRUE", "FALSE", False), ("in_manual", "1", "0", True),
    ("Hand", "ja", "nein", True), ("自动", "是", "否", False)])
def test_flags_as_modes_in_several_languages(tmp_path, name, true, false, manual):
    names = f"time,SP,PV,OP,{name}"
    reading = _read(tmp_path, _file(
        lambda i: f"{R.sp[i]},{R.pv[i]},{R.op[i]},{true if (i >= 100) != manual else false}", names))
    assert reading.rows["manual"] == 100 and not reading.loop.used[:100].any() and reading.loop.used[100:].all()


def test_milliamperes_are_asked_for(tmp_path):
    text = _file(lambda i: f"{R.sp[i]},{R.pv[i]},{4 + 0.16 * float(R.op[i]):.4f}")
    reading = _read(tmp_path, text)
    assert "--span-op 4,20" in _find(reading, "output-perhaps-ma").statement and reading.loop.units["output"] == "%"
    said = _read(tmp_path, text, span_op=(4.0, 20.0))
    assert not said.assumptions
    np.testing.assert_allclose(said.loop.output, R.numbers("op"), atol=0.01)


def test_an_hour_that_is_missing_is_said_and_a_zone_joins_it(tmp_path):
    first = R_STAMP.replace(month=3, hour=1, minute=55)
    stamps = [first + timedelta(seconds=i + 3600 * (i >= 300)) for i in range(400)]
    text = wide(Record(stamps, R.sp, R.pv, R.op))
    assert "--zone" in _find(_read(tmp_path, text), "gaps").statement
    assert _read(tmp_path, text, zone="Europe/Berlin").loop.starts == (0,)


def test_a_cascade_slave_without_a_setpoint_is_told_where_it_is(tmp_path):
    reading = _read(tmp_path, _file(lambda i: f"{R.pv[i]},{R.op[i]},CAS,{R.sp[i]}",
                                    "time,FIC1.PV,FIC1.OP,FIC1.MODE,LIC2.OP"))
    assert "--sp LIC2.OP" in _find(reading, "setpoint-absent").statement


@pytest.mark.parametrize("role", ["output", "setpoint"])
def test_one_tag_exported_twice(tmp_path, role):
    twice = [f"{100 - 2 * float(v):.2f}" for v in R.op]
    cells = (lambda i: f"{R.sp[i]},{twice[i]},{R.op[i]}") if role == "output" else (
        lambda i: f"{twice[i]},{R.op[i]},{R.pv[i]}")
    assert _find(_read(tmp_path, _file(cells), span_op=(0.0, 100.0)), "identical-signals").evidence["role"] == role


@pytest.mark.parametrize("cells", [{50: "##########", 51: "2024-05-31 25:61:00"}, {70: ""}])
def test_stamps_that_cannot_be_read_are_counted_and_the_first_is_shown(tmp_path, cells):
    lines = wide(R).splitlines()
    for row, cell in cells.items():
        lines[row] = ",".join([cell, *lines[row].split(",")[1:]])
    reading = _read(tmp_path, "\n".join(lines) + "\n")
    found, first = _find(reading, "unreadable-stamps"), min(cells)
    assert found is not None and found.evidence["rows"] == len(cells) == reading.rows["no time"]
    assert f"line {first + 1}" in found.statement and "--time-format" in found.statement
    assert cells[first] in found.statement and found.evidence["cell"] == cells[first]
    assert reading.rows["in"] == sum(n for reason, n in reading.rows.items() if reason != "in")
    assert _find(_read(tmp_path, wide(R)), "unreadable-stamps") is None


def test_every_finding_of_the_reader_is_declared_and_made() -> None:
    """A code of the declaration stands once more in the reader, and no other code is made there."""
    files = {path: path.read_text(encoding="utf-8") for path in Path(historian.__file__).parent.rglob("*.py")}
    made = " ".join(text for path, text in files.items() if path.name != "findings.py")
    assert [code for code in FINDINGS if f'"{code}"' not in made] == []
    assert set(re.findall(r'finding\(\s*"([a-z-]+)"', made)) <= set(FINDINGS)
