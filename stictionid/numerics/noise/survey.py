"""Survey of the noise family: starts for its fit from many pairs (rho, theta) at once.

A residual is filtered by every pair, and A comes from the autocovariances that each leaves (pairs of samples that are
there). The likelihood is approximate where samples are missing.
Source: Levinson 1947; Durbin 1960.
"""

from __future__ import annotations

import numpy as np

from ...typing import BoolArray, FloatArray, IntArray
from ..jit import kernel
from .exact import Record, group_of
from .family import Noise

# Values of 1 - rho and 1 - theta in the survey, and lanes that it filters together.
_SLOWNESS = 9
_LANES = 16
# Reflection at which an autocovariance sequence is taken to be none; the group of lanes that are AR(1) in rho.
_UNSTABLE, _FOLDED = 0.999, "folded"


@kernel
def _survey(y: FloatArray, good: BoolArray, starts: IntArray, rho: FloatArray, theta: FloatArray, e: FloatArray,
            g: FloatArray, log_scale: FloatArray) -> None:
    """Scaled innovations (n, lanes) of residual and level under ARMA(1, 1) noise, 0 where no row counts."""
    lanes = rho.size
    f, x, z = np.empty(lanes), np.empty(lanes), np.empty(lanes)
    segment, begun = 0, False
    for t in range(y.size):
        if segment < starts.size and t == starts[segment]:
            segment += 1
            begun = False
        row, level = e[t], g[t]
        if not good[t]:
            for p in range(lanes):
                row[p] = level[p] = 0.0
                if begun:
                    f[p] = rho[p] * rho[p] * f[p] - 2.0 * rho[p] * theta[p] + theta[p] * theta[p] + 1.0
                    x[p] *= rho[p]
                    z[p] *= rho[p]
            continue
        if not begun:
            begun = True
            for p in range(lanes):
                x[p] = z[p] = 0.0
                f[p] = np.inf
                if rho[p] < 1.0:
                    f[p] = (1.0 - 2.0 * rho[p] * theta[p] + theta[p] * theta[p]) / (1.0 - rho[p] * rho[p])
        for p in range(lanes):
            inverse = 1.0 / f[p]
            scale = np.sqrt(inverse)
            if inverse > 0.0:
                log_scale[p] -= np.log(inverse) if abs(inverse - 1.0) > 1e-13 else 0.0
            error, other = y[t] - x[p], 1.0 - z[p]
            row[p], level[p] = error * scale, other * scale
            x[p] = rho[p] * y[t] - theta[p] * inverse * error
            z[p] = rho[p] - theta[p] * inverse * other
            f[p] = 1.0 + theta[p] * theta[p] * (1.0 - inverse)


@kernel
def _lagged(e: FloatArray, good: BoolArray, starts: IntArray, out: FloatArray, pairs: FloatArray) -> None:
    """Sums of products (lags + 1, lanes) of rows a lag apart in one segment, and the number of pairs (lags + 1,)."""
    for s in range(starts.size):
        stop = starts[s + 1] if s + 1 < starts.size else good.size
        for lag in range(out.shape[0]):
            sink = out[lag]
            for t in range(starts[s] + lag, stop):
                if good[t] and good[t - lag]:
                    pairs[lag] += 1.0
                    now, before = e[t], e[t - lag]
                    for p in range(sink.size):
                        sink[p] += now[p] * before[p]


def _pairs(rows: int) -> FloatArray:
    """Pairs (rho, theta) (k, 2) of the survey: none, AR(1), AR(1) under measurement noise, and walks."""
    slow = np.geomspace(0.8, min(4.0 / rows, 0.05), _SLOWNESS)
    walks = np.geomspace(1.0, min(2.0 / rows, 0.02), _SLOWNESS + 4)
    pairs = [(0.0, 0.0), *((1.0, 1.0 - b) for b in walks)]
    for i, a in enumerate(slow):
        pairs += [(1.0 - a, 0.0), *((1.0 - a, 1.0 - b) for b in slow[:i])]
    return np.array(pairs)


