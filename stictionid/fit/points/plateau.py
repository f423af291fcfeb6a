"""One point for all that lie on one plateau of the cost: the end of every fit under a held command.

A held command jumps over every force between two of its values. So a range of the break-away force f_s, with kinetic
friction f_d and start e(0) unchanged, moves the valve in the very same way. A search ends anywhere on it. The numbers
that move nothing there are the null space of the slopes of the residuals: f_s, and with an effect on the friction its
part in f_s. Beside them e(0) belongs to it where the first slip hides it.

All other numbers descend with these fixed: a descent in S and J alone moves f_s as well, and stops at the first step of
the cost. Then the numbers of the null space take the middle of their plateau, which has the smallest expected error.

The e(0) of the first slip has an optimum for every sample and direction of that slip, so that it is sought on a ladder.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...model.model import Model
from ...numerics.gauss_newton import descend, slopes_at
from ...typing import BoolArray, FloatArray, IntArray
from .moves import even_steps

# Twice the log-likelihood within which points are on one plateau, and the share of the energy of y that a record
# without noise allows. Its square counts.
_ALIKE, _NOISELESS = 0.1, 1e-9
# Differences behind the slopes as a share of the range, the share of the largest slope below which one is rounding, and
# the same of the singular values of scaled slopes. In 12 loops those were below 1e-7 or above 1e-2. At the end of a
# plateau, where a difference has one side only, it is as inexact as it is long.
_DIFFERENCE, _NO_SLOPE, _NO_VALUE = 1e-5, 1e-7, 1e-4
# Descents and middles; the move, as a share of the plateau, that ends them; first differences of a descent along one
# direction of all numbers, and the share of the cost at which it has settled.
_TURNS, _STILL, _STEP, _SETTLED = 4, 0.01, 3e-5, 1e-9
# Moves, as shares of the range, between which the end of a plateau is sought first.
_LADDER = np.geomspace(1e-6, 0.1, 30)
# Points of a plateau of several dimensions, turns in which the region that they cover takes its shape, and its size in
# multiples of that of an even distribution.
_POINTS, _SHAPES, _WIDER = 512, 12, 1.25
# Initial forces tried, as shares of their range, rungs about each minimum in shares of the last step, how often, and
# the share of the cost by which two rungs differ.
_FORCES, _ZOOM, _ZOOMS, _FLAT = np.linspace(0.0, 1.0, 65), np.linspace(-1.0, 1.0, 9), 3, 1e-9
# Shares of the way to an end of an interval that are tried, and the share of a plateau that holds its middle 90 %.
_SHRUNK, _SHARE = 0.8 ** np.arange(20.0), 0.9
# Twice the log-likelihood within which a start gets a descent of its own.
_PROMISING = 10.0


def settle_on_plateau(model: Model, point: FloatArray) -> FloatArray:
    """Point (d,) in the middle of its plateau, all numbers that have a slope at their least cost.

    The e(0) of every first slip is a start. The point stays where the command moves between samples, or where S is
    given: there the cost is smooth.
    """
    if not (model.spec.held and model.space.movable[0]):
        return point
    starts = np.concatenate([point[None], _other_starts(model, point)])
    costs = model.costs(starts)
    if not 0.0 < costs[0] < np.inf:
        return point
    for start in starts[1:][costs[1:] <= _limit(model, float(costs.min()), _PROMISING)]:
        # (each class of first slips has slopes of its own)
        other = _descend_along(model, start, _directions(model, start)[1])
        point = min(point, other, key=lambda p: float(model.costs(p[None])[0]))
    for _ in range(_TURNS):
        flat, steep = _directions(model, point)
        point = _descend_along(model, point, steep)
        if not len(flat):
            break
        point, moved = (_middle if len(flat) == 1 else _centre)(model, point, flat)
        if moved <= _STILL:
            break
    return point


def extremes(model: Model, point: FloatArray, limit: float) -> FloatArray:
    """Points (k, d) far from one (d,) in S and in J whose cost is at most `limit`, all other numbers following.

    They lie along the curvature of the likelihood on one plateau, and at the ends of that plateau. A cloud drawn beside
    another optimum holds none of them, and a grid of S with the other numbers fixed ends before them.
    """
    cost = float(model.costs(point[None])[0])
    if not (model.space.movable[0] and 0.0 < cost <= limit):
        return point[None][:0]
    flat, steep = _directions(model, point)
    along = steep * _DIFFERENCE
    slopes = (model.residuals(np.clip(point + along, 0.0, 1.0)) - model.residuals(np.clip(point - along, 0.0, 1.0)))
    # (a step may leave the values at which the model runs)
    fine = np.isfinite(slopes).all(axis=0)
    along, slopes = along[fine], slopes[:, fine]
    values = model.values(np.clip(point + along, 0.0, 1.0)) - model.values(np.clip(point - along, 0.0, 1.0))
    spread = np.linalg.pinv(slopes.T @ slopes)
    ways = []
    for number in (0, 1):
        # The direction in which S or J goes furthest for a rise of the cost.
        way = spread @ values[number]
        far = float(np.sqrt(max(values[number] @ way, 0.0)))
        if far > 0.0:
            # (both differences have two steps)
            ways.append((way / far * np.sqrt(limit - cost)) @ (2.0 * along))
    ladder = np.concatenate([-_SHRUNK, _SHRUNK])
    trial = np.concatenate([point + ladder[:, None] * way for way in ways]) if ways else point[None][:0]
    same = _limit(model, cost, _ALIKE)
    for way in flat if np.isfinite(same) else ():
        trial = np.concatenate([trial, [point + sign * _SHARE * _end(model, point, sign * way, same) * way
                                        for sign in (-1.0, 1.0)]])
    trial = trial[((trial >= 0.0) & (trial <= 1.0)).all(axis=1)]
    return trial[model.costs(trial) <= limit] if len(trial) else trial


def _limit(model: Model, cost: float, ratio: float) -> float:
    """The cost at which twice the log-likelihood is smaller by a ratio than at another cost."""
    return cost * float(np.exp(ratio / max(model.shared.rows, 1))) + _NOISELESS**2 * model.shared.target_energy


def _directions(model: Model, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions (k, d) that leave the residuals of a point (d,) as they are, and directions (m, d) of all others."""
    free = np.flatnonzero(model.space.movable)
    slopes = slopes_at(model.residuals, point[None], free, np.full((1, free.size), _DIFFERENCE))[0][0]
    size = np.linalg.norm(slopes, axis=0)
    dead = size <= _NO_SLOPE * size.max(initial=0.0)
    scale = np.where(dead, 1.0, np.maximum(size, 1e-300))
    _, values, found = np.linalg.svd(np.where(dead, 0.0, slopes) / scale, full_matrices=False)
    ways = np.zeros((free.size, point.size))
    ways[:, free] = found / scale
    ways /= np.abs(ways).max(axis=1, keepdims=True)
    none = values <= _NO_VALUE * values.max(initial=0.0)
    return ways[none], ways[~none]


