"""A valve without friction at length: a diagnosis asks for what acts off the friction."""

from __future__ import annotations

import loops
import pytest
from test_friction_free import under_a_load

from stictionid.effects import catalogue
from stictionid.selection.policy import Policy, with_budget
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify


def test_diagnose_asks_for_what_acts_off_the_friction() -> None:
    loop, study = under_a_load()
    asked = {name for node in diagnose(loop, study, policy=with_budget(Policy(), 8000)).tree for name in node.effects}
    on_friction = {e.name for e in catalogue().values() if e.friction is not None}
    assert {"extra-lag", "inverse-response"} <= asked and not asked & on_friction


def test_the_process_of_a_valve_without_friction_has_its_further_lag() -> None:
    known = loops.clean(132004, "setpoint")
    study = identify(known.loop, options=Options(intervals=False))
    assert study.verdict.stiction == "no stiction" and study.adequate
    assert study.steps[-1].effects == ("extra-lag",)
    plant = known.setting.plant
    assert study.estimate.gain == pytest.approx(plant.gain, rel=0.05)
    assert study.estimate.time_constants_s == pytest.approx(
        (plant.time_constant_s, plant.second_time_constant_s), rel=0.2)
