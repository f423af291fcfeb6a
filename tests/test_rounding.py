"""An output, or a PV, recorded in coarse steps.

Studies of clean loops are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plants.run import plant_of
from plants.score import loop_of
from quick_loops import PLAIN

from stictionid.effects import get
from stictionid.fit.starts.intersample import surely_moves
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.process.rounded import deround_output, step_of
from stictionid.verbs.identify import identify


def test_a_smooth_output_comes_back_from_its_steps() -> None:
    t = np.arange(400.0)
    smooth = 3.0 * np.sin(t / 25.0) + np.where(t >= 200.0, 2.0, 0.0)
    jumps, step = np.where(t == 200.0, 2.0, 0.0), 0.05
    recorded_in_steps = np.rint(smooth / step) * step
    back = deround_output(recorded_in_steps, jumps)
    # No point leaves the step in which it was recorded.
    assert np.abs(back - recorded_in_steps).max() <= 0.5 * step + 1e-9
    assert np.std(back - smooth) < 0.6 * np.std(recorded_in_steps - smooth)
    assert deround_output(smooth, jumps) is smooth and step_of(smooth) == 0.0


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


@pytest.mark.parametrize(("number", "command"), [(21, "moving"), (23, "held")])
def test_rounding_hides_no_command_that_moves_between_samples(number: int, command: str) -> None:
    plant = plant_of("one", number, 41_000)
    assert plant.truth["levels"]["command"] == command and plant.truth["rounding"] > 0.02
    assert surely_moves(loop_of(plant)) is (command == "moving")
