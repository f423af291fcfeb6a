"""Filter and exact likelihood of the noise family, of whose samples any may be missing.

The state has m numbers, companion form of A (1 - rho q^-1). A missing sample is predicted and corrects nothing. The
gains do not depend on the data, so that data, bias and all columns of a model pass the same linear filter. The start is
exact: stationary for rho < 1; for rho = 1 the first sample of a segment sets the level and does not count. Source:
docs/details.md, section 7; Harvey 1989, 3.3; Durbin and Koopman 2012, 5.2 (diffuse start).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...typing import BoolArray, FloatArray, IntArray
from ..autoregression import Starts
from ..jit import kernel
from .family import Noise

# Distance of gain and scale from their limits below which the filter has settled. Unit: 1.
_SETTLED = 1e-12
# A filtered column smaller than this share of itself unfiltered is rounding: the level under a random walk. Unit: 1.
_ROUNDING = 1e-12
# Kinds of rows for the kernels.
_NO_ROW, _ROW, _STEADY = 0, 1, 2


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
def _gains(phi: FloatArray, theta: float, P0: FloatArray, level: FloatArray, walks: bool, good: BoolArray,
           starts: IntArray, kind: IntArray, inverse: FloatArray, gain: FloatArray) -> float:
    """Kind, 1/sqrt(f) and gain of every row, and the sum of log f over the rows that count."""
    n, m = good.size, phi.size
    P, Q = np.zeros((m, m)), np.zeros((m, m))
    total, segment, begun, steady = 0.0, 0, False, False
    for t in range(n):
        if segment < starts.size and t == starts[segment]:
            segment += 1
            begun = steady = False
        kind[t], inverse[t] = _NO_ROW, 0.0
        if not begun and not good[t]:
            continue
        if good[t] and steady:
            kind[t], inverse[t] = _STEADY, 1.0
            continue
        first = not begun
        if first:
            begun = True
            for i in range(m):
                for j in range(m):
                    P[i, j] = P0[i, j]
        if steady:
            steady = False
            for i in range(m):
                for j in range(m):
                    P[i, j] = 0.0
            P[0, 0] = 1.0
            if m > 1:
                P[1, 0] = P[0, 1] = -theta
                P[1, 1] = theta * theta
        if good[t] and first and walks:
            kind[t] = _ROW
            for i in range(m):
                gain[t, i] = level[i]
            for i in range(m):
                for j in range(m):
                    Q[i, j] = P[i, j] - level[i] * P[0, j] - P[i, 0] * level[j] + level[i] * level[j] * P[0, 0]
        elif good[t]:
            f = P[0, 0]
            total += np.log(f)
            kind[t], inverse[t] = _ROW, 1.0 / np.sqrt(f)
            steady = abs(f - 1.0) < _SETTLED
            for i in range(m):
                gain[t, i] = P[i, 0] / f
                goal = 1.0 if i == 0 else (-theta if i == 1 else 0.0)
                steady = steady and abs(gain[t, i] - goal) < _SETTLED
            for i in range(m):
                for j in range(m):
                    Q[i, j] = P[i, j] - gain[t, i] * P[0, j]
            for i in range(m):
                Q[i, 0] = Q[0, i] = 0.0
        else:
            for i in range(m):
                for j in range(m):
                    Q[i, j] = P[i, j]
        for i in range(m):
            for j in range(m):
                value = phi[i] * phi[j] * Q[0, 0]
                if j + 1 < m:
                    value += phi[i] * Q[0, j + 1]
                if i + 1 < m:
                    value += phi[j] * Q[i + 1, 0]
                    if j + 1 < m:
                        value += Q[i + 1, j + 1]
                P[i, j] = value
        P[0, 0] += 1.0
        if m > 1:
            P[1, 0] -= theta
            P[0, 1] -= theta
            P[1, 1] += theta * theta
    return total


@kernel
def _filter(base: FloatArray, samples: int, phi: FloatArray, theta: float, starts: IntArray, kind: IntArray,
            inverse: FloatArray, gain: FloatArray, runs: IntArray) -> None:
    """Scaled innovations of each stretch of `samples` rows in place; `gain` (rows, m + 1) ends with a column of 0."""
    m, lanes = phi.size, base.shape[1]
    x = np.zeros((m + 1, lanes))
    y = np.empty(lanes)
    head, second = x[0], x[1]
    for first in range(0, base.shape[0], samples):
        segment, run, stop = 0, 0, 0
        for t in range(samples):
            if run < runs.shape[1] and t == runs[0, run]:
                stop = runs[1, run]
                run += 1
            if t < stop:
                # Rows that `_settled` has filtered already.
                continue
            if segment < starts.size and t == starts[segment]:
                segment += 1
                x[:] = 0.0
            row, c = base[first + t], phi[0]
            if kind[t] == _STEADY:
                if m == 1:
                    for p in range(lanes):
                        value = row[p]
                        row[p] = value - head[p]
                        head[p] = c * value
                    continue
                for p in range(lanes):
                    value = row[p]
                    e = value - head[p]
                    y[p] = value
                    row[p] = e
                    head[p] = c * value + second[p] - theta * e
                # Two rows of the state at once: each row of the data is loaded half as often.
                i = 1
                while i + 1 < m:
                    c, d, sink, both, source = phi[i], phi[i + 1], x[i], x[i + 1], x[i + 2]
                    for p in range(lanes):
                        value = both[p]
                        sink[p] = c * y[p] + value
                        both[p] = d * y[p] + source[p]
                    i += 2
                if i < m:
                    c, sink = phi[i], x[i]
                    for p in range(lanes):
                        sink[p] = c * y[p]
            elif kind[t] == _ROW:
                s, g = inverse[t], gain[t]
                k = g[1]
                for p in range(lanes):
                    value = row[p]
                    e = value - head[p]
                    y[p] = value
                    row[p] = e
                    head[p] = c * value + second[p] + k * e
                for i in range(1, m):
                    c, k, sink, source = phi[i], g[i + 1], x[i], x[i + 1]
                    for p in range(lanes):
                        sink[p] = c * y[p] + source[p] + k * row[p]
                for p in range(lanes):
                    row[p] *= s
            else:
                for p in range(lanes):
                    value = head[p]
                    y[p] = value
                    row[p] = 0.0
                    head[p] = c * value + second[p]
                for i in range(1, m):
                    c, sink, source = phi[i], x[i], x[i + 1]
                    for p in range(lanes):
                        sink[p] = c * y[p] + source[p]


@kernel
def _settled(base: FloatArray, samples: int, taps: FloatArray, runs: IntArray) -> None:
    """Rows [a, b) of each run (2, r) and stretch passed through 1 + taps[0] q^-1 + …, in place, last row first."""
    lanes, p = base.shape[1], taps.size
    for first in range(0, base.shape[0], samples):
        for r in range(runs.shape[1]):
            for t in range(first + runs[1, r] - 1, first + runs[0, r] - 1, -1):
                sink, i = base[t], 0
                # Two taps at once: the row of the result is loaded and stored half as often.
                while i + 1 < p:
                    c, d, one, two = taps[i], taps[i + 1], base[t - 1 - i], base[t - 2 - i]
                    for lane in range(lanes):
                        sink[lane] += c * one[lane] + d * two[lane]
                    i += 2
                if i < p:
                    c, one = taps[i], base[t - 1 - i]
                    for lane in range(lanes):
                        sink[lane] += c * one[lane]


class Whitener:
    """The filter of one noise model on the rows (n,) that are `good`, started anew with each segment (`starts`).

    `rows` (n,) are the rows that count, and `log_scale` is the sum of log f over them. Immutable.
    """

    def __init__(self, noise: Noise, good: BoolArray, starts: Starts = (0,)) -> None:
        self.noise, self.starts = noise, starts
        polynomial, self._theta = noise.plain
        m = max(polynomial.size - 1, 2 if self._theta else 1)
        self._phi, P, level = np.empty(m), np.empty((m, m)), np.empty(m)
        stationary = np.concatenate([[1.0], noise.taps]) if noise.walks else polynomial
        if not start_of(np.ascontiguousarray(stationary[1:]), self._theta, noise.walks, self._phi, P, level):
            raise ValueError(f"taps {noise.taps} with rho {noise.rho:g} are not stable; fit the noise model again")
        self._starts = np.array(starts, np.int64)
        self._kind, self._inverse = np.empty(good.size, np.int8), np.empty(good.size)
        gain = np.zeros((good.size, m + 1))
        self.log_scale = float(_gains(self._phi, self._theta, P, level, noise.walks, np.ascontiguousarray(good),
                                      self._starts, self._kind, self._inverse, gain))
        # Gains of settled rows are never read.
        last = np.flatnonzero(self._kind == _ROW)
        self._gain = gain[:int(last[-1]) + 1 if last.size else 1].copy()
        self._runs = self._settled_runs()
        self.rows: BoolArray = self._inverse > 0.0

    def _settled_runs(self) -> IntArray:
        """First row and last row + 1 (2, r) of the end of every segment where a filter without theta is a plain sum.

        As many good rows as its order stand before each. With theta the recursion of the state is faster (measured).
        """
        found: list[tuple[int, int]] = []
        if self._theta:
            return np.empty((2, 0), np.int64)
        for first, stop in zip(self.starts, (*self.starts[1:], self._kind.size), strict=True):
            unsettled = np.flatnonzero(self._kind[first:stop] != _STEADY)
            missing = np.flatnonzero(self._kind[first:stop] == _NO_ROW)
            begin = first + max(int(unsettled[-1]) + 1 if unsettled.size else 0,
                                (int(missing[-1]) + 1 if missing.size else 0) + self._phi.size)
            if begin < stop:
                found.append((begin, stop))
        return np.ascontiguousarray(np.array(found, np.int64).reshape(-1, 2).T)

    def apply(self, columns: FloatArray) -> FloatArray:
        """Scaled innovations e/sqrt(f) (n, c) of columns (n, c), 0 where no row counts.

        A column that is 0 but for rounding, such as the level under a random walk, comes back as exactly 0.
        """
        out = np.array(columns, dtype=np.float64, order="C")
        self.apply_stack(out, len(out))
        size = np.abs(np.where((self._kind != _NO_ROW)[:, None], columns, 0.0)).max(axis=0, initial=0.0)
        out[:, np.abs(out).max(axis=0, initial=0.0) <= _ROUNDING * size] = 0.0
        return out

    def apply_stack(self, base: FloatArray, samples: int) -> None:
        """Replace every column of a stack (k*samples, P) by its scaled innovations, in place."""
        if samples != self._kind.size:
            raise ValueError(f"the stack has {samples} samples a column and the filter {self._kind.size}; "
                             f"build the filter on the same record")
        if self.noise.white:
            base.reshape(-1, samples, base.shape[1])[:, ~self.rows] = 0.0
            return
        _settled(base, samples, -self._phi, self._runs)
        _filter(base, samples, self._phi, self._theta, self._starts, self._kind, self._inverse, self._gain, self._runs)

    @cached_property
    def levels(self) -> FloatArray:
        """Filtered level of every segment (n, segments); zeros under a random walk, whose start it replaces."""
        segment = np.searchsorted(self.starts, np.arange(self._kind.size), side="right") - 1
        return self.apply((segment[:, None] == np.arange(len(self.starts))).astype(np.float64))


@dataclass(frozen=True, slots=True)
class Likelihood:
    """Sum of squared scaled innovations, number of rows and sum of log f of a residual under a noise model.

    The rows are those that count as independent, where a residual is not white.
    """

    sse: float
    rows: float
    log_scale: float = 0.0

    @property
    def deviance(self) -> float:
        """-2 log L without constants, the variance of the innovations at its best value."""
        return self.rows * float(np.log(max(self.sse, 1e-300) / max(self.rows, 1))) + self.log_scale

    def bic(self, parameters: int) -> float:
        """Bayesian information criterion with so many estimated numbers."""
        return self.deviance + parameters * float(np.log(max(self.rows, 1)))


def likelihood(residual: FloatArray, noise: Noise, good: BoolArray, starts: Starts = (0,), *,
               level: bool = True) -> Likelihood:
    """Exact likelihood of a residual (n,) of which the `good` samples are there.

    With `level` every segment has an unknown level, integrated out whatever the noise is. Walks and levels then have
    the same rows and one scale, and rho = 1 is the limit of rho < 1. Without it the residual of stationary noise has
    mean zero, and one row more than that of a walk.
    """
    whitener = Whitener(noise, good, starts)
    innovation = whitener.apply(residual[:, None])[:, 0]
    rows, log_scale = int(whitener.rows.sum()), whitener.log_scale
    sse = float(innovation @ innovation)
    if level and not noise.walks:
        columns = whitener.levels
        energy = np.einsum("ns,ns->s", columns, columns)
        there = energy > 0.0
        sse -= float(np.sum((innovation @ columns[:, there]) ** 2 / energy[there]))
        log_scale += float(np.log(energy[there]).sum())
        rows -= int(there.sum())
    return Likelihood(max(sse, 0.0), rows, log_scale)
