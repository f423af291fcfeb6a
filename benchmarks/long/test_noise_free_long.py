"""Records without noise at length: nothing is added to a held command, and a hidden effect is found."""

from __future__ import annotations

import pytest
from quick_loops import PLAIN, quick
from test_noise_free import HELD

from stictionid.model.closed_loop import simulate
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
