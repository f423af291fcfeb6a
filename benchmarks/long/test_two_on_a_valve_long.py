"""Two effects on one valve at length: from a basin whose dead time is samples off, and beside a random walk."""

from __future__ import annotations

import numpy as np
import pytest
from test_two_on_a_valve import DIFFERENCE, GROWTH, NOISE, PAIR, J, S, a_loop, a_model, first_of

from stictionid.fit.fit import as_it_stands
from stictionid.fit.moves import descended, with_start
from stictionid.fit.with_effect import beside_others, scout, together_on_valve
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import swing_of, time_scale_s


def test_a_pair_is_searched_out_of_a_basin_whose_dead_time_is_samples_off() -> None:
    model = a_model(a_loop(), PAIR)
    start = model.vector({"S": 0.88 * S, "J": 1.2 * J, "initial_residual_force": 0.0, "time_constant_s": 5.0,
                          "dead_time_s": 7.5, "asymmetric-stiction:jump_difference": 1.3 * DIFFERENCE,
                          "stiction-drift:stickband_growth": 0.8 * GROWTH})
    near = descended(model, with_start(model, model.cube(start[:, None])))
    wrong = model.values(near.points[:1])[:, 0]
    found = together_on_valve(model, wrong, np.random.default_rng(0))
    assert model.evaluate(wrong).rmse > 10.0 * NOISE > 9.7 * model.evaluate(found).rmse
    named = model.named(found)
    assert named["S"] == pytest.approx(S, rel=0.01)
    assert named["J"] == pytest.approx(J, rel=0.05)
    assert named["dead_time_s"] == pytest.approx(5.0, abs=0.1)


def test_a_drift_beside_a_random_walk_is_found_in_windows() -> None:
    """A random walk in y adds up along the record, but spoils few windows."""
    walk, noise = "random-walk-disturbance", 0.04
    loop = simulate(Setting(Plant(0.8, 7.3, 3.2), Controller(1.0, 7.3, scan_s=1.0), S=4.0, J=2.6, duration_s=1000.0,
                            setpoint_moves=((300.0, 2.0), (650.0, -2.5)), noise_sd=noise,
                            effects=((PAIR[1], {"stickband_growth": 1.4, "jump_growth": 0.0}),
                                     (walk, {"innovation_sd": noise}))), seed=4).loop
    found = find_range(loop)
    model = Model(loop, Spec(effects=(walk,), increments=True, taps=(0.38, 0.14, 0.05)), s_max=swing_of(loop, found),
                  period_s=time_scale_s(loop, found))
    start = {"S": 4.7, "J": 2.0, "initial_residual_force": 0.0, "time_constant_s": 7.3, "dead_time_s": 3.2}
    values = model.values(descended(model, model.cube(model.vector(start)[:, None])).points[:1])[:, 0]
    fit = as_it_stands(model, values)
    looks = [scout(fit, PAIR[1], values[None, :5], np.random.default_rng(0), windows=windows)
             for windows in (False, True)]
    rmse = [float(np.sqrt(look.cost / fit.best.rows)) for look in looks]
    assert rmse[1] < 1.05 * 1.618 * noise < 0.95 * rmse[0]  # what a walk as strong as the noise leaves
    named = looks[1].model.named(looks[1].values)
    assert named["S"] == pytest.approx(4.0, rel=0.03)
    assert named[f"{PAIR[1]}:stickband_growth"] == pytest.approx(1.4, rel=0.1)


def test_the_second_effect_is_searched_together_with_the_first() -> None:
    fit = first_of(a_model(a_loop(), PAIR[:1]))
    rng = np.random.default_rng(0)
    alone = scout(fit, PAIR[1], fit.values[None, :5], rng)
    found = beside_others(fit, PAIR[1], alone.points, rng)
    assert found is not None
    rmse = [float(np.sqrt(look.cost / fit.model.shared.rows)) for look in (alone, found)]
    assert rmse[0] > 1.5 * NOISE > 1.2 * rmse[1]
    named = found.model.named(found.values)
    assert named["S"] == pytest.approx(S, rel=0.02)
    assert named["J"] == pytest.approx(J, rel=0.06)
    assert named["asymmetric-stiction:jump_difference"] == pytest.approx(DIFFERENCE, rel=0.15)
    assert named["stiction-drift:stickband_growth"] == pytest.approx(GROWTH, rel=0.15)
