"""Two effects on one valve: each hides the other, so that the second is searched together with the first.

A herd of valves, and identified loops, are in benchmarks/long.
"""

from __future__ import annotations

import numpy as np

from stictionid.fit.points.fitted import as_it_stands
from stictionid.fit.points.moves import with_start
from stictionid.fit.starts.beside_effect import open_valves
from stictionid.fit.starts.niches import beyond_rest
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import swing_of, time_scale_s
from stictionid.typing import FloatArray

NOISE, S, J, DIFFERENCE, GROWTH = 0.03, 3.0, 1.2, -0.7, 0.6
PAIR = ("asymmetric-stiction", "stiction-drift")


def a_loop(scan_s: float = 1.0) -> Loop:
    setting = Setting(Plant(3.0, 5.0, 5.0), Controller(0.1, 5.0, scan_s=scan_s), S=S, J=J, duration_s=1000.0,
                      setpoint_moves=((0.0, 3.0), (270.0, -3.0), (500.0, 4.0), (750.0, -4.0)), noise_sd=NOISE,
                      effects=((PAIR[0], {"jump_up": J + DIFFERENCE / 2, "jump_down": J - DIFFERENCE / 2}),
                               (PAIR[1], {"stickband_growth": GROWTH, "jump_growth": 0.1})))
    return simulate(setting, seed=3).loop


def a_model(loop: Loop, effects: tuple[str, ...], between: str = "hold") -> Model:
    found = find_range(loop)
    return Model(loop, Spec(effects=effects, between=between, substeps=1 if between == "hold" else 8),
                 s_max=swing_of(loop, found), period_s=time_scale_s(loop, found))


def test_a_drift_at_the_wall_is_looked_for_beyond_where_the_valve_rests() -> None:
    model = a_model(a_loop(), PAIR)
    named = {"S": 1.15 * S, "J": 0.8 * J, "initial_residual_force": 0.0, "time_constant_s": 5.0, "dead_time_s": 5.5,
             "asymmetric-stiction:jump_difference": DIFFERENCE, "stiction-drift:stickband_growth": 0.4,
             "stiction-drift:jump_growth": 0.4}
    wall: FloatArray = with_start(model, model.cube(model.vector(named)[:, None]))
    beyond = beyond_rest(model, wall[0], np.random.default_rng(0))
    values = model.values(beyond)
    growth = values[model.rows_of(PAIR[1])]
    assert len(beyond) > 4
    assert np.all(growth[0] > growth[1])
    assert model.costs(beyond[:1])[0] < 0.5 * model.costs(wall)[0]
    assert not len(beyond_rest(model, beyond[0], np.random.default_rng(0)))
    alone = a_model(a_loop(), PAIR[:1])
    assert not len(beyond_rest(alone, np.full(alone.space.size, 0.5), np.random.default_rng(0)))


def test_beside_a_rest_a_valve_that_slides_is_sought_with_the_effect_that_looked_like_it() -> None:
    """While a stop was missing, stems that slide to it passed for stems that rest."""
    rest, stop = "re-sticking", "travel-limit"
    setting = Setting(Plant(3.0, 5.0, 5.0), Controller(0.1, 5.0, scan_s=1.0), S=S, J=J, duration_s=1000.0,
                      setpoint_moves=((0.0, 3.0), (270.0, -3.0), (500.0, 4.0), (750.0, -4.0)), noise_sd=NOISE,
                      effects=((stop, {"upper": 51.5}),))
    loop = simulate(setting, seed=3).loop
    base, both = a_model(loop, (rest,)), a_model(loop, (rest, stop))
    wrong = base.vector({"S": 1.2 * S, "J": 1.5 * J, "initial_residual_force": 0.0, "time_constant_s": 5.0,
                         "dead_time_s": 5.0, f"{rest}:restick_speed": 1e9})
    values = both.values(open_valves(both, stop, as_it_stands(base, wrong), np.random.default_rng(0)))
    slides = values[both.rows_of(rest).start] == 0.0
    apart = np.abs(np.stack([values[0] / S, values[1] / J]) - 1.0).max(axis=0)
    assert 0 < slides.sum() < slides.size and apart[slides].min() < 0.1 < apart[~slides].min()
