"""Descent on the exact likelihood of the noise family, in numbers in which every model is stable.

-2 log L of the concentrated likelihood is rows ln(sum of squares) of innovations over the geometric mean of their
scales: a least-squares problem, solved by Gauss-Newton. A stands in partial autocorrelations. The level of each segment
is integrated out for every kind alike.

The state has m numbers, companion form of A (1 - rho q^-1). A missing sample is predicted and corrects nothing. The
start is exact: stationary for rho < 1; for rho = 1 the first sample of a segment sets the level and does not count.
Source: Jones 1980 (missing samples, partial autocorrelations); Levenberg 1944, Marquardt 1963; Harvey 1989, 3.3; Durbin
and Koopman 2012, 5.2 (diffuse start).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...typing import BoolArray, FloatArray, IntArray
from ..autoregression import Starts
from ..jit import kernel
from .family import AUTOREGRESSION, MEASURED, WALK, Noise

# Rounds of Gauss-Newton, the fall of -2 log L below which it has settled, and the step of its differences.
_ROUNDS, _SETTLED, _STEP = 12, 0.01, 1e-4
# Largest transformed number: 1 - tanh(5) is 1e-4 and the logistic function of 12 lacks 6e-6 of 1.
_FARTHEST, _FARTHEST_PAIR = 5.0, 12.0
# Group of random walks without measurement noise (theta = 0), which have one number less.
DIFFERENCES = "differences"


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fitted noise model with its exact -2 log L (concentrated, levels integrated out) and its BIC."""

    noise: Noise
    deviance: float
    bic: float


@kernel
def start_of(ar: FloatArray, theta: float, walks: bool, phi: FloatArray, P: FloatArray, level: FloatArray) -> bool:
    """Fill phi (m,), the state's covariance P (m, m) at a start and the direction of the level; False if not stable.

    `ar` holds the coefficients after the leading 1 of the stationary part: A (1 - rho q^-1), or A under a random walk.
    """
    q, m = ar.size, phi.size
    # Taps down to order 0 give the reflections; up again they give the autocovariances of 1 / A.
    table = np.zeros((q + 1, q + 1))
    for i in range(q):
        table[q, i] = ar[i]
    variance = 1.0
    for k in range(q, 0, -1):
        reflection = table[k, k - 1]
        rest = 1.0 - reflection * reflection
        if not rest > 0.0:
            return False
        variance /= rest
        for i in range(k - 1):
            table[k - 1, i] = (table[k, i] - reflection * table[k, k - 2 - i]) / rest
    w = np.zeros(m + 2)
    w[0] = variance
    for k in range(1, m + 2):
        order = min(k, q)
        total = 0.0
        if k <= q:
            for i in range(k - 1):
                total -= table[k - 1, i] * w[k - 1 - i]
            total -= table[k, k - 1] * variance
            variance *= 1.0 - table[k, k - 1] ** 2
        else:
            for i in range(order):
                total -= ar[i] * w[k - 1 - i]
        w[k] = total
    g = np.empty(m + 1)
    for k in range(m + 1):
        g[k] = (1.0 + theta * theta) * w[k] - theta * (w[abs(k - 1)] + w[k + 1])
    for i in range(m):
        phi[i] = -ar[i] if i < q else 0.0
    if walks:
        for i in range(min(q, m - 1), -1, -1):
            phi[i] = (-ar[i] if i < q else 0.0) + (ar[i - 1] if i > 0 else 1.0)
    # The state as a sum of past signals (differences of v under a random walk) and the last two innovations.
    B = np.zeros((m, m + 2))
    for i in range(m):
        if walks:
            level[i] = 0.0
            for j in range(i, m):
                level[i] += phi[j]
            # v(-1-k) = v(-1) - dv(-1) - … - dv(-k), and v(-1) is the level.
            for j in range(i, m):
                for k in range(j - i):
                    B[i, k] -= phi[j]
        else:
            level[i] = 0.0
            for j in range(i, m):
                B[i, j - i] += phi[j]
    B[0, m + 1] = 1.0
    B[0, m] = -theta
    if m > 1:
        B[1, m + 1] = -theta
    C = np.zeros((m + 2, m + 2))
    for i in range(m):
        for j in range(m):
            C[i, j] = g[abs(i - j)]
    C[0, m] = C[m, 0] = 1.0
    C[m, m] = C[m + 1, m + 1] = 1.0
    half = np.zeros((m, m + 2))
    for i in range(m):
        for j in range(m + 2):
            for k in range(m + 2):
                half[i, j] += B[i, k] * C[k, j]
    for i in range(m):
        for j in range(m):
            P[i, j] = 0.0
            for k in range(m + 2):
                P[i, j] += half[i, k] * B[j, k]
    return True


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


class Record:
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

    def with_likelihood(self, noise: Noise) -> Fitted:
        """The noise model with its -2 log L and BIC."""
        deviance = self.innovations(noise)[1]
        return Fitted(noise, deviance, deviance + noise.numbers * float(np.log(max(self.rows, 2))))

    def polish_noise(self, noise: Noise, rounds: int = _ROUNDS) -> Fitted:
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
                trial = _clip_inside(z - np.clip(np.linalg.solve(steep, down), -2.0, 2.0), noise)
                now, value = self.innovations(build(trial))
                if value < deviance:
                    fall, z, r, deviance = deviance - value, trial, now, value
                    damping *= 0.1
                    break
                damping = max(10.0 * damping, 1e-3)
            if fall < _SETTLED:
                break
        return self.with_likelihood(build(z))


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
    group = group_of(noise)
    if group == WALK:
        z = np.append(z, _logit(noise.theta))
    elif group == MEASURED:
        z = np.append(z, [_logit(noise.rho), _logit(noise.theta / noise.rho)])
    return _clip_inside(z, noise)


def _clip_inside(z: FloatArray, noise: Noise) -> FloatArray:
    order = len(noise.taps)
    return np.concatenate([np.clip(z[:order], -_FARTHEST, _FARTHEST), np.clip(z[order:], -_FARTHEST_PAIR,
                                                                              _FARTHEST_PAIR)])


def _builder(noise: Noise) -> Callable[[FloatArray], Noise]:
    """The function from coordinates to noise models of the same kind and order."""
    order, group = len(noise.taps), group_of(noise)
    if group == DIFFERENCES:
        return lambda z: Noise(_taps(np.tanh(z[:order])), 1.0)
    if group == WALK:
        return lambda z: Noise(_taps(np.tanh(z[:order])), 1.0, _logistic(z[order]))
    if group == AUTOREGRESSION:
        return lambda z: Noise(_taps(np.tanh(z[:order])))
    return lambda z: Noise(_taps(np.tanh(z[:order])), rho := _logistic(z[order]), rho * _logistic(z[order + 1]))


def group_of(noise: Noise) -> str:
    """Group in which a noise model competes: one kind of `fits_of`, or a walk of which theta stays 0."""
    if noise.walks and noise.theta == 0.0:
        return DIFFERENCES
    return WALK if noise.walks else AUTOREGRESSION if noise.cancels else MEASURED


def resize_order(noise: Noise, order: int) -> Noise:
    """The noise model with another order of A: further reflections are small, superfluous ones are dropped."""
    reflections = _reflections(np.array(noise.taps))[:order]
    return replace(noise, taps=_taps(np.concatenate([reflections, np.full(order - reflections.size, 0.05)])))
