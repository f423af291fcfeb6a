"""Records slower than the scan at length: a step that looked like a walk, a lag, and colour between unseen scans."""

from __future__ import annotations

import pytest
from plants.run import plant_of
from plants.score import loop_of

from stictionid.record.study import Study
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify


def test_a_step_that_looked_like_a_walk_is_found() -> None:
    """In differences the step was one outlier, and nothing was named at 2.7 times the noise."""
    loop = loop_of(plant_of("one", 32, 78_000))
    after = diagnose(loop, identify(loop), apply=True)
    assert after.steps[-1].effects == ("step-disturbance",) and after.adequate


def test_a_lag_that_leaves_the_free_run_of_a_slow_record_as_it_was_is_not_named() -> None:
    study = identify(loop_of(plant_of("clean", 33, 48_000)))
    assert study.steps[-1].effects == () and "between the samples" in study.missing_reason


@pytest.fixture(scope="module")
def unseen() -> Study:
    """The study of a valve with S of 6.2 %, which named coloured noise and said "no stiction" at a confidence of 0.96.
    """
    loop = loop_of(plant_of("clean", 32, 45_000))
    return diagnose(loop, identify(loop), apply=True)


def test_colour_between_unseen_scans_is_no_answer(unseen: Study) -> None:
    assert unseen.steps[-1].effects == () and "between the samples" in unseen.missing_reason


def test_colour_between_unseen_scans_denies_no_friction(unseen: Study) -> None:
    assert unseen.verdict.stiction == "undecided"


@pytest.mark.parametrize(("number", "named"), [
    (0, {"slip-overshoot"}), (11, {"extra-lag", "re-sticking", "stiction-drift"}), (17, {"re-sticking", "slew-limit"})])
def test_a_rounded_output_that_moved_between_samples_hides_no_valve(number: int, named: set[str]) -> None:
    """Taken for a held one, it left 4 to 15 times the noise, named nothing right, and S was 9 to 28 % off."""
    plant = plant_of("one", number, 124_000)
    loop = loop_of(plant)
    after = diagnose(loop, identify(loop), apply=True)
    assert named <= {*after.steps[-1].effects}
    assert after.estimate is not None
    assert abs(after.estimate.S / plant.truth["S"] - 1.0) <= 0.02
