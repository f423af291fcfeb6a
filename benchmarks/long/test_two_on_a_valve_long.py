"""Two effects on one valve at length: from a basin whose dead time is samples off, and beside a random walk."""

from __future__ import annotations

import numpy as np
import pytest
from test_two_on_a_valve import DIFFERENCE, GROWTH, NOISE, PAIR, J, S, a_loop, a_model

from stictionid.fit.points.moves import descend_model, with_start
from stictionid.fit.starts.niches import evolve_points
from stictionid.selection.refits import refit_in_full
from stictionid.typing import FloatArray


def test_a_pair_is_searched_out_of_a_basin_whose_dead_time_is_samples_off() -> None:
    model = a_model(a_loop(), PAIR)
    start = model.vector({"S": 0.88 * S, "J": 1.2 * J, "initial_residual_force": 0.0, "time_constant_s": 5.0,
                          "dead_time_s": 7.5, "asymmetric-stiction:jump_difference": 1.3 * DIFFERENCE,
                          "stiction-drift:stickband_growth": 0.8 * GROWTH})
    near = descend_model(model, with_start(model, model.cube(start[:, None])))
    wrong = model.values(near.points[:1])[:, 0]
    model, found, _ = refit_in_full(model, wrong, np.random.default_rng(0), basins=True)
    assert model.evaluate(wrong).rmse > 10.0 * NOISE > 9.7 * model.evaluate(found).rmse
    named = model.named(found)
    assert named["S"] == pytest.approx(S, rel=0.01)
    assert named["J"] == pytest.approx(J, rel=0.05)
    assert named["dead_time_s"] == pytest.approx(5.0, abs=0.1)


def test_a_herd_crosses_slips_that_a_descent_stops_at() -> None:
    model = a_model(a_loop(), PAIR)
    start = model.vector({"S": 1.03 * S, "J": 0.93 * J, "initial_residual_force": 0.0, "time_constant_s": 5.0,
                          "dead_time_s": 5.0, "asymmetric-stiction:jump_difference": 0.8 * DIFFERENCE,
                          "stiction-drift:stickband_growth": 0.8 * GROWTH})
    point: FloatArray = with_start(model, model.cube(start[:, None]))
    stopped = descend_model(model, point)
    herd = evolve_points(model, point, np.random.default_rng(0))
    assert np.all(np.diff(herd.costs) >= 0.0)
    assert herd.costs[0] == pytest.approx(float(model.costs(herd.points[:1])[0]))
    rmse = [float(np.sqrt(found.costs[0] / model.shared.rows)) for found in (stopped, herd)]
    assert rmse[1] < 1.2 * NOISE < 0.6 * rmse[0]
