"""Batched Levenberg-Marquardt: many starts descend at once, with difference quotients and eight dampings a turn.

The free-run cost is a sum of squares that is smooth except at the instants of break-away. Along its narrow valleys (S
against dead time, J against gain) a population needs hundreds of evaluations to learn the direction. The derivatives
of the residuals give it at once. Differences are taken over a share of the range that shrinks only after a turn
without gain, so that they span small steps of the cost. Works in the unit cube, like numerics/population.py.

Wrong where the cost has steps larger than the differences (S under a held command): search there first.
Source: Levenberg 1944, Marquardt 1963; residuals after the linear part was fitted are those of variable projection
(Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..typing import FloatArray, IntArray
from .jit import FULL, LANES, kernel
from .population import Cost, Found, best_first

Residuals = Callable[[FloatArray], FloatArray]
# Dampings tried in every turn, as shares of the diagonal. Unit: 1.
_DAMPINGS = np.array([1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0])
# Factor on the differences after a turn without gain, and the number of such turns in a row that ends a start.
_SHRINK, _IDLE = 0.03, 2
# Ratio of the changes of the residuals on both sides of a point from which the larger one is a step of the cost.
_STEP = 3.0


def descend(residuals: Residuals, cost: Cost, starts: FloatArray, *, spread: FloatArray | float = 1e-3,
            turns: int = 20, settle: float = 1e-5) -> Found:
    """Polish every start (k, d); best points and costs (k,), best first.

    `residuals` maps points (P, d) to (n, P), `cost` to (P,). `spread` is the first difference as a share of the range,
    for all or per dimension; dimensions of spread 0 stay fixed. A start is done when its cost falls by less than the
    share `settle` in two turns in a row; the differences shrink in between.
    """
    points = np.clip(starts, 0.0, 1.0).copy()
    k, d = points.shape
    spread = np.broadcast_to(np.asarray(spread, float), d)
    free = np.flatnonzero(spread > 0)
    costs = cost(points)
    if not free.size:
        return best_first(points, costs)
    step = spread[free] * np.ones((k, 1))
    idle = np.zeros(k, np.int64)
    live = np.flatnonzero(np.isfinite(costs))
    for _ in range(turns):
        if not live.size:
            break
        normals, gradients = normals_at(residuals, points[live], free, step[live])
        trial = points[live, None, :].repeat(_DAMPINGS.size, axis=1)
        trial[:, :, free] += damped_moves(normals, gradients)
        np.clip(trial, 0.0, 1.0, out=trial)
        c = cost(trial.reshape(-1, d)).reshape(live.size, -1)
        best = c.argmin(axis=1)
        least = c[np.arange(live.size), best]
        gained = np.where(np.isfinite(least), costs[live] - least, 0.0)
        better = gained > 0.0
        points[live[better]] = trial[better, best[better]]
        costs[live[better]] = least[better]
        small = gained <= settle * costs[live]
        step[live[small]] *= _SHRINK
        idle[live] = np.where(small, idle[live] + 1, 0)
        live = live[idle[live] < _IDLE]
    return best_first(points, costs)


def slopes_at(residuals: Residuals, points: FloatArray, free: IntArray,
              step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives (k, n, f) of the residuals along the free dimensions, by `quotients`, and residuals (k, n)."""
    k, f = points.shape[0], free.size
    r = residuals(trial_points(points, free, step)[0])
    r = np.where(np.isfinite(r), r, 0.0).reshape(r.shape[0], k, 2 * f + 1)
    slopes = quotients(r, *sides(r, points[:, free], step))
    return np.moveaxis(slopes, 1, 0), np.ascontiguousarray(r[:, :, 0].T)


