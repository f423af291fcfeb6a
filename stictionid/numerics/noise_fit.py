"""Fit of the noise family of numerics/noise_family.py to a residual: order, rho and theta by BIC.

A survey filters the residual by many pairs (rho, theta) at once and takes A from the autocovariances that each leaves.
The best of each kind start Gauss-Newton on the exact likelihood, with A in partial autocorrelations, so that it stays
stable. -2 log L of the concentrated likelihood is rows ln(sum of squares) of innovations over the geometric mean of
their scales: a least-squares problem. The level of each segment is integrated out for every kind alike.
Source: SELECTION.md section 2; Jones 1980 (missing samples, partial autocorrelations); Levinson 1947.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..typing import BoolArray, FloatArray, IntArray
from .autoregression import Starts
from .jit import kernel
from .noise_family import AUTOREGRESSION, MEASURED, WALK, Noise, start_of

LARGEST_ORDER = 8
# BIC that a random walk must gain over the best stationary noise (benchmarks/noise_family.py). Unit: 1.
WALK_MARGIN = 0.0
# Rows per order of A, and the fewest rows from which more than white noise is estimated.
_ROWS_PER_ORDER, _FEWEST = 10, 20
# Values of 1 - rho and 1 - theta in the survey, and lanes that it filters together.
_SLOWNESS = 9
_LANES = 16
# Most rows in which orders are searched; a longer record is searched in a part and polished in full.
_SEARCHED = 20_000
# Rounds of Gauss-Newton, the fall of -2 log L below which it has settled, and the step of its differences.
_ROUNDS, _SETTLED, _STEP = 12, 0.01, 1e-4
# BIC by which the start that one kind is to another may be worse than what it has; 1 - rho of a slow start, in rows.
_CROSSED, _SLOW = 5.0, 5.0
# Largest transformed number: 1 - tanh(5) is 1e-4 and the logistic function of 12 lacks 6e-6 of 1.
_FARTHEST, _FARTHEST_PAIR = 5.0, 12.0
# Falls of BIC in favour of another order below which the search for the order stops; steps of the order that it tries.
_BETTER, _AWAY, _AWAY_WITH_GAPS = 1e-6, (-1, 1), (-1, 1, 2)
# BIC behind the best kind beyond which a kind's order is not searched further: without gaps, and with gaps, where the
# survey is coarse.
_NEAR, _NEAR_WITH_GAPS = 20.0, 60.0
# Reflection at which an autocovariance sequence is taken to be none; the group of lanes that are AR(1) in rho.
_UNSTABLE, _FOLDED = 0.999, "folded"
# Group of random walks without measurement noise (theta = 0), which have one number less.
_DIFFERENCES = "differences"


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fitted noise model with its exact -2 log L (concentrated, levels integrated out) and its BIC."""

    noise: Noise
    deviance: float
    bic: float


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