def survey_noise(record: Record, largest: int) -> dict[tuple[str, int], Noise]:
    """The best noise model of each group and order of A by an approximate likelihood."""
    pairs = _pairs(record.rows)
    best: dict[tuple[str, int], tuple[float, Noise]] = {}
    for first in range(0, len(pairs), _LANES):
        rho, theta = (np.ascontiguousarray(c) for c in pairs[first:first + _LANES].T)
        e, g = np.empty((record.y.size, rho.size)), np.empty((record.y.size, rho.size))
        log_scale = np.zeros(rho.size)
        _survey(record.y, record.good, record.starts, rho, theta, e, g, log_scale)
        for part, level in zip(np.split(e, record.starts[1:]), np.split(g, record.starts[1:]), strict=True):
            energy = np.einsum("np,np->p", level, level)
            # A random walk leaves nothing of the level.
            free = (rho < 1.0) & (energy > 0.0)
            part -= level * np.where(free, np.einsum("np,np->p", part, level) / np.where(free, energy, 1.0), 0.0)
            log_scale += np.where(free, np.log(np.where(free, energy, 1.0)), 0.0)
        sums, count = np.zeros((largest + 1, rho.size)), np.zeros(largest + 1)
        _lagged(e, record.good, record.starts, sums, count)
        if not record.whole:
            there = count > 0
            share = 1.0 - np.arange(largest + 1) / record.good.size
            sums = np.where(there[:, None], sums / np.where(there, count, 1.0)[:, None] * (share * count[0])[:, None],
                            np.nan)
        taps = np.zeros((largest + 1, largest, rho.size))
        variance = np.full((largest + 1, rho.size), np.inf)
        levinson_lanes(sums, taps, variance)
        deviances = record.rows * np.log(variance / record.rows) + log_scale
        for group, lanes in _groups(rho, theta).items():
            for order in range(largest + 1):
                lane = lanes[int(np.argmin(deviances[order, lanes]))]
                if not np.isfinite(deviances[order, lane]):
                    continue
                found = Noise(tuple(taps[order, :order, lane].tolist()), float(rho[lane]), float(theta[lane]))
                if group == _FOLDED:
                    if order == largest:
                        continue
                    found = Noise(tuple(found.plain[0][1:].tolist()))
                key = (group_of(found), len(found.taps))
                if key not in best or deviances[order, lane] < best[key][0]:
                    best[key] = (float(deviances[order, lane]), found)
    return {key: noise for key, (_, noise) in best.items()}


@kernel
def levinson_lanes(sums: FloatArray, taps: FloatArray, variance: FloatArray) -> None:
    """Taps (orders + 1, orders, lanes) and sums of squares of all orders; inf once an autocovariance is not known."""
    orders, lanes = variance.shape
    for p in range(lanes):
        if not sums[0, p] > 0.0:
            continue
        variance[0, p] = sums[0, p]
        for k in range(1, orders):
            reflection = sums[k, p]
            for i in range(k - 1):
                reflection += taps[k - 1, i, p] * sums[k - 1 - i, p]
            reflection /= -variance[k - 1, p]
            if not abs(reflection) < _UNSTABLE:
                break
            for i in range(k - 1):
                taps[k, i, p] = taps[k - 1, i, p] + reflection * taps[k - 1, k - 2 - i, p]
            taps[k, k - 1, p] = reflection
            variance[k, p] = variance[k - 1, p] * (1.0 - reflection * reflection)


def _groups(rho: FloatArray, theta: FloatArray) -> dict[str, IntArray]:
    """Lanes of the survey by group; an AR(1) (theta = 0) is folded into A."""
    names = np.array([_FOLDED if a != b == 0.0 and a < 1.0 else group_of(Noise((), a, b))
                      for a, b in zip(rho.tolist(), theta.tolist(), strict=True)])
    return {name: np.flatnonzero(names == name) for name in np.unique(names).tolist()}