def sides(r: FloatArray, now: FloatArray, step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights (k, f) of the differences up and down that make a slope: both alike, or one alone beside a step.

    `r` (n, k, 2f+1) are residuals at the points of `trial_points`, `now` (k, f) the numbers moved by `step` (k, f). At
    the end of a plateau one side is on another valve path, and its difference is no slope. At a bound the difference
    is taken to the inside only.
    """
    f = now.shape[1]
    above, below = np.minimum(now + step, 1.0) - now, now - np.maximum(now - step, 0.0)
    both, width = (above > 0.0) & (below > 0.0), 1.0 / np.maximum(above + below, 1e-300)
    above, below = np.where(both, above, 1.0), np.where(both, below, 1.0)
    up = np.linalg.norm(r[:, :, 1:f + 1] - r[:, :, :1], axis=0) / above
    down = np.linalg.norm(r[:, :, f + 1:] - r[:, :, :1], axis=0) / below
    stepped, fell = both & (up > _STEP * down), both & (down > _STEP * up)
    return (np.where(stepped, 0.0, np.where(fell, 1.0 / above, width)),
            np.where(fell, 0.0, np.where(stepped, 1.0 / below, width)))


def quotients(r: FloatArray, up: FloatArray, down: FloatArray) -> FloatArray:
    """Slopes (…, f) of what has values r (…, 2f+1) at the points of `trial_points`, by the weights of `sides`."""
    f = up.shape[-1]
    return up * (r[..., 1:f + 1] - r[..., :1]) + down * (r[..., :1] - r[..., f + 1:])


def normals_at(residuals: Residuals, points: FloatArray, free: IntArray,
               step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Products (k, f, f) of central differences of the residuals with each other, and (k, f) with the residuals.

    Points are evaluated in groups as large as a block of the kernels, filled up to full lanes. The residuals of a
    group are used before those of the next are formed.
    """
    k, f = points.shape[0], free.size
    trial, width = trial_points(points, free, step)
    normals, gradients = np.zeros((k, f, f)), np.zeros((k, f))
    together = max(LANES // (2 * f + 1), 1)
    together = -(-k // max(-(-k // together), 1))
    for a in range(0, k, max(together, 1)):
        starts = slice(a, min(a + together, k))
        part = trial[a * (2 * f + 1):starts.stop * (2 * f + 1)]
        missing = -len(part) % FULL
        if missing:
            part = np.concatenate([part, part[-1:].repeat(missing, axis=0)])
        _normals(residuals(part), 1.0 / width[starts], normals[starts], gradients[starts])
    return normals, gradients


def trial_points(points: FloatArray, free: IntArray, step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Trial points (k (2f+1), d) for central differences at points (k, d), each point first, and the widths (k, f)."""
    f, now = free.size, points[:, free]
    trial, numbers = points[:, None, :].repeat(2 * f + 1, axis=1), np.arange(f)
    up, down = np.minimum(now + step, 1.0), np.maximum(now - step, 0.0)
    # One number is moved in each, first all up and then all down.
    trial[:, 1 + numbers, free], trial[:, 1 + f + numbers, free] = up, down
    return trial.reshape(-1, points.shape[1]), np.maximum(up - down, 1e-300)


@kernel
def _normals(r: FloatArray, factor: FloatArray, normals: FloatArray, gradients: FloatArray) -> None:
    """Add the products of one group's residuals r (n, k (2f+1)) to the normal equations; non-finite ones count as 0."""
    starts, f = factor.shape
    slope = np.empty(f)
    for row in range(r.shape[0]):
        values = r[row]
        for g in range(starts):
            at = g * (2 * f + 1)
            now = values[at]
            now = now if np.isfinite(now) else 0.0
            for j in range(f):
                up, down = values[at + 1 + j], values[at + 1 + f + j]
                up = up if np.isfinite(up) else 0.0
                down = down if np.isfinite(down) else 0.0
                slope[j] = (up - down) * factor[g, j]
            for j in range(f):
                s = slope[j]
                gradients[g, j] += s * now
                for i in range(j + 1):
                    normals[g, j, i] += s * slope[i]
    for g in range(starts):
        for j in range(f):
            for i in range(j):
                normals[g, i, j] = normals[g, j, i]


def principal_axes(normal: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eigenvalues (…, f), vectors (…, f, f) of normal matrices of slopes, scaled to a diagonal of 1, and scales."""
    size = np.sqrt(np.diagonal(normal, axis1=-2, axis2=-1))
    size = np.maximum(size, 1e-9 * size.max(axis=-1, initial=0.0, keepdims=True) + 1e-100)
    values, vectors = np.linalg.eigh(normal / (size[..., None] * size[..., None, :]))
    return values, vectors, size


def damped_moves(normal: FloatArray, gradient: FloatArray) -> FloatArray:
    """Steps (…, dampings, f) that lower the squared residuals, from the normal matrix (…, f, f) and gradient (…, f)."""
    f = gradient.shape[-1]
    moves = np.empty((gradient.size // f, _DAMPINGS.size, f))
    _moves(np.ascontiguousarray(normal).reshape(-1, f, f), np.ascontiguousarray(gradient).reshape(-1, f), _DAMPINGS,
           moves)
    return moves.reshape(*gradient.shape[:-1], _DAMPINGS.size, f)


@kernel
def _moves(normal: FloatArray, gradient: FloatArray, dampings: FloatArray, moves: FloatArray) -> None:
    """Solve every damped system by a Cholesky factor, its slopes scaled to length 1 as in `principal_axes`."""
    k, f = gradient.shape
    size, x = np.empty(f), np.empty(f)
    root = np.empty((f, f))
    for g in range(k):
        largest = 0.0
        for i in range(f):
            largest = max(largest, normal[g, i, i])
        for i in range(f):
            size[i] = max(np.sqrt(normal[g, i, i]), 1e-9 * np.sqrt(largest) + 1e-100)
        for m in range(dampings.size):
            for i in range(f):
                x[i] = -gradient[g, i] / size[i]
                for j in range(i + 1):
                    total = normal[g, i, j] / (size[i] * size[j])
                    for n in range(j):
                        total -= root[i, n] * root[j, n]
                    if i == j:
                        root[i, i] = np.sqrt(max(total + dampings[m], 0.5 * dampings[m]))
                    else:
                        root[i, j] = total / root[j, j]
            for i in range(f):
                for n in range(i):
                    x[i] -= root[i, n] * x[n]
                x[i] /= root[i, i]
            for i in range(f - 1, -1, -1):
                for n in range(i + 1, f):
                    x[i] -= root[n, i] * x[n]
                x[i] /= root[i, i]
            for i in range(f):
                moves[g, m, i] = x[i] / size[i]
