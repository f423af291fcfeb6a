"""Records with missing cells at length: four of five, and an interval where the fit ends beside a step of the jump."""

from __future__ import annotations

from pathlib import Path

import missing_cells
import pytest
import test_missing_cells

from stictionid.model.closed_loop import simulate
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify

# Fixtures of tests/.
loop, intact = test_missing_cells.loop, test_missing_cells.intact


def narrow_around_the_truth(study: Study, S: float) -> None:
    """The interval of S holds the true one and is narrower than 1 % of it."""
    assert study.estimate is not None and study.estimate.S_interval is not None
    low, high = study.estimate.S_interval
    assert low <= S <= high and high - low < 0.01 * S


@pytest.mark.parametrize("pattern", ["every-3rd", "4-of-5"])
def test_the_answer_is_that_of_the_intact_record(loop: Loop, intact: missing_cells.Told, tmp_path: Path,
                                                 pattern: str) -> None:
    test_missing_cells.test_the_answer_is_that_of_the_intact_record(loop, intact, tmp_path, pattern)


@pytest.mark.xfail(strict=True, reason="the interval of S goes from 0.08 to 4.22 %; 1 % of S is what it was")
def test_s_is_inside_its_interval_where_the_fit_ends_beside_a_step_of_the_jump() -> None:
    setting = missing_cells.LOOPS["with-ramp"]
    narrow_around_the_truth(identify(simulate(setting, seed=0).loop), setting.S)


def test_s_is_inside_its_narrow_interval_once_the_ramp_is_named() -> None:
    setting = missing_cells.LOOPS["with-ramp"]
    loop = simulate(setting, seed=0).loop
    after = diagnose(loop, identify(loop), apply=True)
    assert after.missing == ("ramp-disturbance",)
    narrow_around_the_truth(after, setting.S)


def test_the_main_road_of_commands(loop: Loop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    test_missing_cells.test_the_main_road_of_commands(loop, tmp_path, monkeypatch, "two-of-3", 0)
