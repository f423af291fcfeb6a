"""A tag recorded less often than the other and held in between: which one it is, what counts, and what is not known.

Studies of held signals are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stictionid.historian import ReadOptions, read
from stictionid.historian.reading import Reading
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop

SETTING = Setting(Plant(2.0, 30.0, 10.0), Controller(0.5, 30.0, scan_s=1.0), S=4.0, J=2.0, duration_s=3000.0,
                  noise_sd=0.05, setpoint_moves=((0.0, 3.0),))


@pytest.fixture(scope="module")
def loop() -> Loop:
    return simulate(SETTING, seed=1).loop


def written(loop: Loop, folder: Path, *, pv: int = 1, op: int = 1, phase: int = 0,
            drop: slice | None = None) -> Reading:
    """The record as CSV, PV and OP held over so many rows from `phase` on."""
    k = np.arange(loop.samples)
    held = [signal[np.maximum((k - phase) // n * n + phase, 0)] if n > 1 else signal
            for signal, n in ((loop.process_value, pv), (loop.output, op))]
    assert loop.setpoint is not None
    lines = [f"{t:g},{r!r},{y!r},{u!r}" for t, r, y, u in zip(
        loop.time_s, loop.setpoint.tolist(), held[0].tolist(), held[1].tolist(), strict=True)]
    if drop is not None:
        del lines[drop]
    (folder / "a.csv").write_text("\n".join(["time_s,SP,PV,OP", *lines]) + "\n")
    return read(folder / "a.csv")


@pytest.mark.parametrize(("every", "phase"), [(2, 0), (10, 0), (10, 7), (60, 3)])
def test_a_held_pv_counts_where_it_is_fresh(loop: Loop, tmp_path: Path, every: int, phase: int) -> None:
    found = written(loop, tmp_path, pv=every, phase=phase)
    said = [f for f in found.findings if f.code == "process-value-held"]
    assert len(said) == 1 and said[0].evidence["every"] == every and f"every {every} s" in said[0].statement
    assert found.loop.step_s == 1.0
    first = np.flatnonzero(found.loop.used)[0]
    fresh = np.flatnonzero(found.loop.used)[1:]
    assert set(np.diff(fresh).tolist()) == {every}
    shift = loop.samples - found.loop.samples - (loop.samples - 1 - phase) % every
    assert first >= 0 and (fresh + shift - phase)[0] % every == 0
    np.testing.assert_array_equal(found.loop.process_value[fresh], loop.process_value[fresh + shift])
    assert found.rows["in"] == sum(v for k, v in found.rows.items() if k != "in") == loop.samples
    assert found.rows["repeat"] + found.rows["used"] == loop.samples and not found.rows.get("bad")


def test_a_gap_keeps_the_rhythm(loop: Loop, tmp_path: Path) -> None:
    found = written(loop, tmp_path, pv=10, drop=slice(1000, 1023))
    assert "process-value-held" in {f.code for f in found.findings} and len(found.loop.starts) == 2
    assert found.rows["used"] == pytest.approx(298, abs=2)


def test_a_fresh_pv_and_a_coarse_one_are_left_alone(loop: Loop, tmp_path: Path) -> None:
    coarse = replace(loop, process_value=np.round(loop.process_value / 0.5) * 0.5)
    for record in (loop, coarse):
        found = written(record, tmp_path)
        assert "process-value-held" not in {f.code for f in found.findings} and "repeat" not in found.rows


def test_both_held_alike_have_the_longer_step(loop: Loop, tmp_path: Path) -> None:
    found = written(loop, tmp_path, pv=10, op=10)
    assert {f.code for f in found.findings} & {"oversampled", "process-value-held"} == {"oversampled"}
    assert found.loop.step_s == 10.0


def without_scans(loop: Loop, tmp_path: Path) -> Reading:
    """The record read with an output that is held for ten scans: the output sets its step."""
    found = written(loop, tmp_path, op=10)
    said = next(f for f in found.findings if f.code == "output-sparse")
    assert "scans faster" in said.statement and said.severity == "warning"
    assert found.loop.step_s == 10.0 and found.rows["used"] == 300 and found.rows["resampled"] == 2700
    np.testing.assert_array_equal(found.loop.output, loop.output[::10])
    np.testing.assert_array_equal(found.loop.process_value, loop.process_value[::10])
    return found


def test_an_output_that_lost_its_scans_sets_the_step(loop: Loop, tmp_path: Path) -> None:
    """Its study has no sure answer: benchmarks/long."""
    without_scans(loop, tmp_path)


def test_a_step_that_is_given_keeps_the_rows_of_a_slower_output(loop: Loop, tmp_path: Path) -> None:
    written(loop, tmp_path, op=10)
    assert read(tmp_path / "a.csv", options=ReadOptions(step_s=1.0)).loop.step_s == 1.0
