"""An output, or a PV, recorded in coarse steps.

Studies of clean loops, and of a rounded PV that rests, are in benchmarks/long.
"""

from __future__ import annotations

import numpy as np
import pytest
from plants.run import plant_of
from plants.score import loop_of

from stictionid.fit.starts.intersample import surely_moves
from stictionid.process.rounded import deround_output, step_of


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


@pytest.mark.parametrize(("number", "command"), [(21, "moving"), (23, "held")])
def test_rounding_hides_no_command_that_moves_between_samples(number: int, command: str) -> None:
    plant = plant_of("one", number, 41_000)
    assert plant.truth["levels"]["command"] == command and plant.truth["rounding"] > 0.02
    assert surely_moves(loop_of(plant)) is (command == "moving")
