"""Effects hidden behind others: narrow basins, a second lag beside a valve effect, misfit that differences of y hide.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loops_with_effects import loop_of

from stictionid.effects import get
from stictionid.fit.intervals.assemble import effective_rows
from stictionid.fit.points.fitted import as_it_stands
from stictionid.fit.points.moves import thin_model
from stictionid.fit.starts import continuation
from stictionid.fit.starts.basins import grow_starts
from stictionid.fit.starts.continuation import grown_valves
from stictionid.fit.starts.reparametrised import as_natural, as_valves
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.numerics.filter_bank import LagBank
from stictionid.process.linear import Dynamics, free_run
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import swing_of, time_scale_s
from stictionid.system import evaluations


@pytest.mark.parametrize(("seed", "name"), [(307, "asymmetric-stiction"), (328, "re-sticking")])
def test_a_part_that_grows_finds_a_valve_whatever_the_process(seed: int, name: str) -> None:
    setting, loop, (kind, _), _ = loop_of(seed, name, 0.01, 0.0, 1500)
    found = find_range(loop)
    # The model is of first order, the plants are of first and second: only the valve is asked for.
    spec = Spec(effects=(name,)) if kind == "scan" else Spec(effects=(name,), between="corner", substeps=4)
    model = Model(loop, spec, s_max=swing_of(loop, found), period_s=time_scale_s(loop, found))
    points = grown_valves(model, (name,), np.random.default_rng(0))
    assert np.abs(model.values(points)[0] / setting.S - 1.0).min() < 0.03


@pytest.mark.parametrize(("parts", "lags"), [(1, 4), (3, 4), (2, 5), (1, 2)])
def test_a_bank_of_lags_costs_what_least_squares_with_its_columns_leave(parts: int, lags: int) -> None:
    """Rows that don't count lie in the middle, too, so that windows have edges there for every delay."""
    rng = np.random.default_rng(5)
    n, lags_s, delays = 160, [30.0, 9.0, 4.0, 1.5, 0.7][:lags], [0, 2, 7]
    y, count = rng.standard_normal(n).cumsum(), np.arange(n) >= 12
    count[[40, 41, 90]] = False
    path = 50.0 + rng.standard_normal((n * parts, 70)).cumsum(axis=0)
    path[:, 3] = 50.0
    found = LagBank(y, count, lags_s, 20.0, delays, step_s=2.0, parts=parts).costs(path)
    for lane in (0, 69):
        left = []
        for d in delays:
            columns = [np.ones(n), np.exp(-0.1 * np.arange(n))]
            for T in lags_s:
                lag = Dynamics(np.array([T]), np.zeros(1), np.zeros(1), False)
                response = free_run(path[:, [lane]], lag, step_s=2.0, substeps=parts)[:, 0]
                columns.append(np.append(np.zeros(d), response[:n - d]))
            design = np.stack(columns, axis=1)[count]
            sizes = np.linalg.lstsq(design, y[count], rcond=None)[0]
            left.append(np.sum((y[count] - design @ sizes) ** 2))
        assert found[lane] == pytest.approx(min(left), rel=1e-8)
    assert np.isinf(found[3])


def test_natural_numbers_of_a_valve_that_overshoots_come_back() -> None:
    """A search along them, which needs several generators, is in benchmarks/long."""
    _, loop, _, _ = loop_of(335, "slip-overshoot", 0.01, 0.0, 400)
    model = Model(loop, Spec(effects=("slip-overshoot",)), s_max=8.0, period_s=60.0)
    middle = model.named(model.values(np.full((1, model.space.size), 0.5))[:, 0])
    cube = model.cube(model.vector({**middle, "S": 5.0, "J": 2.0})[:, None])
    again, possible = as_valves(model, as_natural(model, cube))
    assert possible.all()
    assert np.allclose(again, cube, atol=1e-9)


