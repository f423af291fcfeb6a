"""A valve without friction as a base: where it explains the record, nothing is asked of the friction of the valve."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from stictionid.effects import catalogue
from stictionid.fit.context import Run
from stictionid.fit.friction_free import follows_command
from stictionid.model.spec import Spec
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.study import Study
from stictionid.selection.policy import Policy, with_budget
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))

import loops

SAMPLES = 600


@cache
def under_a_load() -> tuple[Loop, Study]:
    """A loop without friction whose load wanders, and its study."""
    loop = loops.clean(3, "noise", samples=SAMPLES).loop
    return loop, identify(loop)


def follows(loop: Loop) -> bool:
    run = Run(loop, find_range(loop), Options(), law="chen", order=1, rng=np.random.default_rng(0),
              tell=lambda text, share: None)
    return follows_command(run, run.fit(Spec()))


@pytest.mark.parametrize("cause", ["sine", "noise", "setpoint"])
def test_a_valve_without_friction_follows_its_command_whatever_moves_the_loop(cause: str) -> None:
    assert follows(loops.clean(2, cause, samples=SAMPLES).loop)


@pytest.mark.parametrize("loop", [loops.sticky(4, samples=SAMPLES).loop, loops.wandering(4, samples=SAMPLES).loop],
                         ids=["noise", "load"])
def test_a_valve_that_sticks_does_not_follow_its_command(loop: Loop) -> None:
    assert not follows(loop)


def test_identify_asks_no_rest_of_a_valve_without_friction() -> None:
    _, study = under_a_load()
    assert study.verdict.stiction != "stiction"
    assert study.tree and {name for node in study.tree for name in node.effects} <= {"extra-lag"}


def test_the_process_of_a_valve_without_friction_has_its_further_lag() -> None:
    known = loops.clean(132004, "setpoint")
    study = identify(known.loop, options=Options(intervals=False))
    assert study.verdict.stiction == "no stiction" and study.adequate
    assert study.steps[-1].effects == ("extra-lag",)
    plant = known.setting.plant
    assert study.estimate.gain == pytest.approx(plant.gain, rel=0.05)
    assert study.estimate.time_constants_s == pytest.approx(
        (plant.time_constant_s, plant.second_time_constant_s), rel=0.2)


def test_diagnose_asks_for_what_acts_off_the_friction() -> None:
    loop, study = under_a_load()
    asked = {name for node in diagnose(loop, study, policy=with_budget(Policy(), 8000)).tree for name in node.effects}
    on_friction = {e.name for e in catalogue().values() if e.friction is not None}
    assert {"extra-lag", "inverse-response"} <= asked and not asked & on_friction
