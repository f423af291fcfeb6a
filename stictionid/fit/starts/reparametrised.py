"""Search in the coordinates that slips identify (swing and slip), for a valve whose slips do not show S and J directly.

A stem that overshoots by K - 1 slips when the command has swung by S - (K - 1) J. That swing is known to a part in a
thousand, K and the slip hardly, and S and J only together with them. In S, J and K the points of nearly equal cost form
an oblique curve a thousandth wide. The cost has a step for every slip that comes a sample early or late, so that no
polish follows it. In the effect's natural numbers (see `effects.contract`) the curve is straight. An even grid crosses
the steps, and the process changes smoothly from valve to valve. Measured on 9 scanned loops that a search along S and J
missed, two seeds each: 14 of 18 end at the noise. Source: docs/details.md, section 6.3; He and Wang 2010.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...effects.contract import Natural
from ...model.model import Model
from ...numerics.population import Found, best_first, join_found, refine
from ...typing import BoolArray, FloatArray
from ..points.moves import behind_valve, first_apart, spreads, valve_grid, with_start

# Grids around a valve, from a first one to one between the samples that all slips allow. Each has a reach of the swing,
# of the slip (factor) and of the effect (share of its range). Then the points of each axis.
_REACHES = ((0.006, 1.35, 0.3), (0.003, 1.15, 0.15), (0.0015, 1.3, 0.1), (0.001, 1.05, 0.05))
_POINTS = (41, 7, 25)
# Valves of a grid that get a process of their own and a polish, costs looked at, and distance in slip (share) and
# effect.
_KEPT, _LOOKED, _SLIP_APART, _EFFECT_APART = 3, 1000, 0.08, 0.04
_TURNS, _SETTLE = 6, 1e-3
# First standard deviations of a polish, as shares of the usual ones, and of those for the swing.
_SPREAD, _SWING = 0.4, 0.3
_ROUNDS, _POPULATION, _SETTLED = 40, 14, 1e-4
# A turn is followed by another one while it lowers the cost by this share.
_WORTH = 0.01


def ridge_of(model: Model) -> tuple[Natural, slice] | None:
    """The natural numbers of a model and the rows of the effect that has them, or None."""
    for effect, rows in zip(model.effects, model.effect_rows, strict=True):
        if effect.natural is not None:
            return effect.natural, rows
    return None


def as_valves(model: Model, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Points (k, d) whose first two parameters are natural numbers, in S and J; and a mask (k,) of the possible ones.

    The first natural number ranges up to the largest S without the effect, the second up to the longest slip of each
    swing.
    """
    ridge = ridge_of(model)
    if ridge is None:
        return points, np.ones(len(points), bool)
    natural, rows = ridge
    theta = model.values(points)[rows]
    swing = _swing(model) * points[:, 0]
    slip = swing * points[:, 1] * model.space.parameters[1].high * natural.longest(theta)
    stickband, share = model.space.parameters[:2]
    S, J = natural.valve(swing, slip, theta, model.context)
    moved = points.copy()
    moved[:, 0] = (S - stickband.low) / (stickband.high - stickband.low)
    moved[:, 1] = J / np.maximum(S, 1e-12) / share.high
    possible: BoolArray = np.all((moved[:, :2] >= 0.0) & (moved[:, :2] <= 1.0), axis=1)
    return np.clip(moved, 0.0, 1.0), possible


def natural_costs(model: Model, points: FloatArray) -> FloatArray:
    """Costs (k,) of points (k, d) whose first two parameters are natural numbers; infinite for impossible ones."""
    valves, possible = as_valves(model, points)
    return np.where(possible, model.costs(valves), np.inf)


def as_natural(model: Model, points: FloatArray) -> FloatArray:
    """The inverse of `as_valves`: points (k, d) with natural numbers in place of S and J."""
    ridge = ridge_of(model)
    if ridge is None:
        return points
    natural, rows = ridge
    values = model.values(points)
    swing, slip = natural.numbers(values[0], values[1], values[rows], model.context)
    moved = points.copy()
    moved[:, 0] = swing / _swing(model)
    longest = np.maximum(swing, 1e-12) * model.space.parameters[1].high * natural.longest(values[rows])
    moved[:, 1] = slip / longest
    return np.clip(moved, 0.0, 1.0)


def _swing(model: Model) -> float:
    """The largest swing: the largest S where no effect extends it."""
    return model.space.parameters[0].high / max(effect.reach for effect in model.effects)


def follow_ridge(model: Model, points: FloatArray, rng: np.random.Generator) -> Found:
    """Points (k, d) followed along the model's curve of equal cost, best first; without such a curve they stay.

    Grids narrow down; each is followed by the process of the best valves and a polish, as long as the cost falls.
    """
    found = best_first(points, model.costs(points))
    if ridge_of(model) is None or not np.isfinite(found.costs[0]):
        return found
    near, spread = _with_process(model, found.points), spreads(model, _SPREAD)
    spread[0] *= _SWING
    for turn, reach in enumerate(_REACHES):
        scanned = np.concatenate([near, *(_scan_valves(model, p, reach) for p in near[:_KEPT if turn == 0 else 1])])
        near = _with_process(model, scanned)[:_KEPT]
        polished = refine(partial(natural_costs, model), as_natural(model, near), rng, spread=spread, rounds=_ROUNDS,
                          population=_POPULATION, settle=_SETTLED)
        last = Found(as_valves(model, polished.points)[0], polished.costs)
        worth = last.costs[0] < found.costs[0] * (1.0 - _WORTH)
        if last.costs[0] < found.costs[0]:
            near, found = last.points, join_found(last, found)
        if turn and not worth:
            break
    return found


def _with_process(model: Model, points: FloatArray) -> FloatArray:
    """Points (k, d), best first, each with its own start and the process that fits its valve."""
    return behind_valve(model, with_start(model, points), slice(0, 0), turns=_TURNS, settle=_SETTLE).points


def _scan_valves(model: Model, point: FloatArray, reach: tuple[float, float, float]) -> FloatArray:
    """The best valves (k, d) of an even grid about a point (d,), distinct in slip and effect."""
    ridge = ridge_of(model)
    assert ridge is not None
    natural, rows = ridge
    values = model.values(point[None])
    swing, slip = natural.numbers(values[0], values[1], values[rows], model.context)
    space = model.space.parameters[rows.start]
    wide = reach[2] * (space.high - space.low)
    a, b, e = (axis.ravel() for axis in np.meshgrid(
        swing * (1.0 + np.linspace(-reach[0], reach[0], _POINTS[0])),
        slip * np.geomspace(1.0 / reach[1], reach[1], _POINTS[1]),
        np.clip(values[rows.start] + np.linspace(-wide, wide, _POINTS[2]), space.low, space.high), indexing="ij"))
    S, J = natural.valve(a, b, e[None], model.context)
    possible = (J >= 0.0) & (model.space.parameters[1].high * S >= J) & (model.space.parameters[0].high >= S)
    slips, effects = b[possible], e[possible]
    trial = valve_grid(values[:, 0], S[possible], J[possible])
    trial[rows.start] = effects
    cube = model.cube(trial)
    return cube[first_apart(
        np.argsort(model.costs(cube), kind="stable")[:_LOOKED].tolist(), _KEPT,
        lambda k, j: bool(abs(effects[k] - effects[j]) > _EFFECT_APART
                          or abs(slips[k] / slips[j] - 1.0) > _SLIP_APART))]
