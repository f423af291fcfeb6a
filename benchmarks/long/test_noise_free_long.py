"""Records without noise at length: nothing is added to a held command, and a hidden effect is found."""

from __future__ import annotations

from functools import cache

import pytest
from quick_loops import PLAIN, quick
from test_noise_free import HELD

from stictionid.model.closed_loop import preset, simulate
from stictionid.record.study import Study
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify


def test_a_record_without_noise_has_no_noise_model():
    study = identify(simulate(HELD).loop)
    assert study.adequate and study.steps[-1].effects == ()
    assert pytest.approx((4.0, 2.0), rel=5e-3) == (study.estimate.S, study.estimate.J)


@pytest.mark.parametrize(("effect", "values", "options"), [
    ("extra-lag", {"second_time_constant_s": 4.0}, Options(intervals=False)),
    ("step-disturbance", {"time_s": 270.0, "size": 1.2}, PLAIN)])
def test_an_effect_is_found_without_noise(effect: str, values: dict[str, float], options: Options) -> None:
    loop = quick(noise_sd=0.0, effects=((effect, values),))
    found = diagnose(loop, identify(loop, options=options), apply=True)
    assert [name.partition("@")[0] for name in found.steps[-1].effects] == [effect]
    assert found.adequate


def test_the_default_loop_of_simulate_is_adequate_and_nothing_is_named():
    study = default()
    assert study.adequate and "no transmitter resolves it" in (study.adequate_reason or "")
    assert study.steps[-1].effects == ()
    assert pytest.approx((5.0, 3.0), rel=0.02) == (study.estimate.S, study.estimate.J)


def test_the_position_of_a_moving_command_gives_the_stiction_of_the_valve():
    # The law at the samples alone has slips a sample late; it gave S 4.77 and J 4.87 %.
    position = default().estimate.from_position
    assert pytest.approx((5.0, 3.0), rel=0.02) == (position.S, position.J)


@cache
def default() -> Study:
    """The study of the default loop of `simulate`."""
    return identify(simulate(preset("foptd")).loop)
