"""An output recorded in coarse steps at length: a loop whose rounding moves y by more than its best model errs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plants.run import plant_of
from plants.score import loop_of
from quick_loops import PLAIN

from stictionid.effects import get
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
    # By the rounded OP alone the model left more than twice the noise. The law of the controller gives the digits back.
    assert study.steps[-1].error.rmse < 1.05 * SETTING.noise_sd
    assert study.estimate is not None
    assert pytest.approx(SETTING.S, rel=0.01) == study.estimate.S
    assert pytest.approx(SETTING.J, rel=0.02) == study.estimate.J
    after = diagnose(loop, study, apply=True, policy=Policy(budget=80_000))
    assert [step.added for step in after.steps] == [None] and after.missing == ()


def test_a_clean_loop_with_a_rounded_output_gets_neither_an_effect_nor_a_noise() -> None:
    """A slip that overshoots put single slips right, and gained 100 in BIC; coloured noise came next.

    Without the setpoint no law of the controller gives the digits back.
    """
    loop = replace(loop_of(plant_of("clean", 15, 77_000)), setpoint=None)
    after = diagnose(loop, identify(loop), apply=True)
    assert after.missing == () and after.steps[-1].effects == ()


@pytest.mark.parametrize("clips", [False, True])
def test_a_rounded_pv_that_rests_is_no_end_of_a_range(clips: bool) -> None:
    # The first 150 s lie at the lowest value of a PV in coarse steps; clipped, the peaks lie at the highest.
    setting = Setting(Plant(2.0, 8.0, 3.0), Controller(0.25, 8.0, scan_s=1.0), S=4.0, J=2.0, noise_sd=0.03,
                      duration_s=900.0, setpoint_moves=((150.0, 6.0),))
    loop = simulate(setting, seed=3).loop
    pv = np.round(np.rint(loop.process_value / 0.25) * 0.25, 10)
    pv = np.minimum(pv, np.quantile(pv, 0.8)) if clips else pv
    rested = replace(loop, process_value=pv, position=None)
    assert get("measurement-limit").asked_for(rested.process_value)
    study = identify(rested, options=PLAIN)
    assert (study.steps[0].effects == ("measurement-limit",)) is clips