@kernel
def _exact(y: FloatArray, good: BoolArray, starts: IntArray, phi: FloatArray, theta: float, P0: FloatArray,
           level: FloatArray, walks: bool, out: FloatArray, one: FloatArray) -> tuple[float, float, int]:
    """Scaled innovations (n,) without the levels: sum of squares, sum of log f with the levels' part, and rows."""
    n, m = good.size, phi.size
    P, Q = np.zeros((m + 1, m + 1)), np.zeros((m + 1, m + 1))
    x, z, k = np.zeros(m + 1), np.zeros(m + 1), np.zeros(m + 1)
    sse, total, rows, segment = 0.0, 0.0, 0, 0
    while segment < starts.size:
        stop = starts[segment + 1] if segment + 1 < starts.size else n
        begun, steady = False, False
        cross, energy, squares = 0.0, 0.0, 0.0
        for t in range(starts[segment], stop):
            out[t] = one[t] = 0.0
            if not begun and not good[t]:
                continue
            first = not begun
            if first:
                begun = True
                x[:] = 0.0
                z[:] = 0.0
                for i in range(m):
                    for j in range(m):
                        P[i, j] = P0[i, j]
            if good[t] and steady:
                value, e, g = y[t], y[t] - x[0], 1.0 - z[0]
                for i in range(m):
                    x[i] = phi[i] * value + x[i + 1]
                    z[i] = phi[i] + z[i + 1]
                x[0] -= theta * e
                z[0] -= theta * g
                out[t], one[t] = e, g
                cross += e * g
                energy += g * g
                squares += e * e
                rows += 1
                continue
            if steady:
                steady = False
                P[:] = 0.0
                P[0, 0] = 1.0
                if m > 1:
                    P[1, 0] = P[0, 1] = -theta
                    P[1, 1] = theta * theta
            value, other = x[0], z[0]
            if good[t] and first and walks:
                value, other = y[t], 1.0
                for i in range(m):
                    k[i] = level[i]
                for i in range(m):
                    for j in range(m):
                        Q[i, j] = P[i, j] - k[i] * P[0, j] - P[i, 0] * k[j] + k[i] * k[j] * P[0, 0]
            elif good[t]:
                value, other = y[t], 1.0
                f = P[0, 0]
                if not f > 0.0:
                    return np.inf, 0.0, 0
                total += np.log(f)
                inverse = 1.0 / f
                steady = abs(f - 1.0) < 1e-10
                for i in range(m):
                    k[i] = P[i, 0] * inverse
                    steady = steady and abs(k[i] - (1.0 if i == 0 else -theta if i == 1 else 0.0)) < 1e-10
                for i in range(1, m):
                    for j in range(1, m):
                        Q[i, j] = P[i, j] - k[i] * P[0, j]
                for i in range(m):
                    Q[i, 0] = Q[0, i] = 0.0
                scale = np.sqrt(inverse)
                out[t], one[t] = (value - x[0]) * scale, (1.0 - z[0]) * scale
                cross += out[t] * one[t]
                energy += one[t] * one[t]
                squares += out[t] * out[t]
                rows += 1
            else:
                k[:] = 0.0
                for i in range(m):
                    for j in range(m):
                        Q[i, j] = P[i, j]
            e, g = value - x[0], other - z[0]
            for i in range(m):
                x[i] = phi[i] * value + x[i + 1] + k[i + 1] * e
                z[i] = phi[i] * other + z[i + 1] + k[i + 1] * g
            if good[t]:
                # The first row and column are 0: what was measured is known.
                for i in range(m):
                    for j in range(m):
                        P[i, j] = Q[i + 1, j + 1]
            else:
                for i in range(m):
                    for j in range(m):
                        P[i, j] = (phi[i] * (phi[j] * Q[0, 0] + Q[0, j + 1]) + phi[j] * Q[i + 1, 0] + Q[i + 1, j + 1])
            P[0, 0] += 1.0
            if m > 1:
                P[1, 0] -= theta
                P[0, 1] -= theta
                P[1, 1] += theta * theta
        if begun and not walks and energy > 0.0:
            share = cross / energy
            for t in range(starts[segment], stop):
                out[t] -= share * one[t]
            squares -= cross * share
            total += np.log(energy)
            rows -= 1
        sse += squares
        segment += 1
    return sse, total, rows


class _Record:
    """A residual (n,) with its good samples and segments, ready for the exact likelihood."""

    def __init__(self, residual: FloatArray, good: BoolArray, starts: Starts) -> None:
        self.y = np.where(good, residual, 0.0)
        self.good, self.starts = np.ascontiguousarray(good), np.array(starts, np.int64)
        self._one = np.empty(good.size)
        self.whole = bool(good.all())
        there = [bool(part.any()) for part in np.split(self.good, self.starts[1:])]
        self.rows = int(self.good.sum()) - sum(there)

    def innovations(self, noise: Noise) -> tuple[FloatArray, float]:
        """Innovations (n,) over the geometric mean of their scales, levels taken out, and -2 log L."""
        polynomial, theta = noise.plain
        m = max(polynomial.size - 1, 2 if theta else 1)
        phi, P, level, out = np.empty(m), np.empty((m, m)), np.empty(m), np.empty(self.y.size)
        ar = np.array(noise.taps, dtype=np.float64) if noise.walks else polynomial[1:].copy()
        if not start_of(ar, theta, noise.walks, phi, P, level):
            return out, np.inf
        sse, total, rows = _exact(self.y, self.good, self.starts, phi, theta, P, level, noise.walks, out, self._one)
        if not (np.isfinite(sse) and rows > 0):
            return out, np.inf
        out *= np.exp(0.5 * total / rows)
        return out, rows * float(np.log(max(sse, 1e-300) / rows)) + float(total)

    def fitted(self, noise: Noise) -> Fitted:
        """The noise model with its -2 log L and BIC."""
        deviance = self.innovations(noise)[1]
        return Fitted(noise, deviance, deviance + noise.numbers * float(np.log(max(self.rows, 2))))

    def polished(self, noise: Noise, rounds: int = _ROUNDS) -> Fitted:
        """The noise model of the same kind and order that Gauss-Newton on the exact likelihood finds from here."""
        build = _builder(noise)
        z = _coordinates(noise)
        r, deviance = self.innovations(build(z))
        damping = 1e-3
        for _ in range(rounds if z.size and np.isfinite(deviance) else 0):
            slopes = np.empty((z.size, r.size))
            for i in range(z.size):
                step = -_STEP if z[i] > 0.0 else _STEP
                trial = z.copy()
                trial[i] += step
                slopes[i] = (self.innovations(build(trial))[0] - r) / step
            square, down = slopes @ slopes.T, slopes @ r
            if not (np.isfinite(square).all() and np.isfinite(down).all()):
                break
            fall = 0.0
            for _ in range(6):
                steep = square + np.diag(damping * np.diag(square) + 1e-12 * np.trace(square) + 1e-300)
                trial = _inside(z - np.clip(np.linalg.solve(steep, down), -2.0, 2.0), noise)
                now, value = self.innovations(build(trial))
                if value < deviance:
                    fall, z, r, deviance = deviance - value, trial, now, value
                    damping *= 0.1
                    break
                damping = max(10.0 * damping, 1e-3)
            if fall < _SETTLED:
                break
        return self.fitted(build(z))