def test_valves_that_were_grown_are_remembered_where_only_the_process_is_another(
        monkeypatch: pytest.MonkeyPatch) -> None:
    _, loop, _, _ = loop_of(328, "re-sticking", 0.01, 0.0, 400)
    span = {"s_max": 8.0, "period_s": 60.0}
    first, second = np.random.default_rng(3), np.random.default_rng(3)
    evaluations.answers()
    before = evaluations.samples_spent()
    found = grown_valves(Model(loop, Spec(effects=("re-sticking",)), **span), ("re-sticking",), first)
    asked = evaluations.answers()
    after = Model(loop, Spec(effects=("re-sticking", "extra-lag"), process="integrator"), **span)
    at = after.rows_of("re-sticking").start

    def searched(*_: object, **__: object) -> None:
        raise AssertionError("searched again")

    monkeypatch.setattr(continuation, "LagBank", searched)
    again = grown_valves(after, ("re-sticking",), second)
    # A budget is charged as much as by a process that does not remember, and by a search once for each question.
    assert evaluations.answers() == asked and min(asked.values()) > 0 and evaluations.samples_spent() == before
    np.testing.assert_array_equal(again[:, [0, 1, 2, at]], found[:, [0, 1, 2, 5]])
    assert first.random() == second.random()
    moved = replace(loop, output=loop.output + 1e-3 * (np.arange(loop.samples) == 200))
    with pytest.raises(AssertionError, match="again"):
        grown_valves(Model(moved, Spec(effects=("re-sticking",)), **span), ("re-sticking",), np.random.default_rng(3))


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_the_independent_rows_do_not_depend_on_the_unit_of_y(unit: float) -> None:
    """A wrong model's errors remember, so that they are worth few rows."""
    _, loop, _, _ = loop_of(506, None, 0.01, 0.0, 600)
    found = find_range(loop)
    span = {"s_max": swing_of(loop, found), "period_s": time_scale_s(loop, found)}
    true = {"S": 5.0, "J": 3.0, "initial_residual_force": 0.0, "time_constant_s": 5.0, "dead_time_s": 5.0}
    model = Model(loop, Spec(), **span)
    y = model.evaluate(model.vector(true)).model + 0.1 * np.random.default_rng(0).standard_normal(loop.samples)
    model = Model(replace(loop, process_value=unit * np.nan_to_num(y)), Spec(), **span)
    fits = []
    for S in (5.0, 4.0):
        fits.append(as_it_stands(model, model.vector(true | {"S": S})))
    right, wrong = fits
    assert effective_rows(wrong.best.residual, model.weight) < 0.1 * effective_rows(right.best.residual, model.weight)


@pytest.mark.parametrize("seed", [707, 719])
def test_a_stroke_so_slow_that_the_loop_swings_ever_wider_is_in_the_range(seed: int) -> None:
    """Such a stem moves less than half the swing of the command in a period, far slower than any slip."""
    setting, loop, _, _ = loop_of(seed, "slew-limit", 0.01, 0.0, 1500)
    found, rate = find_range(loop), dict(setting.effects)["slew-limit"]["rate"]
    model = Model(loop, Spec(effects=("slew-limit",)), s_max=swing_of(loop, found), period_s=time_scale_s(loop, found))
    assert rate < 0.5 * model.s_max / model.period_s
    limits, guess = model.space.parameters[model.rows_of("slew-limit").start], get("slew-limit").guess
    assert guess is not None
    assert 2.0 * limits.low < rate < limits.high
    assert np.abs(np.log(guess(model.context) / rate)).min() < np.log(3.0)


@pytest.mark.parametrize("every", [1, 2, 3, 5])
def test_a_stem_moves_in_whole_parts_of_every_command_of_a_thinned_record(every: int) -> None:
    setting = Setting(Plant(1.2, 20.0, 4.0), Controller(0.7, 12.0, scan_s=1.0), S=4.0, J=2.0, duration_s=200.0,
                      setpoint_moves=((0.0, 3.0),))
    model = Model(simulate(setting, seed=1).loop, Spec(effects=("slew-limit",)), s_max=8.0, period_s=60.0)
    small = thin_model(model, every)
    position = small.positions(small.values(np.full((1, small.space.size), 0.5)))
    assert len(position) == small.loop.samples * small.parts
    assert small.parts % every == 0


def test_a_growing_search_scans_what_an_effect_does_to_friction() -> None:
    """With the effect at neutral at first it ends elsewhere: a valve that never rests has other slips everywhere."""
    moves = tuple((60.0 * i, (3.0, -4.0, 2.5, -1.5)[i % 4]) for i in range(25))
    setting = Setting(Plant(0.1, 3.0, 2.0, integrating=True), Controller(0.6, 60.0, scan_s=1.0), 4.9, 3.0,
                      setpoint_moves=moves, noise_sd=0.02, duration_s=1500.0,
                      effects=(("re-sticking", {"restick_speed": 0.4}),))
    loop = replace(simulate(setting, seed=4).loop, position=None)
    found = find_range(loop)
    model = Model(loop, Spec(process="integrator", effects=("re-sticking",)), s_max=swing_of(loop, found),
                  period_s=time_scale_s(loop, found))
    best = min((model.values(start[None])[:, 0] for start in grow_starts(model, np.random.default_rng(0))),
               key=lambda values: float(model.costs_of(values[:, None])[0]))
    assert pytest.approx(setting.S, rel=0.01) == best[0]
    assert pytest.approx(setting.J, rel=0.01) == best[1]
