"""The profile over slip jumps where the best valve has none."""

from __future__ import annotations

import numpy as np
import pytest
from real_nodes import SAMPLES, model_on, recorded, true_values

from stictionid.fit.intervals.jumps import over_jumps
from stictionid.model.spec import Spec


@pytest.mark.parametrize("noise", [0.001, 0.01, 0.2])
def test_the_profile_begins_at_a_valve_without_a_slip_jump(noise: float) -> None:
    """Between no slip jump and the least one that is tried the steps are even: a ratio of 0 would have none."""
    errors = noise * np.random.default_rng(3).standard_normal(SAMPLES)
    model = model_on(recorded(errors, values={"J": 0.0}), Spec())
    point = model.cube(model.vector({**true_values(), "J": 0.0})[:, None])[0]
    ratio = 1.003
    found = over_jumps(model, point, ratio)
    assert found is not None and found.J[0] == 0.0
    assert (np.diff(found.J) > 0.0).all() and np.isfinite(found.costs[:2]).all()
    possible = found.J[found.costs <= ratio * found.costs.min()]
    assert possible[0] == 0.0
    if noise == 0.001:
        # (a slip jump of 2 % of S shows in so little noise, and the end lies between)
        assert 0.0 < possible[-1] < 0.02 * true_values()["S"]