def _reflections(taps: FloatArray) -> FloatArray:
    """Partial autocorrelations (p,), as reflections, of a stable autoregression (p,)."""
    out, now = np.empty(taps.size), np.asarray(taps, dtype=np.float64)
    for k in range(taps.size - 1, -1, -1):
        out[k] = reflection = min(max(float(now[k]), -0.9999), 0.9999)
        now = (now[:k] - reflection * now[:k][::-1]) / (1.0 - reflection**2)
    return out


def _taps(reflections: FloatArray) -> tuple[float, ...]:
    """Taps (p,) of the autoregression with these reflections."""
    taps = np.empty(0)
    for reflection in reflections:
        taps = np.concatenate([taps + reflection * taps[::-1], [reflection]])
    return tuple(taps.tolist())


def _logit(share: float) -> float:
    share = min(max(share, 1e-6), 1.0 - 1e-6)
    return float(np.log(share / (1.0 - share)))


def _logistic(value: float) -> float:
    return float(1.0 / (1.0 + np.exp(-value)))


def _coordinates(noise: Noise) -> FloatArray:
    """Numbers of a noise model for the descent: A's reflections, then rho and theta / rho where they are free."""
    z = np.arctanh(_reflections(np.array(noise.taps)))
    group = _group(noise)
    if group == WALK:
        z = np.append(z, _logit(noise.theta))
    elif group == MEASURED:
        z = np.append(z, [_logit(noise.rho), _logit(noise.theta / noise.rho)])
    return _inside(z, noise)


def _inside(z: FloatArray, noise: Noise) -> FloatArray:
    order = len(noise.taps)
    return np.concatenate([np.clip(z[:order], -_FARTHEST, _FARTHEST), np.clip(z[order:], -_FARTHEST_PAIR,
                                                                              _FARTHEST_PAIR)])


def _builder(noise: Noise) -> Callable[[FloatArray], Noise]:
    """The function from coordinates to noise models of the same kind and order."""
    order, group = len(noise.taps), _group(noise)
    if group == _DIFFERENCES:
        return lambda z: Noise(_taps(np.tanh(z[:order])), 1.0)
    if group == WALK:
        return lambda z: Noise(_taps(np.tanh(z[:order])), 1.0, _logistic(z[order]))
    if group == AUTOREGRESSION:
        return lambda z: Noise(_taps(np.tanh(z[:order])))
    return lambda z: Noise(_taps(np.tanh(z[:order])), rho := _logistic(z[order]), rho * _logistic(z[order + 1]))


def _pairs(rows: int) -> FloatArray:
    """Pairs (rho, theta) (k, 2) of the survey: none, AR(1), AR(1) under measurement noise, and walks."""
    slow = np.geomspace(0.8, min(4.0 / rows, 0.05), _SLOWNESS)
    walks = np.geomspace(1.0, min(2.0 / rows, 0.02), _SLOWNESS + 4)
    pairs = [(0.0, 0.0), *((1.0, 1.0 - b) for b in walks)]
    for i, a in enumerate(slow):
        pairs += [(1.0 - a, 0.0), *((1.0 - a, 1.0 - b) for b in slow[:i])]
    return np.array(pairs)


def _surveyed(record: _Record, largest: int) -> dict[tuple[str, int], Noise]:
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
        _levinson(sums, taps, variance)
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
                key = (_group(found), len(found.taps))
                if key not in best or deviances[order, lane] < best[key][0]:
                    best[key] = (float(deviances[order, lane]), found)
    return {key: noise for key, (_, noise) in best.items()}


@kernel
def _levinson(sums: FloatArray, taps: FloatArray, variance: FloatArray) -> None:
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
    names = np.array([_FOLDED if a != b == 0.0 and a < 1.0 else _group(Noise((), a, b))
                      for a, b in zip(rho.tolist(), theta.tolist(), strict=True)])
    return {name: np.flatnonzero(names == name) for name in np.unique(names).tolist()}


def _group(noise: Noise) -> str:
    """Group in which a noise model competes: one kind of `fits_of`, or a walk of which theta stays 0."""
    if noise.walks and noise.theta == 0.0:
        return _DIFFERENCES
    return WALK if noise.walks else AUTOREGRESSION if noise.cancels else MEASURED


