"""An evolution strategy with niches: points in neighbouring basins of a valve with several effects, best first.

Under a held command the cost has a step at every sample at which a valve might break away. With two effects on the
friction the way to the right S, J and sizes crosses many steps in all directions at once. A polish of one point stops
after a few. One valve costs a few microseconds on a whole record. Hundreds are therefore drawn about each of several
points, at all distances. The best get a process that fits them and a polish; the best distinct ones of old and new
survive. Measured on 3 scanned records with two effects on the friction, two seeds each, 1 % noise. The error fell from
1.6 to 3.8 times the noise to 1.0 to 1.8, in half a second. With one point in place of several it fell to 1.2 to 2.2.

Source: evolution strategies, Beyer and Schwefel 2002; docs/details.md, section 6.3.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from ...model.model import Model
from ...numerics.population import Found, join_found, refine
from ...typing import FloatArray
from ..points.moves import behind_valve, cheapest_apart, first_apart, spreads, with_start
from .reparametrised import as_natural, as_valves, natural_costs

# Points that survive, neighbours drawn about each, those that get a process, and those that get a polish.
_HERD, _DRAWN, _WITH_PROCESS, _POLISHED = 10, 250, 30, 8
# Distances of the neighbours, as multiples of the usual spread of a polish; standard deviation of the initial forces.
_NEAR, _FAR, _FORCE = 0.08, 3.0, 0.2
# Share of the neighbours in which one parameter is drawn anew: an effect may stand for another one.
_LEAPS = 0.3
# Points are distinct that lie apart by these shares of the range in S or in J.
_APART = (0.003, 0.02)
# The strategy ends after PATIENCE turns without a gain of the share _WORTH, and after _TURNS times as many at most.
# Then turns of the descent of the process, and the fall of the cost at which a polish has settled.
PATIENCE, _WORTH, _TURNS, _DESCENT, _SETTLED = 6, 0.01, 5, 3, 1e-4
# Patience of a population from a single point, which first has to meet a second basin. Measured on uneven jumps with a
# stop, from 15 times the noise: 7 of 8 seeds at the noise in 2.4 s. With the patience above none were, in 0.9 s. With a
# drift, from 6 to 23 times the noise: 9 of 10, against 1.
ALONE = 20
# Valves beyond the kinetic friction at which a drifting one rests: drawn, started, and kept. Then the ranges of S, J
# and the growth of S (logarithms), and of the growth of J as a share of that. Last the standard deviation of other
# effects' parameters (shares of their ranges), and the distance between kept valves.
_BEYOND, _STARTED, _CROSSED = 4000, 200, 16
_CROSS_S, _CROSS_J, _CROSS_GROWTH, _CROSS_SHARE = (-0.25, 0.12), (-0.25, 0.4), (-0.7, 0.7), (-0.3, 0.95)
_CROSS_OTHER, _CROSS_APART = 0.03, 0.01


def evolve_points(model: Model, points: FloatArray, rng: np.random.Generator, patience: int = PATIENCE) -> Found:
    """Points (k, d) of the unit cube, evolved as a population by the model's cost; the best distinct ones, best first.

    The strategy ends after `patience` turns without a gain. Neighbours are drawn along the natural numbers of the valve
    (see reparametrised.py), where it has any. Wrong where the right basin is further from all points than a tenth of
    the range.
    """
    herd = _distinct_niches(Found(points, model.costs(points)))
    spread = spreads(model)
    spread[list(model.forces)] = _FORCE
    left, best = patience, float(herd.costs[0])
    for _ in range(_TURNS * patience):
        natural = as_natural(model, herd.points)
        k, d = natural.shape
        reach = np.exp(rng.uniform(np.log(_NEAR), np.log(_FAR), (k, _DRAWN, 1)))
        drawn = np.clip(natural[:, None] + reach * spread * rng.standard_normal((k, _DRAWN, d)), 0.0, 1.0)
        _leap(model, drawn, rng)
        costs = natural_costs(model, drawn.reshape(-1, d)).reshape(k, _DRAWN)
        own = np.argsort(costs, axis=1, kind="stable")[:, :max(_WITH_PROCESS // k, 1)]
        near = behind_valve(model, as_valves(model, drawn[np.arange(k)[:, None], own].reshape(-1, d))[0], slice(0, 0),
                            turns=_DESCENT, settle=_WORTH)
        last = refine(partial(natural_costs, model), as_natural(model, near.points[:_POLISHED]), rng,
                      spread=spreads(model, 0.3), rounds=40, population=14, settle=_SETTLED)
        herd = _distinct_niches(join_found(herd, replace(last, points=as_valves(model, last.points)[0])))
        left = patience if herd.costs[0] < best * (1.0 - _WORTH) else left - 1
        best = min(best, float(herd.costs[0]))
        if not left:
            break
    return herd


def beyond_rest(model: Model, point: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Points (k, d) with growing kinetic friction, about a point (d,) without; none where they cannot matter.

    None where the friction grows already, where the command moves between samples, or where nothing drifts. Under a
    held command a sliding stem whose kinetic friction grows rests at every scan: another law, with another S and J.
    With a second effect missing, a drift ends on the near side of that limit, S and J growing alike; no small move
    crosses it. Measured on a drift beside a stop: from 2.6 times the noise to 1.00 to 1.03, 4 seeds of 4.
    """
    grown = next((rows for effect, rows in zip(model.effects, model.effect_rows, strict=True)
                  if effect.drifts), None)
    values = model.values(point[None])
    if grown is None or not model.spec.held or values[grown.start, 0] > values[grown.start + 1, 0]:
        return np.empty((0, point.size))
    low, high = (np.array([getattr(p, end) for p in model.space.parameters]) for end in ("low", "high"))
    drawn = values.repeat(_BEYOND, axis=1)
    for effect, rows in zip(model.effects, model.effect_rows, strict=True):
        if effect.friction is not None and not effect.profile:
            drawn[rows] += _CROSS_OTHER * (high - low)[rows, None] * rng.standard_normal(drawn[rows].shape)
    drawn[0] *= np.exp(rng.uniform(*_CROSS_S, _BEYOND))
    drawn[1] *= np.exp(rng.uniform(*_CROSS_J, _BEYOND))
    least = _NEAR * high[grown.start]
    drawn[grown.start] = np.maximum(values[grown.start], least) * np.exp(rng.uniform(*_CROSS_GROWTH, _BEYOND))
    drawn[grown.start + 1] = drawn[grown.start] * rng.uniform(*_CROSS_SHARE, _BEYOND)
    cube = model.cube(np.clip(drawn, low[:, None], high[:, None]))
    cube = with_start(model, cube[np.argsort(model.costs(cube), kind="stable")[:_STARTED]])
    return cheapest_apart(model, cube, cube[:, :2], _CROSSED, _CROSS_APART)


def _leap(model: Model, drawn: FloatArray, rng: np.random.Generator) -> None:
    """Draw one parameter anew, J or one of an effect, in a share of the neighbours (k, m, d)."""
    free = np.array([1, *range(model.head, model.space.size)])
    count = int(_LEAPS * drawn.shape[1])
    which = free[rng.integers(free.size, size=(len(drawn), count))]
    drawn[np.arange(len(drawn))[:, None], np.arange(count), which] = rng.random((len(drawn), count))


def _distinct_niches(found: Found) -> Found:
    """The best points that lie apart, best first."""
    valves = found.points[:, :2]
    kept = first_apart(np.argsort(found.costs, kind="stable").tolist(), _HERD,
                       lambda i, j: bool(np.any(np.abs(valves[i] - valves[j]) > _APART)))
    return Found(found.points[kept], found.costs[kept])
