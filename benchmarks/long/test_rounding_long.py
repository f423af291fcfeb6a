"""An output recorded in coarse steps at length: a loop whose rounding moves y by more than its best model errs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from plants.run import plant_of
from plants.score import loop_of

from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.selection.policy import Policy
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify

SETTING = Setting(Plant(2.5, 17.0, 5.0), Controller(0.35, 14.0, scan_s=1.0), S=3.6, J=2.6, duration_s=900.0,
                  setpoint_moves=((0.0, 3.0), (300.0, -4.0), (600.0, 3.0)), noise_sd=0.02)


def recorded(step: float) -> Loop:
    """A clean loop of that setting with its output recorded in steps of `step` %."""
    loop = simulate(SETTING, seed=2).loop
    return replace(loop, position=None, output=np.rint(loop.output / step) * step)


def test_what_rounding_makes_of_a_clean_loop_is_not_named() -> None:
    loop = recorded(0.1)
    study = identify(loop)
    # By OP alone the model leaves more than twice the noise.
    assert study.steps[-1].error.rmse > 2.0 * SETTING.noise_sd
    after = diagnose(loop, study, apply=True, policy=Policy(budget=80_000))
    assert [step.added for step in after.steps] == [None] and after.missing == ()


def test_a_clean_loop_with_a_rounded_output_gets_neither_an_effect_nor_a_noise() -> None:
    """A slip that overshoots put single slips right, and gained 100 in BIC; coloured noise came next.

    Without the setpoint no law of the controller gives the digits back.
    """
    loop = replace(loop_of(plant_of("clean", 15, 77_000)), setpoint=None)
    after = diagnose(loop, identify(loop), apply=True)
    assert after.missing == () and after.steps[-1].effects == ()
