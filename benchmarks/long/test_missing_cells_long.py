"""Records with missing cells at length: four of five, and an interval where the fit ends beside a step of the jump."""

from __future__ import annotations

from pathlib import Path

import missing_cells
import pytest
import test_missing_cells

from stictionid.model.closed_loop import simulate
from stictionid.record.loop import Loop
from stictionid.verbs.identify import identify

# Fixtures of tests/.
loop, intact = test_missing_cells.loop, test_missing_cells.intact


@pytest.mark.parametrize("pattern", ["every-3rd", "4-of-5"])
def test_the_answer_is_that_of_the_intact_record(loop: Loop, intact: missing_cells.Told, tmp_path: Path,
                                                 pattern: str) -> None:
    test_missing_cells.test_the_answer_is_that_of_the_intact_record(loop, intact, tmp_path, pattern)


def test_s_is_inside_its_interval_where_the_fit_ends_beside_a_step_of_the_jump() -> None:
    setting = missing_cells.LOOPS["with-ramp"]
    estimate = identify(simulate(setting, seed=0).loop).estimate
    assert estimate is not None and estimate.S_interval is not None
    low, high = estimate.S_interval
    assert low <= setting.S <= high and high - low < 0.01 * setting.S


def test_the_main_road_of_commands(loop: Loop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    test_missing_cells.test_the_main_road_of_commands(loop, tmp_path, monkeypatch, "two-of-3", 0)
