"""Population searches over few parameters: particle swarm and covariance matrix adaptation, one cost call a round.

`swarm` is the synchronous particle swarm of the paper, as several independent swarms side by side. `refine` polishes
starts without derivatives by covariance matrix adaptation (Hansen 2016, the tutorial's default constants). That suits
a jagged cost with a narrow valley. Both work in the unit cube; the caller maps it to parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..typing import BoolArray, FloatArray, IntArray
from .jit import kernel

Cost = Callable[[FloatArray], FloatArray]
# Inertia and attraction of the swarm (Clerc and Kennedy 2002).
_INERTIA, _PULL = 0.7298, 1.49618
# A population has converged when its step is below this share of the range. Unit: 1.
_SMALLEST_STEP = 1e-5
# Rounds without progress after which a polish may be done. Half its population must then also lie within _FLAT times
# `settle` of its best. A population that still learns the direction of a narrow valley makes no progress either.
_PATIENCE, _FLAT = 14, 10.0
# Largest number of Jacobi sweeps over a covariance matrix, and the correlation that counts as 0. Unit: 1.
_SWEEPS, _ROUNDING = 30, 1e-14


@dataclass(frozen=True, slots=True)
class Found:
    """Best points (k, d) of each independent search and their costs (k,), best first."""

    points: FloatArray
    costs: FloatArray


def best_first(points: FloatArray, costs: FloatArray) -> Found:
    """Points (k, d) and costs (k,) as a result, best first."""
    order = np.argsort(costs, kind="stable")
    return Found(points[order], costs[order])


def join_found(one: Found, other: Found) -> Found:
    """Results of two searches as one, best first."""
    return best_first(np.concatenate([one.points, other.points]), np.concatenate([one.costs, other.costs]))


def stratified_points(rng: np.random.Generator, count: int, dimensions: int) -> FloatArray:
    """Latin hypercube in the unit cube, shape (count, dimensions)."""
    cells = np.stack([rng.permutation(count) for _ in range(dimensions)], axis=1)
    return (cells + rng.random((count, dimensions))) / count


def swarm(cost: Cost, dimensions: int, rng: np.random.Generator, *, groups: int = 4, particles: int = 24,
          rounds: int = 30, scouts: int = 0) -> Found:
    """Independent particle swarms in the unit cube; all their particles are one call of `cost` per round.

    Each swarm starts from the best `particles` of `scouts` stratified points: a basin may be a hundredth of the range.
    """
    count = max(scouts, particles)
    x = np.concatenate([stratified_points(rng, count, dimensions) for _ in range(groups)])
    c = cost(x)
    chosen = np.argsort(c.reshape(groups, count), axis=1, kind="stable")[:, :particles]
    chosen = (chosen + np.arange(groups)[:, None] * count).ravel()
    x, c = x[chosen], c[chosen]
    v = 0.25 * (rng.random(x.shape) - 0.5)
    best, best_cost = x.copy(), c.copy()
    group = np.repeat(np.arange(groups), particles)
    for _ in range(rounds):
        leaders = best_cost.reshape(groups, particles).argmin(axis=1) + np.arange(groups) * particles
        lead = best[leaders[group]]
        v = (_INERTIA * v + _PULL * rng.random(x.shape) * (best - x) + _PULL * rng.random(x.shape) * (lead - x))
        x = x + v
        outside = (x < 0.0) | (x > 1.0)
        v[outside] *= -0.5
        x = np.clip(x, 0.0, 1.0)
        c = cost(x)
        better = c < best_cost
        best[better], best_cost[better] = x[better], c[better]
    return best_first(best, best_cost)


def refine(cost: Cost, starts: FloatArray, rng: np.random.Generator, *, spread: FloatArray | float = 0.02,
           population: int = 0, rounds: int = 60, settle: float = 0.0) -> Found:
    """Polish every start (k, d) by its own covariance matrix adaptation; all populations are one call a round.

    `spread` is the first standard deviation, as a share of the range, for all or per dimension (d,). A start is done
    when its best cost fell by less than the share `settle` over `_PATIENCE` rounds and its population is as flat.
    """
    k, d = starts.shape
    lam = population or max(12, 4 + int(3 * np.log(d)) * 2)
    mu = lam // 2
    w = np.log(mu + 0.5) - np.log(np.arange(1, mu + 1))
    w /= w.sum()
    mueff = 1.0 / (w**2).sum()
    cc = (4 + mueff / d) / (d + 4 + 2 * mueff / d)
    cs = (mueff + 2) / (d + mueff + 5)
    c1 = 2 / ((d + 1.3) ** 2 + mueff)
    cmu = min(1 - c1, 2 * (mueff - 2 + 1 / mueff) / ((d + 2) ** 2 + mueff))
    damps = 1 + 2 * max(0.0, np.sqrt((mueff - 1) / (d + 1)) - 1) + cs
    chi = np.sqrt(d) * (1 - 1 / (4 * d) + 1 / (21 * d * d))
    constants = np.array([mueff, cc, cs, c1, cmu, damps, chi])
    # Arrays of one kind each (writable, contiguous): a kernel is compiled for every kind that it meets.
    scale = np.array(np.broadcast_to(np.asarray(spread, float), d))
    mean = np.ascontiguousarray(np.clip(starts, 0.0, 1.0) / scale)
    top = 1.0 / scale
    sigma = np.ones(k)
    cov = np.tile(np.eye(d), (k, 1, 1))
    vectors, root = np.tile(np.eye(d), (k, 1, 1)), np.ones((k, d))
    path_s, path_c = np.zeros((k, d)), np.zeros((k, d))
    best, best_cost = np.clip(starts, 0.0, 1.0).copy(), cost(np.clip(starts, 0.0, 1.0))
    live = np.arange(k)
    history, middle = [best_cost.copy()], np.full(k, np.inf)
    for turn in range(rounds):
        y, trial = np.empty((live.size, lam, d)), np.empty((live.size, lam, d))
        _draw(live, rng.standard_normal(y.shape), mean, sigma, vectors, root, top, scale, y, trial)
        c = cost(trial.reshape(-1, d)).reshape(live.size, lam)
        order = np.ascontiguousarray(c.argsort(axis=1, kind="stable")[:, :mu])
        lanes = np.arange(live.size)
        first, last = c[lanes, order[:, 0]], c[lanes, order[:, -1]]
        middle[live] = last
        better = first < best_cost[live]
        best_cost[live[better]] = first[better]
        best[live[better]] = trial[better, order[better, 0]]
        _adapt(live, np.isfinite(last), y, order, vectors, root, w, constants, turn, top, mean, sigma, cov, path_s,
               path_c)
        _principal(live, cov, vectors, root)
        widest = sigma * root.max(axis=1) * scale.max()
        history.append(best_cost.copy())
        going = widest > _SMALLEST_STEP
        if settle and len(history) > _PATIENCE:
            moving = best_cost < history[-1 - _PATIENCE] * (1.0 - settle)
            going &= moving | (middle > best_cost * (1.0 + _FLAT * settle))
        live = live[going[live]]
        if live.size == 0:
            break
    return best_first(best, best_cost)


@kernel
def _principal(live: IntArray, cov: FloatArray, vectors: FloatArray, root: FloatArray) -> None:
    """Principal axes (columns of `vectors`) and standard deviations `root` of the populations `live`.

    Cyclic Jacobi rotations (Golub and Van Loan) give each standard deviation to rounding, however much they differ. At
    these sizes they are faster than a call of LAPACK.
    """
    d = cov.shape[1]
    a = np.empty((d, d))
    for at in range(live.size):
        g = live[at]
        v = vectors[g]
        for i in range(d):
            for j in range(d):
                a[i, j] = cov[g, i, j]
                v[i, j] = 1.0 if i == j else 0.0
        for _ in range(_SWEEPS):
            turned = False
            for p in range(d - 1):
                for q in range(p + 1, d):
                    x = a[p, q]
                    if abs(x) <= _ROUNDING * np.sqrt(abs(a[p, p] * a[q, q])):
                        continue
                    turned = True
                    theta = (a[q, q] - a[p, p]) / (2.0 * x)
                    t = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1.0))
                    c = 1.0 / np.sqrt(t * t + 1.0)
                    s = t * c
                    for i in range(d):
                        one, two = a[i, p], a[i, q]
                        a[i, p], a[i, q] = c * one - s * two, s * one + c * two
                    for i in range(d):
                        one, two = a[p, i], a[q, i]
                        a[p, i], a[q, i] = c * one - s * two, s * one + c * two
                    for i in range(d):
                        one, two = v[i, p], v[i, q]
                        v[i, p], v[i, q] = c * one - s * two, s * one + c * two
            if not turned:
                break
        for i in range(d):
            root[g, i] = np.sqrt(max(a[i, i], 1e-20))


@kernel
def _draw(live: IntArray, z: FloatArray, mean: FloatArray, sigma: FloatArray, vectors: FloatArray, root: FloatArray,
          top: FloatArray, scale: FloatArray, y: FloatArray, trial: FloatArray) -> None:
    """Steps y and points `trial` (g, lam, d) of the populations `live` from normal numbers z, kept inside the range."""
    count, d = z.shape[1:]
    for a in range(live.size):
        g = live[a]
        for m in range(count):
            for i in range(d):
                step = 0.0
                for j in range(d):
                    step += vectors[g, i, j] * root[g, j] * z[a, m, j]
                point = min(max(mean[g, i] + sigma[g] * step, 0.0), top[i])
                y[a, m, i] = (point - mean[g, i]) / sigma[g]
                trial[a, m, i] = point * scale[i]


@kernel
def _adapt(live: IntArray, fine: BoolArray, y: FloatArray, order: IntArray, vectors: FloatArray, root: FloatArray,
           w: FloatArray, constants: FloatArray, turn: int, top: FloatArray, mean: FloatArray, sigma: FloatArray,
           cov: FloatArray, path_s: FloatArray, path_c: FloatArray) -> None:
    """Move mean, step size, covariance and paths of the populations `live` by their best steps y (g, lam, d)."""
    mueff, cc, cs, c1, cmu, damps, chi = constants
    d = mean.shape[1]
    step, along = np.empty(d), np.empty(d)
    for a in range(live.size):
        g = live[a]
        if not fine[a]:
            sigma[g] *= 0.7  # too many of its points are rejected
            continue
        step[:] = 0.0
        for m in range(w.size):
            for i in range(d):
                step[i] += w[m] * y[a, order[a, m], i]
        for i in range(d):
            mean[g, i] = min(max(mean[g, i] + sigma[g] * step[i], 0.0), top[i])
        for j in range(d):
            total = 0.0
            for i in range(d):
                total += vectors[g, i, j] * step[i]
            along[j] = total / root[g, j]
        length = 0.0
        for i in range(d):
            white = 0.0
            for j in range(d):
                white += vectors[g, i, j] * along[j]
            path_s[g, i] = (1.0 - cs) * path_s[g, i] + np.sqrt(cs * (2.0 - cs) * mueff) * white
            length += path_s[g, i] ** 2
        length = np.sqrt(length)
        quiet = length / np.sqrt(1.0 - (1.0 - cs) ** (2 * (turn + 1))) < (1.4 + 2.0 / (d + 1)) * chi
        for i in range(d):
            path_c[g, i] = (1.0 - cc) * path_c[g, i] + (np.sqrt(cc * (2.0 - cc) * mueff) * step[i] if quiet else 0.0)
        keep = 1.0 - c1 - cmu + (0.0 if quiet else c1 * cc * (2.0 - cc))
        for i in range(d):
            for j in range(i + 1):
                total = 0.0
                for m in range(w.size):
                    total += w[m] * y[a, order[a, m], i] * y[a, order[a, m], j]
                cov[g, i, j] = keep * cov[g, i, j] + c1 * path_c[g, i] * path_c[g, j] + cmu * total
                cov[g, j, i] = cov[g, i, j]
        sigma[g] *= np.exp(min(max((cs / damps) * (length / chi - 1.0), -1.0), 1.0))
