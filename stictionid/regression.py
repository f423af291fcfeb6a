"""Separable least squares for many candidates at once: the one cost, and the information criteria.

For each candidate the columns that differ between candidates (valve position, or response of the process) are
fitted together with the columns that all share. Sums of products are collected row by row with the candidates as
the fast axis; the small normal equations are then solved by Cholesky. Shared columns are made orthonormal first,
so that the sums stay well conditioned. Source: paper Eq. 16 to 19 (squared norm), variable projection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .kernels import LANES, kernel
from .loop import BoolArray, FloatArray

# A candidate whose own columns carry less than this share of the energy of what they were before the shared
# columns were taken out never moved: it is rejected. Unit: 1.
DEPENDENT = 1e-10
REJECTED = np.inf


@kernel
def products(base, offsets, shared, weight, squares, cross):
    """Sums over rows of weight * column_i * column_j and of column_i * shared_c (weighted already), four rows a pass.

    Column i of a candidate is base[row + offsets[i]], so lagged copies and stacked signals need no copying.
    """
    rows = shared.shape[0]
    count = shared.shape[1]
    own = offsets.size
    lanes = base.shape[1]
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        last = first + width
        sums = np.zeros((own * (own + 1) // 2 + own * count, LANES))
        k = 0
        while k < rows:
            many = k + 4 <= rows
            at = 0
            for i in range(own):
                o = k + offsets[i]
                a0 = base[o, first:last]
                if many:
                    a1 = base[o + 1, first:last]
                    a2 = base[o + 2, first:last]
                    a3 = base[o + 3, first:last]
                    w0, w1, w2, w3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
                    for j in range(i + 1):
                        o = k + offsets[j]
                        b0 = base[o, first:last]
                        b1 = base[o + 1, first:last]
                        b2 = base[o + 2, first:last]
                        b3 = base[o + 3, first:last]
                        sink = sums[at]
                        for p in range(width):
                            sink[p] += (w0 * a0[p] * b0[p] + w1 * a1[p] * b1[p]) + (
                                w2 * a2[p] * b2[p] + w3 * a3[p] * b3[p])
                        at += 1
                    for c in range(count):
                        s0, s1, s2, s3 = shared[k, c], shared[k + 1, c], shared[k + 2, c], shared[k + 3, c]
                        sink = sums[at]
                        for p in range(width):
                            sink[p] += (s0 * a0[p] + s1 * a1[p]) + (s2 * a2[p] + s3 * a3[p])
                        at += 1
                else:
                    for j in range(i + 1):
                        b0 = base[k + offsets[j], first:last]
                        sink = sums[at]
                        for p in range(width):
                            sink[p] += weight[k] * a0[p] * b0[p]
                        at += 1
                    for c in range(count):
                        sink = sums[at]
                        for p in range(width):
                            sink[p] += shared[k, c] * a0[p]
                        at += 1
            k += 4 if many else 1
        at = 0
        for i in range(own):
            for j in range(i + 1):
                for p in range(width):
                    squares[i, j, first + p] = sums[at, p]
                    squares[j, i, first + p] = sums[at, p]
                at += 1
            for c in range(count):
                for p in range(width):
                    cross[i, c, first + p] = sums[at, p]
                at += 1


@kernel
def _whiten(base, taps, out):
    """out[k] = base[k] + taps[0] * base[k-1] + ...; the first rows use what is there."""
    rows, lanes = base.shape
    for k in range(rows):
        sink = out[k]
        source = base[k]
        for p in range(lanes):
            sink[p] = source[p]
        for i in range(min(taps.size, k)):
            t = taps[i]
            source = base[k - 1 - i]
            for p in range(lanes):
                sink[p] += t * source[p]


def whiten(columns: FloatArray, taps: FloatArray) -> FloatArray:
    """Columns (n, c) passed through 1 + taps[0] q^-1 + …; the first len(taps) rows are start-up and must not count."""
    columns = np.ascontiguousarray(columns, dtype=np.float64)
    if taps.size == 0:
        return columns
    out = np.empty_like(columns)
    _whiten(columns, np.ascontiguousarray(taps), out)
    return out


@kernel
def _whiten_stack(base, samples, taps):
    """Filter each stretch of `samples` rows in place, last row first, so that no copy is needed."""
    lanes = base.shape[1]
    for first in range(0, base.shape[0], samples):
        for k in range(samples - 1, 0, -1):
            sink = base[first + k]
            for i in range(min(taps.size, k)):
                t = taps[i]
                source = base[first + k - 1 - i]
                for p in range(lanes):
                    sink[p] += t * source[p]


def whiten_stack(base: FloatArray, samples: int, taps: FloatArray) -> None:
    """Pass every column of a stack (columns*samples, P) through the filter of `whiten`, in place."""
    _whiten_stack(base, samples, np.ascontiguousarray(taps))


@dataclass(frozen=True, slots=True)
class Shared:
    """What all candidates share in a least squares: rows (n,) that count, orthonormal columns, target without them."""

    weight: FloatArray
    basis: FloatArray
    target: FloatArray
    target_energy: float
    rows: int
    freedom: int
    right: FloatArray

    @classmethod
    def prepare(cls, target: FloatArray, columns: FloatArray, weight: BoolArray | FloatArray) -> Shared:
        """Target (n,), shared columns (n, q) and weights (n,) 0 or 1; rows of weight 0 are never looked at."""
        w = np.asarray(weight, dtype=np.float64)
        columns = np.where(w[:, None] > 0, columns, 0.0) if columns.size else np.empty((target.size, 0))
        norms = np.linalg.norm(columns, axis=0)
        columns = columns[:, norms > 0] / norms[norms > 0]
        if columns.shape[1]:
            u, s, _ = np.linalg.svd(columns, full_matrices=False)
            columns = u[:, s > 1e-10 * s[0]]
        y = np.where(w > 0, target, 0.0)
        y = y - columns @ (columns.T @ y)
        right = np.ascontiguousarray(np.concatenate([columns, y[:, None]], axis=1))
        return cls(w, np.ascontiguousarray(columns), y, float(y @ y), int((w > 0).sum()), columns.shape[1], right)

    def costs(self, base: FloatArray, offsets: tuple[int, ...] = (0,)) -> FloatArray:
        """Sum of squared residuals (P,) of each candidate; `inf` where a candidate's columns never move."""
        return self.solve(base, offsets)[0]

    def solve(self, base: FloatArray, offsets: tuple[int, ...] = (0,)) -> tuple[FloatArray, FloatArray]:
        """Sum of squared residuals (P,) and own coefficients (own, P) of each candidate.

        `base` is (rows, P): column i of candidate p is base[offsets[i] : offsets[i] + n, p].
        """
        own, lanes, q = len(offsets), base.shape[1], self.basis.shape[1]
        squares = np.empty((own, own, lanes))
        cross = np.empty((own, q + 1, lanes))
        products(base, np.asarray(offsets, np.int64), self.right, self.weight, squares, cross)
        cost, sizes = np.empty(lanes), np.empty((own, lanes))
        _solve(squares, cross, self.target_energy, cost, sizes)
        return cost, sizes

    def residuals(self, base: FloatArray, offsets: tuple[int, ...] = (0,)) -> FloatArray:
        """Residuals (n, P) of each candidate after the fit of `solve`, 0 where a row does not count."""
        n = self.target.size
        cost, sizes = self.solve(base, offsets)
        out = np.repeat(self.target[:, None], base.shape[1], axis=1)
        for o, size in zip(offsets, sizes, strict=True):
            out -= base[o:o + n] * size
        out *= self.weight[:, None]
        out -= self.basis @ (self.basis.T @ out)
        out[:, ~np.isfinite(cost)] = REJECTED
        return out


