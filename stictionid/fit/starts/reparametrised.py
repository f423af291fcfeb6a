"""The ridge of a valve whose slips show other numbers than S and J: how it is searched, and followed to its end.

A stem that overshoots by K - 1 slips when the command has swung by S - (K - 1) J: that is known to a part in a
thousand, K and the slip hardly, and S and J only together with them. Along S, J and K the cost is a ridge that slants
through all three and is a thousandth wide, with a step for every slip that comes a sample early or late: no polish
follows it. Along the effect's natural numbers (see `effects.contract`) it is straight: an even scan crosses the steps,
and what the process takes from each valve is smooth.

Measured on 9 scanned loops that a search along S and J missed, two seeds each: 14 of 18 end at the noise.
Source: METHODS.md section 4, trap 3; He and Wang 2010.
"""

from __future__ import annotations

import numpy as np

from ...effects.contract import Natural
from ...model.model import Model
from ...numerics.population import Found, refine
from ...typing import BoolArray, FloatArray
from ..moves import behind_valve, spreads, with_start

# Scan around a valve: reach of the swing, of the slip (factor) and of the effect (share of its range), points of each,
# from a first one to one between the samples that all slips allow.
_REACHES = ((0.006, 1.35, 0.3), (0.003, 1.15, 0.15), (0.0015, 1.3, 0.1), (0.001, 1.05, 0.05))
_POINTS = (41, 7, 25)
# Valves of a scan that get a process of their own and a polish; how far apart they are in slip (share) and effect.
_KEPT, _LOOKED, _SLIP_APART, _EFFECT_APART = 3, 1000, 0.08, 0.04
_TURNS, _SETTLE = 6, 1e-3
# First standard deviations of a polish, as shares of the usual ones, and of those for the swing.
_SPREAD, _SWING = 0.4, 0.3
_ROUNDS, _POPULATION, _SETTLED = 40, 14, 1e-4
# A turn is worth another one while it lowers the cost by this share.
_WORTH = 0.01


def ridge_of(model: Model) -> tuple[Natural, slice] | None:
    """The natural numbers of a model and where the effect that has them is, or None."""
    for effect, rows in zip(model.effects, model.effect_rows, strict=True):
        if effect.natural is not None:
            return effect.natural, rows
    return None


def as_valves(model: Model, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Points (k, d) whose first two numbers are natural ones as the model has them, and whether that can be (k,).

    The first runs up to where S does without the effect, the second up to the longest slip of each swing.
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
    """The largest swing: the largest S where no effect lets it reach further."""
    return model.space.parameters[0].high / max(effect.reach for effect in model.effects)


def followed(model: Model, points: FloatArray, rng: np.random.Generator) -> Found:
    """Points (k, d) followed along the ridge of a model, best first: scans that narrow down, the process of what they
    find, and a polish, as long as that is worth it. Without a ridge they are what they were.
    """
    costs = model.costs(points)
    order = np.argsort(costs, kind="stable")
    points, costs = points[order], costs[order]
    if ridge_of(model) is None or not np.isfinite(costs[0]):
        return Found(points, costs, 0)
    near = _with_process(model, points)
    for turn, reach in enumerate(_REACHES):
        scanned = np.concatenate([near, *(_scanned(model, p, reach) for p in near[:_KEPT if turn == 0 else 1])])
        near = _with_process(model, scanned)[:_KEPT]
        last = _polished(model, near, rng)
        worth = last.costs[0] < costs[0] * (1.0 - _WORTH)
        if last.costs[0] < costs[0]:
            near = last.points
            points, costs = np.concatenate([near, points]), np.concatenate([last.costs, costs])
        if turn and not worth:
            break
    order = np.argsort(costs, kind="stable")
    return Found(points[order], costs[order], 0)


def _with_process(model: Model, points: FloatArray) -> FloatArray:
    """Points (k, d), best first, each with its own start and the process that goes with its valve."""
    return behind_valve(model, with_start(model, points), slice(0, 0), turns=_TURNS, settle=_SETTLE).points


def _scanned(model: Model, point: FloatArray, reach: tuple[float, float, float]) -> FloatArray:
    """The best valves (k, d) of an even scan about a point (d,), distinct in slip and effect."""
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
    trial = values.repeat(slips.size, axis=1)
    trial[0], trial[1], trial[rows.start] = S[possible], J[possible], effects
    cube = model.cube(trial)
    kept: list[int] = []
    for k in np.argsort(model.costs(cube), kind="stable")[:_LOOKED].tolist():
        if all(abs(effects[k] - effects[j]) > _EFFECT_APART or abs(slips[k] / slips[j] - 1.0) > _SLIP_APART
               for j in kept):
            kept.append(k)
        if len(kept) == _KEPT:
            break
    return cube[kept]


def _polished(model: Model, points: FloatArray, rng: np.random.Generator) -> Found:
    """Points (k, d) polished along the natural numbers, best first."""

    def cost(natural: FloatArray) -> FloatArray:
        valves, possible = as_valves(model, natural)
        return np.where(possible, model.costs(valves), np.inf)

    spread = spreads(model, _SPREAD)
    spread[0] *= _SWING
    found = refine(cost, as_natural(model, points), rng, spread=spread, rounds=_ROUNDS, population=_POPULATION,
                   settle=_SETTLED)
    return Found(as_valves(model, found.points)[0], found.costs, found.evaluations)
