"""Two effects on one valve at length: from a basin whose dead time is samples off, and beside a random walk."""

from __future__ import annotations

import numpy as np
import pytest
from test_two_on_a_valve import DIFFERENCE, GROWTH, NOISE, PAIR, J, S, a_loop, a_model

from stictionid.fit.points.moves import descend_model, with_start
from stictionid.selection.refits import refit_in_full


def test_a_pair_is_searched_out_of_a_basin_whose_dead_time_is_samples_off() -> None:
    model = a_model(a_loop(), PAIR)
    start = model.vector({"S": 0.88 * S, "J": 1.2 * J, "initial_residual_force": 0.0, "time_constant_s": 5.0,
                          "dead_time_s": 7.5, "asymmetric-stiction:jump_difference": 1.3 * DIFFERENCE,
                          "stiction-drift:stickband_growth": 0.8 * GROWTH})
    near = descend_model(model, with_start(model, model.cube(start[:, None])))
    wrong = model.values(near.points[:1])[:, 0]
    model, found, _ = refit_in_full(model, wrong, np.random.default_rng(0), beside=True)
    assert model.evaluate(wrong).rmse > 10.0 * NOISE > 9.7 * model.evaluate(found).rmse
    named = model.named(found)
    assert named["S"] == pytest.approx(S, rel=0.01)
    assert named["J"] == pytest.approx(J, rel=0.05)
    assert named["dead_time_s"] == pytest.approx(5.0, abs=0.1)