def _descend_along(model: Model, point: FloatArray, steep: FloatArray) -> FloatArray:
    """Point (d,) after a descent along the directions `steep` (m, d).

    Moves are searched as shares of a cube of their own, whose middle is the point.
    """

    def at(shares: FloatArray) -> FloatArray:
        return np.clip(point + (2.0 * shares - 1.0) @ steep, 0.0, 1.0)

    found = descend(lambda s: model.residuals(at(s), lent=True), lambda s: model.costs(at(s)),
                    np.full((1, len(steep)), 0.5), spread=_STEP, settle=_SETTLED)
    return at(found.points[:1])[0]


def _middle(model: Model, point: FloatArray, flat: FloatArray) -> tuple[FloatArray, float]:
    """Point (d,) moved to the middle of its plateau along one direction (1, d), and the move as its share."""
    same = _limit(model, float(model.costs(point[None])[0]), _ALIKE)
    ends = np.array([_end(model, point, way, same) for way in (-flat[0], flat[0])])
    move, wide = 0.5 * float(ends[1] - ends[0]), float(ends.sum())
    moved = point + move * flat[0]
    if not (wide > 0.0 and float(model.costs(moved[None])[0]) <= same):
        return point, 0.0
    return moved, abs(move) / wide


def _end(model: Model, point: FloatArray, way: FloatArray, same: float) -> float:
    """The move along a direction (d,) at which the plateau of a point (d,) ends, whose cost is at most `same`."""
    return end_of_ladder(_LADDER, lambda moves: _on_plateau(model, point + moves[:, None] * way, same))


