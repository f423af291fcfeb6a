"""Local descent for many starts at once: Gauss-Newton with differences of the residuals, a ladder of dampings a turn.

The free-run cost is a sum of squares that is smooth but for the instants where the valve breaks away. Along its narrow
valleys (S against dead time, J against gain) a population needs hundreds of evaluations to learn a direction that
the derivatives of the residuals show at once. Differences are taken over a share of the range that shrinks only when
nothing is gained, so that small steps of the cost are looked across. Works in the unit cube, like `search`.

Wrong where the cost has steps larger than the differences (S under a held command): search there first.
Source: Levenberg 1944, Marquardt 1963; residuals after the linear part was fitted are those of variable projection
(Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .kernels import kernel
from .loop import FloatArray
from .search import Cost, Found

Residuals = Callable[[FloatArray], FloatArray]
# Dampings tried in every turn, as shares of the diagonal. Unit: 1.
_DAMPINGS = np.array([1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0])
# Differences shrink by this factor after a turn that gains nothing; after so many such turns in a row a start is done.
_SHRINK, _IDLE = 0.03, 2


def descend(residuals: Residuals, cost: Cost, starts: FloatArray, *, spread: FloatArray | float = 1e-3,
            turns: int = 20, settle: float = 1e-5) -> Found:
    """Polish every start (k, d); best points and costs (k,), best first.

    `residuals` maps points (P, d) to (n, P), `cost` to (P,). `spread` is the first difference as a share of the range,
    for all or per dimension; a start whose cost falls by less than the share `settle` with finer differences, too, is
    done. Dimensions of spread 0 stay as they are.
    """
    points = np.clip(starts, 0.0, 1.0).copy()
    k, d = points.shape
    spread = np.broadcast_to(np.asarray(spread, float), d)
    free = np.flatnonzero(spread > 0)
    costs = cost(points)
    spent = k
    if not free.size:
        order = np.argsort(costs, kind="stable")
        return Found(points[order], costs[order], spent)
    step = spread[free] * np.ones((k, 1))
    idle = np.zeros(k, np.int64)
    live = np.flatnonzero(np.isfinite(costs))
    for _ in range(turns):
        if not live.size:
            break
        normals, gradients = normals_at(residuals, points[live], free, step[live])
        spent += live.size * (2 * free.size + 1)
        trial = points[live, None, :].repeat(_DAMPINGS.size, axis=1)
        trial[:, :, free] += damped_moves(normals, gradients)
        trial = np.clip(trial, 0.0, 1.0)
        c = cost(trial.reshape(-1, d)).reshape(live.size, -1)
        spent += c.size
        going = np.ones(live.size, bool)
        for i, g in enumerate(live):
            best = int(np.argmin(c[i]))
            gained = costs[g] - c[i, best] if np.isfinite(c[i, best]) else 0.0
            if gained > 0.0:
                points[g], costs[g] = trial[i, best], c[i, best]
            if gained <= settle * costs[g]:
                step[g] *= _SHRINK
                idle[g] += 1
                going[i] = idle[g] < _IDLE
            else:
                idle[g] = 0
        live = live[going]
    order = np.argsort(costs, kind="stable")
    return Found(points[order], costs[order], spent)


def slopes_at(residuals: Residuals, points: FloatArray, free: FloatArray,
              step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives (k, n, f) of the residuals along the free dimensions, by central differences, and residuals (k, n).

    At a bound the difference is taken to the inside only.
    """
    k, f = points.shape[0], free.size
    trial, width = beside(points, free, step)
    r = residuals(trial)
    r = np.where(np.isfinite(r), r, 0.0).reshape(r.shape[0], k, 2 * f + 1)
    slopes = (r[:, :, 1:f + 1] - r[:, :, f + 1:]) / width
    return np.moveaxis(slopes, 1, 0), np.ascontiguousarray(r[:, :, 0].T)


def normals_at(residuals: Residuals, points: FloatArray, free: FloatArray,
               step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Products (k, f, f) of the slopes of `slopes_at` with each other and (k, f) with the residuals, summed over n."""
    k, f = points.shape[0], free.size
    trial, width = beside(points, free, step)
    normals, gradients = np.zeros((k, f, f)), np.zeros((k, f))
    _normals(residuals(trial), 1.0 / width, normals, gradients)
    return normals, gradients


def beside(points: FloatArray, free: FloatArray, step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (k (2f+1), d) for the differences of points (k, d), themselves first, and the widths (k, f)."""
    f = free.size
    trial = points[:, None, :].repeat(2 * f + 1, axis=1)
    for j, column in enumerate(free):
        trial[:, 1 + j, column] = np.minimum(points[:, column] + step[:, j], 1.0)
        trial[:, 1 + f + j, column] = np.maximum(points[:, column] - step[:, j], 0.0)
    width = np.stack([trial[:, 1 + j, c] - trial[:, 1 + f + j, c] for j, c in enumerate(free)], axis=1)
    return trial.reshape(-1, points.shape[1]), np.maximum(width, 1e-300)


@kernel
def _normals(r, factor, normals, gradients):
    """Sums over the rows of r (n, k (2f+1)); what is not finite counts as 0."""
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


def principal(normal: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eigenvalues (…, f), vectors (…, f, f) of normal matrices of slopes, scaled to a diagonal of 1, and scales."""
    size = np.sqrt(np.diagonal(normal, axis1=-2, axis2=-1))
    size = np.maximum(size, 1e-9 * size.max(axis=-1, initial=0.0, keepdims=True) + 1e-100)
    values, vectors = np.linalg.eigh(normal / (size[..., None] * size[..., None, :]))
    return values, vectors, size


def damped_moves(normal: FloatArray, gradient: FloatArray) -> FloatArray:
    """Steps (…, dampings, f) that lower the squared residuals, by their slopes' products with each other and them."""
    values, vectors, size = principal(normal)
    along = (gradient / size)[..., None, :] @ vectors
    return -(along / (np.maximum(values, 0.0)[..., None, :] + _DAMPINGS[:, None])) @ np.swapaxes(
        vectors, -1, -2) / size[..., None, :]
