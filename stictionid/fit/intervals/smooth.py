"""Intervals of the parameters in which the cost is smooth: gain, time constants, dead time and those of effects.

The outermost of a few hundred random points falls short of the end of an interval by a quarter. With the break-away
fixed the residuals are smooth. Their slopes then say how far each parameter goes on one plateau while the others follow
at least cost. Slopes are taken at points all over the possible region, since they know little of another plateau or of
a slip jump half as large. The gain is linear: it follows every other parameter and has a variance of its own. Where the
cost at such an end differs from what the slopes say, the end is moved.

Wrong where a parameter bends the residuals so much within its interval that the others follow on no straight line.
Source: profile likelihood, Venzon and Moolgavkar 1988; slopes of projected residuals, Golub and Pereyra 1973.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...model.model import Model
from ...numerics.gauss_newton import principal_axes, quotients, sides, trial_points
from ...numerics.varpro import SAME, axes
from ...typing import FloatArray, IntArray
from .profile import instant_columns, spread_over

# Step of the differences as a share of the range, and parts of each parameter's range where slopes are taken; fewer
# where the intervals are rough.
_DIFFERENCE, _PARTS, _ROUGH_PARTS = 1e-3, 3, 2
# Largest factor on an end that costs less than it may, number of looks at the ends, and ends of each parameter that are
# looked at again.
_FURTHER, _LOOKS, _KEPT = 1.3, 3, 3
GAIN = "gain"


def smooth_intervals(model: Model, cube: FloatArray, cost: FloatArray, limit: float, *,
                     rough: bool = False) -> dict[str, tuple[float, float]]:
    """Smallest and largest possible value of the gain and of every parameter except those of the friction.

    `cube` (k, d) are possible points, `cost` (k,) their costs, `limit` the largest cost that is possible. `rough`
    intervals end where the slopes say, without a look at the cost there. The result is empty where the valve barely
    moves, so that it never does beside any of the points.
    """
    names, movers = list(model.named(np.zeros(model.space.size))), model.space.movable
    steps = instant_columns(model)
    wanted = [j for j in np.flatnonzero(movers).tolist() if j not in (0, 1, *model.forces, *steps)]
    # Slopes are taken at the best point in each part of the range of every parameter.
    parts = (spread_over(cube[:, j], cost, _ROUGH_PARTS if rough else _PARTS) for j in (0, 1, *wanted))
    slopes = _Slopes.at(model, cube, cost, limit, np.unique(np.concatenate([[int(cost.argmin())], *parts])))
    if slopes is None:
        return {}
    low, high = slopes.ends(wanted, rough=rough)
    found, met = {}, model.values(cube)
    for at, j in enumerate(wanted):
        both = cube[:1].repeat(2, axis=0)
        both[:, j] = max(min(low[at], cube[:, j].min()), 0.0), min(max(high[at], cube[:, j].max()), 1.0)
        # (a stop follows from the command that releases it and the friction, which another point has otherwise)
        ends = np.append(model.values(both)[j], met[j])
        found[names[j]] = (float(ends.min()), float(ends.max()))
    if GAIN not in model.spec.fixed:
        # A slip jump half as large goes with a gain twice as large, which slopes do not know.
        outermost = np.unique([at for j in (1, *wanted) for at in (cube[:, j].argmin(), cube[:, j].argmax())])
        gains = _residuals_and_gains(model, cube[outermost])[1]
        found[GAIN] = (min(low[-1], float(gains.min())), max(high[-1], float(gains.max())))
    return found


@dataclass(frozen=True, slots=True)
class _Slopes:
    """Slopes at possible points (k, d): the way to the least cost near each, and how far the cost limit allows to go.

    `free` are the parameters (f,) that move, `step` (k, f) is the way to the least cost and `least` (k,) that cost.
    `spread` (k, f, f) is the covariance of the parameters for residuals of variance 1. The gain has its value (k,) at
    the least cost, its derivative by the parameters `follows` (k, f), and its own variance `own` (k,).
    """

    model: Model
    limit: float
    points: FloatArray
    free: IntArray
    step: FloatArray
    least: FloatArray
    spread: FloatArray
    gain: FloatArray
    follows: FloatArray
    own: FloatArray

    @classmethod
    def at(cls, model: Model, cube: FloatArray, cost: FloatArray, limit: float, asked: IntArray) -> _Slopes | None:
        """The slopes at the points `asked`; None where beside each of them the valve never moves."""
        held = (*instant_columns(model), *((0, *model.forces) if model.spec.held else ()))
        free = np.array([j for j in np.flatnonzero(model.space.movable).tolist() if j not in held], int)
        f, points, costs = free.size, cube[asked], cost[asked]
        apart = np.full((len(points), f), _DIFFERENCE)
        r, gains = _residuals_and_gains(model, trial_points(points, free, apart)[0])
        r, gains = r.reshape(-1, len(points), 2 * f + 1), gains.reshape(len(points), -1)
        moves = np.isfinite(r).all(axis=(0, 2))
        if not moves.any():
            return None
        points, costs, r, gains, apart = points[moves], costs[moves], r[:, moves], gains[moves], apart[moves]
        weights = sides(r, points[:, free], apart)
        slopes = quotients(r, *weights)
        values, vectors, size = principal_axes(np.einsum("nkf,nkg->kfg", slopes, slopes))
        spread = (vectors / np.maximum(values, 1e-9 * values[:, -1:] + 1e-30)[:, None]) @ np.swapaxes(vectors, 1, 2)
        spread = spread / (size[:, :, None] * size[:, None, :])
        gradient = np.einsum("nkf,nk->kf", slopes, r[:, :, 0])
        step = -np.einsum("kfg,kg->kf", spread, gradient)
        least = np.clip(costs + np.einsum("kf,kf->k", gradient, step), cost.min(), limit)
        follows = quotients(gains, *weights)
        gain = gains[:, 0] + np.einsum("kf,kf->k", follows, step)
        return cls(model, limit, points, free, step, least, spread, gain, follows, _own_variance(model, points))

    def ends(self, numbers: list[int], *, rough: bool) -> tuple[list[float], list[float]]:
        """Lower and upper ends of some parameters as shares of their ranges, and last of the gain, in its unit."""
        lines, room = self._lines(numbers), np.sqrt(self.limit - self.least)
        # Axes: parameter, side (down, up), point.
        signs = np.array([-1.0, 1.0])[:, None]
        middles = np.array([[middle, middle] for middle, _, _ in lines])
        reaches = np.array([signs * room * reach for _, reach, _ in lines])
        if not rough:
            ways = np.array([(signs * room)[..., None] * way for _, _, way in lines])
            reaches = self._allowed_reaches(numbers, middles, reaches, ways)
        ends = middles + reaches
        return ends[:, 0].min(axis=1).tolist(), ends[:, 1].max(axis=1).tolist()

    def _allowed_reaches(self, numbers: list[int], middles: FloatArray, reaches: FloatArray,
                         ways: FloatArray) -> FloatArray:
        """The reaches (parameter, side, point) as far as the cost on the way allows.

        The first look is at all ends, the next at those that then go furthest. The cost is taken for a parabola through
        the last look. A look that costs too much is an upper bound.
        """
        share, low, high = np.ones(reaches.shape), np.zeros(reaches.shape), np.full(reaches.shape, _FURTHER)
        at = np.indices(reaches.shape).reshape(3, -1)
        for _ in range(_LOOKS):
            n, side, k = at
            points = self.points[k]
            points[:, self.free] += self.step[k] + share[n, side, k][:, None] * ways[n, side, k]
            np.clip(points, 0.0, 1.0, out=points)
            costs = self.model.costs(points)
            gain = n == len(numbers)
            if gain.any():
                meant = middles[n, side, k] + share[n, side, k] * reaches[n, side, k]
                gains = _residuals_and_gains(self.model, points[gain])[1]
                costs[gain] += (meant[gain] - gains)**2 / self.own[k[gain]]
            excess = np.maximum(costs - self.least[k], 1e-300) / np.maximum(self.limit - self.least[k], 1e-300)
            now = share[n, side, k]
            low[n, side, k] = np.where(excess <= 1.0, now, low[n, side, k])
            high[n, side, k] = np.where(excess > 1.0, now, high[n, side, k])
            share[n, side, k] = np.clip(now * np.maximum(excess, 1e-300)**-0.5, low[n, side, k], high[n, side, k])
            furthest = np.argsort(-np.abs(share * reaches), axis=2, kind="stable")[:, :, :_KEPT]
            which = np.indices(furthest.shape)
            at = np.stack([which[0].ravel(), which[1].ravel(), furthest.ravel()])
        return share * reaches

    def _lines(self, numbers: list[int]) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """For some parameters and last the gain: value at the least cost (k,), reach for a cost of 1 more, direction.

        Reaches are (k,), directions (k, f): all parameters move along when one does.
        """
        lines = []
        for j in numbers:
            i = int(np.flatnonzero(self.free == j)[0])
            reach = np.sqrt(self.spread[:, i, i])
            lines.append((self.points[:, j] + self.step[:, i], reach, self.spread[:, :, i] / reach[:, None]))
        way = np.einsum("kfg,kg->kf", self.spread, self.follows)
        reach = np.sqrt(np.einsum("kf,kf->k", self.follows, way) + self.own)
        return [*lines, (self.gain, reach, way / reach[:, None])]


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


def _own_variance(model: Model, points: FloatArray) -> FloatArray:
    """Variance (P,) of the gain for residuals of variance 1, all other parameters fixed at points (P, d)."""
    own = model.own_columns(*model.responses(model.values(points)))
    used = model.weight > 0
    own, shared, out = own[:, used], model.shared.basis[used], np.empty(len(points))
    for p in range(len(points)):
        others = np.concatenate([own[1:, :, p].T, shared], axis=1)
        known = axes(others, SAME)
        rest = own[0, :, p] - known @ (known.T @ own[0, :, p])
        out[p] = 1.0 / max(float(rest @ rest), 1e-300)
    return out