def _on_plateau(model: Model, trial: FloatArray, same: float) -> BoolArray:
    """Mask (k,) of the points (k, d) inside the unit cube whose cost is at most `same`."""
    inside = ((trial >= 0.0) & (trial <= 1.0)).all(axis=1)
    return (model.costs(np.clip(trial, 0.0, 1.0)) <= same) & inside


def end_of_ladder(ladder: FloatArray, holds: Callable[[FloatArray], BoolArray]) -> float:
    """The largest move up to which a condition holds for all moves of a ladder (k,), then of a finer one; else 0."""
    low = 0.0
    for _ in range(2):
        kept = holds(ladder)
        first = int(np.argmin(kept)) if not kept.all() else ladder.size - 1
        low, high = (float(ladder[first - 1]) if first else low), float(ladder[first])
        ladder = np.linspace(low, high, ladder.size + 1)[1:]
    return low


def _centre(model: Model, point: FloatArray, flat: FloatArray) -> tuple[FloatArray, float]:
    """Point (d,) moved to the centre of its plateau along several directions (k, d), and the move as its share.

    Points fill a box whose axes are those of the plateau's points before, until it no longer changes.
    """
    same = _limit(model, float(model.costs(point[None])[0]), _ALIKE)
    # Points that fill the cube from -1 to 1 evenly, the same in every call: a Korobov lattice (Roberts 2018).
    fill = 2.0 * ((0.5 + np.arange(_POINTS)[:, None] * even_steps(len(flat))) % 1.0) - 1.0
    ends = np.array([[_end(model, point, sign * way, same) for sign in (-1.0, 1.0)] for way in flat])
    middle, axes = np.zeros(len(flat)), np.diag(np.maximum(ends.sum(axis=1), _LADDER[0]))
    size = 0.0
    for _ in range(_SHAPES):
        moves = np.concatenate([middle[None], middle + fill @ axes])
        on = moves[_on_plateau(model, point + moves @ flat, same)]
        if len(on) <= 2 * len(flat):
            break
        middle = on.mean(axis=0)
        spread, turned = np.linalg.eigh(np.cov(on.T))
        # (the standard deviation of an even distribution is its half width over the root of 3)
        axes = _WIDER * np.sqrt(3.0 * np.maximum(spread, 0.0))[:, None] * turned.T
        before, size = size, float(np.sqrt(np.maximum(spread, 0.0)).prod())
        if abs(size - before) <= _STILL * size:
            break
    moved = point + middle @ flat
    wide = float(np.abs(axes).sum(axis=0).max())
    if not (wide > 0.0 and float(model.costs(moved[None])[0]) <= same):
        return point, 0.0
    return moved, float(np.abs(middle).max()) / (2.0 * wide)


def _other_starts(model: Model, point: FloatArray) -> FloatArray:
    """Points (k, d) that differ from one (d,) in the e(0) of one segment: the best of every class of first slips."""
    found = []
    for row in model.forces:
        least, width = _FORCES, float(_FORCES[1] - _FORCES[0])
        for turn in range(1 + _ZOOMS):
            forces = np.clip(least[:, None] + width * _ZOOM, 0.0, 1.0) if turn else least[None]
            trial = point[None].repeat(forces.size, axis=0)
            trial[:, row] = forces.ravel()
            cost = model.costs(trial).reshape(forces.shape)
            if turn:
                least, width = forces[np.arange(len(forces)), cost.argmin(axis=1)], 2.0 * width / (_ZOOM.size - 1)
            else:
                least = least[_minima(cost[0])]
        trial = point[None].repeat(least.size, axis=0)
        trial[:, row] = least
        found.append(trial)
    return np.concatenate(found)


def _minima(cost: FloatArray) -> IntArray:
    """Indices of the minima of a ladder of costs (m,), the first of each flat run of rungs."""
    cost = np.where(np.isfinite(cost), cost, np.finfo(float).max)
    at = np.flatnonzero(np.append(True, np.abs(np.diff(cost)) > _FLAT * cost[:-1]))
    level = np.concatenate([[np.inf], cost[at], [np.inf]])
    return at[(level[1:-1] < level[:-2]) & (level[1:-1] < level[2:])]