def _resized(noise: Noise, order: int) -> Noise:
    """The noise model with another order of A: further reflections are small, superfluous ones are dropped."""
    reflections = _reflections(np.array(noise.taps))[:order]
    return replace(noise, taps=_taps(np.concatenate([reflections, np.full(order - reflections.size, 0.05)])))


def _climbed(record: _Record, starts: list[Fitted], largest: int, goal: float) -> Fitted:
    """The best order of one group: polished from the best of the survey, then from its neighbours.

    Its neighbours are left out where the polished one is far behind the BIC `goal`.
    """
    away, near = (_AWAY, _NEAR) if record.whole else (_AWAY_WITH_GAPS, _NEAR_WITH_GAPS)
    surveyed = {len(f.noise.taps): f for f in starts}
    first = min(starts, key=lambda f: f.bic)
    best = record.polished(first.noise)
    tried = {len(first.noise.taps)}
    while best.bic < goal + near:
        at = len(best.noise.taps)
        orders = [at + step for step in away if 0 <= at + step <= largest and at + step not in tried]
        if not orders:
            break
        found = []
        for order in orders:
            tried.add(order)
            start = record.fitted(_resized(best.noise, order))
            if order in surveyed:
                start = min(start, surveyed[order], key=lambda f: f.deviance)
            found.append(record.polished(start.noise))
        now = min(found, key=lambda f: f.bic)
        if not now.bic < best.bic - _BETTER:
            break
        best = now
    return best


def fits_of(residual: FloatArray, good: BoolArray, starts: Starts = (0,), *,
            largest: int = LARGEST_ORDER) -> dict[str, Fitted]:
    """The best fit of each kind: AUTOREGRESSION (white noise included), MEASURED and WALK.

    All have the same rows: the level of every segment is integrated out. Empty for a residual of too few samples, or
    one that is 0.
    """
    record = _Record(residual, good, starts)
    largest = min(largest, record.rows // _ROWS_PER_ORDER)
    if record.rows < _FEWEST or not np.ptp(record.y[record.good]) > 0.0:
        return {}
    searched = record
    if record.y.size > _SEARCHED:
        searched = _part(record)
    groups: dict[str, list[Fitted]] = {}
    for (group, _), noise in _surveyed(searched, largest).items():
        fitted = searched.fitted(noise)
        if np.isfinite(fitted.bic):
            groups.setdefault(group, []).append(fitted)
    best: dict[str, Fitted] = {}
    for group in sorted(groups, key=lambda group: min(f.bic for f in groups[group])):
        goal = min((f.bic for f in best.values()), default=np.inf)
        best[group] = _climbed(searched, groups[group], largest, goal)
    for group in (WALK, MEASURED):
        other = best.get(MEASURED if group == WALK else WALK)
        if other is None:
            continue
        # Slow AR(1) noise and a walk start one another: the survey may have missed the better basin of one of them.
        near = replace(other.noise, rho=1.0 if group == WALK else 1.0 - _SLOW / searched.rows)
        if near.theta < near.rho:
            start = searched.fitted(near)
            if group not in best or start.bic < best[group].bic + _CROSSED:
                again = _climbed(searched, [start], largest, min(f.bic for f in best.values()))
                best[group] = min([again, *(best[g] for g in (group,) if g in best)], key=lambda f: f.bic)
    walks = [best.pop(group) for group in (WALK, _DIFFERENCES) if group in best]
    if walks:
        best[WALK] = min(walks, key=lambda f: f.bic)
    if searched is not record:
        best = {group: record.polished(fitted.noise, 3) for group, fitted in best.items()}
    return best


def _part(record: _Record) -> _Record:
    """So many rows from the middle of the record as orders are searched in."""
    first = (record.y.size - _SEARCHED) // 2
    inner = record.starts[(record.starts > first) & (record.starts < first + _SEARCHED)] - first
    rows = slice(first, first + _SEARCHED)
    return _Record(record.y[rows], record.good[rows], (0, *inner.tolist()))


def fit_noise(residual: FloatArray, good: BoolArray, starts: Starts = (0,), *, largest: int = LARGEST_ORDER,
              walk_margin: float = WALK_MARGIN) -> Noise:
    """The noise model of a residual (n,) with the least BIC; white noise where there are too few samples.

    A random walk must gain `walk_margin` over the best stationary noise.
    """
    found = fits_of(residual, good, starts, largest=largest)
    stationary = [fit for kind, fit in found.items() if kind != WALK]
    if not stationary:
        return found[WALK].noise if found else Noise()
    best = min(stationary, key=lambda f: f.bic)
    walk = found.get(WALK)
    return walk.noise if walk is not None and walk.bic + walk_margin < best.bic else best.noise
