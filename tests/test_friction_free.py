"""A valve without friction as a base: where it explains the record, nothing is asked of the friction of the valve.

A diagnosis of such a loop, and one with a further lag, are in benchmarks/long.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from stictionid.fit.context import Run
from stictionid.fit.friction_free import follows_command
from stictionid.model.spec import Spec
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.study import Study
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
