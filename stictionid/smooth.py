"""Intervals of the numbers in which the cost is smooth: gain, time constants, dead time and the numbers of effects.

Points drawn at random rarely lie where one number ends: of a few hundred the outermost fall short of it by a quarter.
With the break-away as it is the residuals are smooth, so their slopes say how far each number goes on one plateau while
all others follow it at least cost; and this is asked at points all over what is possible, since slopes know little of
another plateau, or of a slip jump that is half as large. The gain is linear: it follows every other number and has a
spread of its own beside.

Wrong where a number bends the residuals within its interval more than these points show.
Source: profile likelihood, Venzon and Moolgavkar 1988; slopes of projected residuals, Golub and Pereyra 1973.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .descent import beside, principal
from .loop import FloatArray, IntArray
from .model import Model
from .moves import movable
from .profiles import spread_over

# Difference for the slopes, as a share of the range, and parts of the range of each number that are asked.
_DIFFERENCE, _PARTS = 1e-3, 2
GAIN = "gain"


def smooth_intervals(model: Model, cube: FloatArray, cost: FloatArray, limit: float) -> dict[str, tuple[float, float]]:
    """Smallest and largest possible value of the gain and of every number but those of the friction.

    `cube` (k, d) are the points that cost no more than `limit`, `cost` (k,) what they cost. Empty where the valve
    barely moves, so that beside every point it never does.
    """
    names, movers = list(model.named(np.zeros(model.space.size))), movable(model) > 0
    columns = np.arange(movers.size)
    wanted = np.flatnonzero(movers & ~np.isin(columns, (0, 1, *model.forces)))
    # Under a held command the cost has steps in the break-away, which stays what it is.
    free = np.flatnonzero(movers & ~(np.isin(columns, (0, *model.forces)) & model.spec.held))
    at = _asked(cube, cost, wanted)
    points, costs = cube[at], cost[at]
    trial, width = beside(points, free, np.full((at.size, free.size), _DIFFERENCE))
    r, gains = _residuals_and_gains(model, trial)
    r, gains = r.reshape(-1, at.size, 2 * free.size + 1), gains.reshape(at.size, -1)
    moves = np.isfinite(r).all(axis=(0, 2))
    points, costs, r, gains, width = points[moves], costs[moves], r[:, moves], gains[moves], width[moves]
    if not moves.any():
        return {}
    f = free.size
    slopes = (r[:, :, 1:f + 1] - r[:, :, f + 1:]) / width
    values, vectors, size = principal(np.einsum("nkf,nkg->kfg", slopes, slopes))
    spread = (vectors / np.maximum(values, 1e-9 * values[:, -1:] + 1e-30)[:, None]) @ np.swapaxes(vectors, 1, 2)
    spread = spread / (size[:, :, None] * size[:, None, :])
    gradient = np.einsum("nkf,nk->kf", slopes, r[:, :, 0])
    step = -np.einsum("kfg,kg->kf", spread, gradient)
    least = np.maximum(costs + np.einsum("kf,kf->k", gradient, step), cost.min())
    room = np.sqrt(np.maximum(limit - least, 0.0))
    found = {}
    for i, j in ((i, j) for i, j in enumerate(free) if j in wanted):
        middle, reach = points[:, j] + step[:, i], room * np.sqrt(spread[:, i, i])
        ends = points[:1].repeat(2, axis=0)
        ends[0, j] = max(min((middle - reach).min(), cube[:, j].min()), 0.0)
        ends[1, j] = min(max((middle + reach).max(), cube[:, j].max()), 1.0)
        found[names[j]] = tuple(model.values(ends)[j].tolist())
    if GAIN not in model.spec.fixed:
        follows = (gains[:, 1:f + 1] - gains[:, f + 1:]) / width
        middle = gains[:, 0] + np.einsum("kf,kf->k", follows, step)
        reach = room * np.sqrt(np.einsum("kf,kfg,kg->k", follows, spread, follows) + _own_spread(model, points))
        # A slip jump half as large goes with a gain twice as large, which slopes do not know.
        outermost = _residuals_and_gains(model, _outermost(cube, (1, *wanted)))[1]
        ends = np.concatenate([middle - reach, middle + reach, outermost])
        found[GAIN] = (float(ends.min()), float(ends.max()))
    return found


def _asked(cube: FloatArray, cost: FloatArray, wanted: IntArray) -> IntArray:
    """The points (m,) of which slopes are taken: the best in parts of the range of every number."""
    return np.unique(np.concatenate([[int(cost.argmin())],
                                     *(spread_over(cube[:, j], cost, _PARTS) for j in (0, 1, *wanted))]))


def _outermost(cube: FloatArray, numbers: Iterable[int]) -> FloatArray:
    """The points (m, d) of `cube` (k, d) with the least and the most of each of the numbers."""
    return cube[np.unique([at for j in numbers for at in (cube[:, j].argmin(), cube[:, j].argmax())])]


def _residuals_and_gains(model: Model, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals (n, P) as `Model.residuals` gives them and gains of the process (P,) at points (P, d), from one run."""
    if GAIN in model.spec.fixed:
        return model.residuals(points), np.full(len(points), model.spec.fixed[GAIN])
    values = model.values(points)
    r, gains = np.empty((model.loop.samples, len(points))), np.empty(len(points))
    for rows, part in model.blocks(values):
        base, offsets = model.responses(part, lent=True)
        width = rows.stop - rows.start
        sizes = model.shared.solve(base, offsets)[1]
        gains[rows] = sizes.reshape(-1, len(offsets), sizes.shape[-1])[0, 0, :width]
        r[:, rows] = model.shared.residuals(base, offsets, lent=True)[:, :width]
    return r, gains


def _own_spread(model: Model, points: FloatArray) -> FloatArray:
    """Variance (P,) of the gain for residuals of variance 1 with points (P, d) as they are."""
    own = model.own_columns(*model.responses(model.values(points)))
    used = model.weight > 0
    own, out = own[:, used], np.empty(len(points))
    shared = model.shared.basis[used]
    for p in range(len(points)):
        others = np.concatenate([own[1:, :, p].T, shared], axis=1)
        size = np.linalg.norm(others, axis=0)
        axes, known, _ = np.linalg.svd(others[:, size > 0] / size[size > 0], full_matrices=False)
        axes = axes[:, known > 1e-8 * known[0]]
        rest = own[0, :, p] - axes @ (axes.T @ own[0, :, p])
        out[p] = 1.0 / max(float(rest @ rest), 1e-300)
    return out