@kernel
def _solve(squares, cross, energy, cost, sizes):
    """Normal equations of every candidate, shared columns (orthonormal) taken out first; by elimination."""
    own, lanes = sizes.shape
    q = cross.shape[1] - 1
    a = np.empty((own, own))
    b = np.empty(own)
    for p in range(lanes):
        for i in range(own):
            b[i] = cross[i, q, p]
            for j in range(own):
                a[i, j] = squares[i, j, p]
                for c in range(q):
                    a[i, j] -= cross[i, c, p] * cross[j, c, p]
        moved = a[0, 0] > DEPENDENT * squares[0, 0, p]
        gain = 0.0
        for i in range(own):
            if not a[i, i] > DEPENDENT * squares[i, i, p]:
                # A further column that says nothing new (a transient long gone, say) gets no coefficient.
                a[i, i] = 1.0
                b[i] = 0.0
                for j in range(i + 1, own):
                    a[i, j] = 0.0
                    a[j, i] = 0.0
            for j in range(i + 1, own):
                factor = a[j, i] / a[i, i]
                for c in range(i, own):
                    a[j, c] -= factor * a[i, c]
                b[j] -= factor * b[i]
            gain += b[i] * b[i] / a[i, i]
        for i in range(own - 1, -1, -1):
            total = b[i]
            for j in range(i + 1, own):
                total -= a[i, j] * sizes[j, p]
            sizes[i, p] = total / a[i, i]
        value = max(energy - gain, 0.0)
        cost[p] = value if moved and np.isfinite(value) else np.inf


def bic(sse: float, rows: float, parameters: int) -> float:
    """Bayesian information criterion n ln(SSE/n) + k ln n, for `rows` effective samples."""
    return rows * float(np.log(max(sse, 1e-300) / rows)) + parameters * float(np.log(rows))
