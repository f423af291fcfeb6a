"""The end of a fit under a held command: one point for a whole plateau of the cost, and intervals around that point.

Those beside asymmetric stiction are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from loops_with_effects import NOISE, small

from stictionid.fit.fit import finish_fit
from stictionid.fit.points.plateau import extremes, settle_on_plateau
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.record.oscillation import find_range


@cache
def made(name: str, seed: int) -> tuple[Model, np.ndarray]:
    """The model of a small record with one effect, and its values (d,) with which the record was made."""
    setting, loop = small(name, seed=seed, duration_s=600.0)
    found = find_range(loop)
    model = Model(loop, Spec(effects=(name,)), s_max=found.s_max, period_s=found.period_median_s)
    hidden = dict(setting.effects)[name]
    effect = {n: hidden.get(n.partition(":")[2], 0.0) for n in model.named(np.zeros(model.space.size)) if ":" in n}
    plant = {"time_constant_s": setting.plant.time_constant_s, "dead_time_s": setting.plant.dead_time_s}
    return model, model.vector({"S": setting.S, "J": setting.J, "initial_residual_force": 0.5, **plant, **effect})


@cache
def ended(name: str, seed: int) -> tuple[Model, np.ndarray, dict[str, tuple[float, float]]]:
    """The model, its values (d,) and its intervals where a fit from the values of the record ends."""
    model, values = made(name, seed)
    point = model.cube(values[:, None])
    fit = finish_fit(model, point, model.costs(point), np.random.default_rng(0))
    return model, fit.values, fit.intervals


@pytest.mark.parametrize("name", ["gain-drift"])
def test_every_point_of_a_plateau_ends_in_its_middle(name: str) -> None:
    model, values, spans = ended(name, 22)
    low, high = spans["S"]
    cost = model.costs_of(values[:, None])[0]
    ends = []
    for share in (-0.3, 0.0, 0.3):
        # (the same kinetic friction and the same start in %: a part of the plateau, which slips do not show)
        moved = values.copy()
        moved[:2] += share * (high - low) * 0.3
        moved[list(model.forces)] *= values[:2].sum() / moved[:2].sum()
        ends.append(model.values(settle_on_plateau(model, model.cube(moved[:, None])[0])[None])[:, 0])
    assert all(model.costs_of(end[:, None])[0] <= cost * 1.001 for end in ends)
    for i, span in enumerate((spans["S"], spans["J"])):
        assert np.ptp([end[i] for end in ends]) < 0.1 * (span[1] - span[0])


def test_a_start_in_another_class_of_first_slips_is_left() -> None:
    model, values, spans = ended("gain-drift", 22)
    cost = model.costs_of(values[:, None])[0]
    for force in (-0.95, 0.0, 0.95):
        moved = values.copy()
        moved[list(model.forces)] = force
        end = settle_on_plateau(model, model.cube(moved[:, None])[0])
        assert model.costs(end[None])[0] <= cost * 1.001
        assert abs(model.values(end[None])[0, 0] - values[0]) < 0.1 * (spans["S"][1] - spans["S"][0])


@pytest.mark.parametrize(("name", "seed"), [("positioner", 23)])
def test_an_interval_is_as_wide_as_the_curvature_of_the_likelihood_allows(name: str, seed: int) -> None:
    """A positioner had a J known to 0.00005 %, beside a better point that a scan of S had found at the end."""
    model, values, spans = ended(name, seed)
    best = model.evaluate(values)
    assert best.rmse < 1.3 * NOISE
    point = model.cube(values[:, None])[0]
    far = model.values(extremes(model, point, best.sse * np.exp(2.7 / best.rows)))
    for i, which in enumerate("SJ"):
        low, high = spans[which]
        assert high - low > 1e-3 * values[i] and low <= values[i] <= high
        assert low - 1e-9 <= far[i].min() and far[i].max() <= high + 1e-9


def test_no_point_that_bounds_an_interval_is_excluded_itself() -> None:
    model, values, _ = ended("positioner", 23)
    point = model.cube(values[:, None])[0]
    limit = 1.01 * float(model.costs(point[None])[0])
    far = extremes(model, point, limit)
    assert len(far) and (model.costs(far) <= limit).all()
    assert not len(extremes(model, point, 0.5 * limit))


def test_the_points_that_bound_an_interval_do_not_depend_on_the_unit_of_y() -> None:
    model, values, _ = ended("gain-drift", 22)
    loop, point = model.loop, model.cube(values[:, None])[0]
    assert loop.setpoint is not None
    kilo = Model(replace(loop, process_value=1e-3 * loop.process_value, setpoint=1e-3 * loop.setpoint), model.spec,
                 s_max=model.s_max, period_s=model.period_s)
    one, other = (extremes(m, point, 1.05 * float(m.costs(point[None])[0])) for m in (model, kilo))
    assert len(one) == len(other) > 0
    np.testing.assert_allclose(one, other, atol=1e-3)
