"""Separable least squares (variable projection) for many candidates at once, and the information criterion BIC.

Each candidate has columns of its own (valve position, or response of the process), fitted together with the columns
that all share. Sums of products are collected with the candidates as the fast axis (numerics/cross_products.py), and
the small normal equations are solved in the same way. Shared columns are made orthonormal first, so that the sums stay
well conditioned. Source: Shang et al., Eq. 16 to 19 (squared norm); variable projection: Golub and Pereyra 1973.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..typing import BoolArray, FloatArray, IntArray
from .archived import runs_of
from .cross_products import products
from .jit import kernel, output

# Least share of the energy of a candidate's own columns that must remain without the shared columns. A candidate below
# it never moves and is rejected. Unit: 1.
DEPENDENT = 1e-10
REJECTED = np.inf
# Size, as a share of the largest direction, below which a direction is left out. The first is for shared columns, the
# second for a model's responses, whose rounding is larger. Unit: 1.
_SHARED, SAME = 1e-10, 1e-8
# Taps from which a recursion is shorter, distance at which taps are those of one, and decimals of its numbers.
_FEW, _SAME_TAPS, _DIGITS = 6, 1e-14, 12


@kernel
def _whiten(base: FloatArray, taps: FloatArray, out: FloatArray) -> None:
    """out[k] = base[k] + taps[0] * base[k-1] + ...; the first rows use the taps that have a row."""
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


def whiten(columns: FloatArray, taps: FloatArray, before: IntArray | None = None) -> FloatArray:
    """Columns (n, c) passed through 1 + taps[0] q^-1 + …; the first len(taps) rows are start-up and must not count.

    `before` (n,) is the row before each where that is not its neighbour, -1 for none (`autoregression.Links`). Rows
    without as many rows before them as there are taps are 0.
    """
    columns = np.ascontiguousarray(columns, dtype=np.float64)
    if taps.size == 0:
        return columns
    if not columns.flags.writeable:
        columns = columns.copy()  # a kernel is compiled anew for arrays that can't be written
    if before is not None:
        out = columns.copy()
        _whiten_links(out, before, np.ascontiguousarray(taps))
        return out
    out = np.empty_like(columns)
    _whiten(columns, np.ascontiguousarray(taps), out)
    return out


@kernel
def _inverse(columns: FloatArray, c: FloatArray, good: BoolArray, out: FloatArray) -> None:
    """out = columns / C(q), zero where a row does not count: the noise is unknown there and its mean is zero."""
    rows, count = columns.shape
    for k in range(rows):
        if not good[k]:
            for j in range(count):
                out[k, j] = 0.0
            continue
        for j in range(count):
            total = columns[k, j]
            for i in range(min(c.size, k)):
                total -= c[i] * out[k - 1 - i, j]
            out[k, j] = total


def inverse(columns: FloatArray, c: FloatArray, good: BoolArray) -> FloatArray:
    """Columns (n, q) passed through 1/C(q); rows where `good` (n,) is False become zero."""
    out = np.empty_like(columns)
    _inverse(np.ascontiguousarray(columns), np.ascontiguousarray(c), good, out)
    return out


def colour_noise(white: FloatArray, taps: FloatArray) -> FloatArray:
    """White noise (n,) passed through 1 / (1 + taps[0] q^-1 + …), begun from rest."""
    return inverse(white[:, None], taps, np.ones(white.size, bool))[:, 0]


@kernel
def _whiten_stack(base: FloatArray, samples: int, taps: FloatArray) -> None:
    """Filter each stretch of `samples` rows in place, last row first, so that no copy is needed.

    Four taps at a time: a row is loaded and stored once for four products.
    """
    lanes = base.shape[1]
    for first in range(0, base.shape[0], samples):
        for k in range(samples - 1, 0, -1):
            sink = base[first + k]
            count = min(taps.size, k)
            i = 0
            while i + 4 <= count:
                r0, r1 = base[first + k - 1 - i], base[first + k - 2 - i]
                r2, r3 = base[first + k - 3 - i], base[first + k - 4 - i]
                t0, t1, t2, t3 = taps[i], taps[i + 1], taps[i + 2], taps[i + 3]
                for p in range(lanes):
                    sink[p] += (t0 * r0[p] + t1 * r1[p]) + (t2 * r2[p] + t3 * r3[p])
                i += 4
            while i < count:
                t = taps[i]
                source = base[first + k - 1 - i]
                for p in range(lanes):
                    sink[p] += t * source[p]
                i += 1


@kernel
def _whiten_softly(base: FloatArray, samples: int, size: int, share: float, ratio: float) -> None:
    """Filter each stretch in place with softened taps, as a recursion: three products for any `size`."""
    lanes = base.shape[1]
    last = ratio**size
    # Differences still in the filter, and the row before the next.
    recent, before = np.empty((size, lanes)), np.empty(lanes)
    for first in range(0, base.shape[0], samples):
        recent[:] = 0.0
        before[:] = 0.0
        at = 0
        for k in range(first, first + samples):
            sink, oldest = base[k], recent[at]
            if k > first:
                so_far = base[k - 1]
                for p in range(lanes):
                    x = sink[p]
                    moved = x - share * before[p]
                    before[p] = x
                    sink[p] = moved + (ratio * so_far[p] - last * oldest[p])
                    oldest[p] = moved
            else:
                for p in range(lanes):
                    before[p] = oldest[p] = sink[p]
            at = at + 1 if at < size - 1 else 0


@kernel
def _whiten_links(base: FloatArray, before: IntArray, taps: FloatArray) -> None:
    """Filter each stretch of rows in place along its links, last row first."""
    samples, lanes = before.size, base.shape[1]
    for first in range(0, base.shape[0], samples):
        for k in range(samples - 1, -1, -1):
            sink = base[first + k]
            j = k
            for i in range(taps.size):
                j = before[j] if j >= 0 else -1
                if j >= 0:
                    t = taps[i]
                    source = base[first + j]
                    for p in range(lanes):
                        sink[p] += t * source[p]
            if j < 0:
                for p in range(lanes):
                    sink[p] = 0.0


def whiten_stack(base: FloatArray, samples: int, taps: FloatArray, before: IntArray | None = None) -> None:
    """Pass every column of a stack (columns*samples, P) through the filter of `whiten`, in place."""
    if before is not None:
        _whiten_links(base, before, np.ascontiguousarray(taps))
        return
    taps = np.ascontiguousarray(taps)
    if soft := _softened_numbers(taps.tobytes()):
        _whiten_softly(base, samples, taps.size, *soft)
        return
    _whiten_stack(base, samples, taps)


@lru_cache(maxsize=64)
def _softened_numbers(taps: bytes) -> tuple[float, float] | None:
    """Share m and ratio r of the taps of (1 - m q^-1) (1 + r q^-1 + r^2 q^-2 + …), cut at the last but one.

    None for other taps, and for a few. Softened differences of an integrator are so.
    """
    polynomial = np.concatenate([[1.0], np.frombuffer(taps)])
    if polynomial.size <= _FEW or not polynomial[1]:
        return None
    ratio = round(float(polynomial[2] / polynomial[1]), _DIGITS)
    share = round(ratio - float(polynomial[1]), _DIGITS)
    same = np.convolve([1.0, -share], ratio ** np.arange(polynomial.size - 1))
    return (share, ratio) if np.allclose(same, polynomial, rtol=0.0, atol=_SAME_TAPS) else None


def axes(columns: FloatArray, least: float) -> FloatArray:
    """Orthonormal axes (n, k) of the span of columns (n, c), after each column was scaled to length 1.

    Directions that carry less than the share `least` of the largest are left out.
    """
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0] / norms[norms > 0]
    if not columns.shape[1]:
        return columns
    found, size, _ = np.linalg.svd(columns, full_matrices=False)
    return found[:, size > least * size[0]]


@dataclass(frozen=True, slots=True)
class Shared:
    """Part of a least squares that all candidates share: weights (n,), orthonormal columns, target without them.

    `runs` (2, r) are first row and last row + 1 of every run of rows that count. `right` (n, even) holds the
    orthonormal columns, the target without them, and a column of zeros where the number would be odd. `sign` is that
    of the first own column's coefficient (1 or -1), 0 where either is allowed: a candidate with the other sign counts
    as one that explains nothing.
    """

    weight: FloatArray
    basis: FloatArray
    target: FloatArray
    target_energy: float
    rows: int
    freedom: int
    right: FloatArray
    runs: IntArray
    sign: float = 0.0

    @classmethod
    def prepare(cls, target: FloatArray, columns: FloatArray, weight: BoolArray | FloatArray,
                sign: float = 0.0) -> Shared:
        """Target (n,), shared columns (n, q) and weights (n,) 0 or 1; rows of weight 0 are never read."""
        w = np.asarray(weight, dtype=np.float64)
        columns = np.where(w[:, None] > 0, columns, 0.0) if columns.size else np.empty((target.size, 0))
        # Rounding leaves 1e-17 in rows that don't count, where a start-up transient is still 1. Its whole energy in the
        # rows that count may be smaller, and the cost then came out as 0.
        columns = np.where(w[:, None] > 0, axes(columns, _SHARED), 0.0)
        y = np.where(w > 0, target, 0.0)
        y = y - columns @ (columns.T @ y)
        none = np.zeros((y.size, 1 - columns.shape[1] % 2))
        right = np.ascontiguousarray(np.concatenate([columns, y[:, None], none], axis=1))
        return cls(w, np.ascontiguousarray(columns), y, float(y @ y), int((w > 0).sum()), columns.shape[1], right,
                   np.stack(runs_of(w > 0)), sign)

    def costs(self, base: FloatArray, offsets: tuple[int, ...] = (0,)) -> FloatArray:
        """Sum of squared residuals (P,) of each candidate; `inf` where a candidate's columns never move."""
        return self.solve(base, offsets)[0]

    def solve(self, base: FloatArray, offsets: tuple[int, ...] = (0,)) -> tuple[FloatArray, FloatArray]:
        """Sum of squared residuals (P,) and own coefficients (own, P) of each candidate.

        `base` is (rows, P): column i of candidate p is base[offsets[i] : offsets[i] + n, p].
        """
        return self.solved(*products(base, offsets, self.right, *self.runs))

    def solved(self, squares: FloatArray, cross: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Costs and own coefficients as in `solve`, from products (own, own, P) and (own, freedom + 1 or more, P).

        Overwrites the squares, and the row of products with the target.
        """
        own, _, lanes = cross.shape
        cost, sizes = np.empty(lanes), np.empty((own, lanes))
        _solve(squares, cross, self.freedom, self.target_energy, cost, sizes)
        enforce_sign(cost, sizes, sizes[0], self.sign, self.target_energy)
        return cost, sizes

    def residuals(self, base: FloatArray, offsets: tuple[int, ...] = (0,), *, lent: bool = False) -> FloatArray:
        """Residuals (n, P) of each candidate after the fit of `solve`, 0 where a row does not count.

        `lent` ones hold until the next call (see `scratch` in numerics/jit.py).
        """
        squares, cross = products(base, offsets, self.right, *self.runs)
        cost, sizes = self.solved(squares, cross)
        out = output("residuals", self.target.size, base.shape[1], lent)
        _residuals(base, np.asarray(offsets, np.int64), sizes, cross, self.weight, self.target, self.basis, out)
        still = ~np.isfinite(cost)
        if still.any():
            out[:, still] = REJECTED
        return out


def enforce_sign(cost: FloatArray, sizes: FloatArray, first: FloatArray, sign: float, energy: float) -> None:
    """Set cost (P,) and sizes (..., P) to those of no own column where the `first` size (P,) has the wrong `sign`."""
    wrong = sign * first < 0.0
    cost[wrong & np.isfinite(cost)] = energy
    sizes[..., wrong] = 0.0


@kernel
def _residuals(base: FloatArray, offsets: IntArray, sizes: FloatArray, cross: FloatArray, weight: FloatArray,
               target: FloatArray, basis: FloatArray, out: FloatArray) -> None:
    """Residuals: target less own columns times sizes, less their projection on the shared columns (from `cross`)."""
    own, lanes = sizes.shape
    q = basis.shape[1]
    back = np.zeros((q, lanes))
    for i in range(own):
        for c in range(q):
            for p in range(lanes):
                back[c, p] += sizes[i, p] * cross[i, c, p]
    for k in range(out.shape[0]):
        sink = out[k]
        if weight[k] > 0.0:
            t = target[k]
            for p in range(lanes):
                sink[p] = t
            for i in range(own):
                row = base[offsets[i] + k]
                for p in range(lanes):
                    sink[p] -= sizes[i, p] * row[p]
            for c in range(q):
                b = basis[k, c]
                for p in range(lanes):
                    sink[p] += b * back[c, p]
        else:
            for p in range(lanes):
                sink[p] = 0.0


@kernel
def _solve(squares: FloatArray, cross: FloatArray, q: int, energy: float, cost: FloatArray, sizes: FloatArray) -> None:
    """Normal equations of every candidate, shared columns (orthonormal) taken out first; by elimination, in place."""
    own, lanes = sizes.shape
    for p in range(lanes):
        cost[p] = energy
    least = np.empty((own, lanes))
    for i in range(own):
        for p in range(lanes):
            least[i, p] = DEPENDENT * squares[i, i, p]
        for j in range(i + 1):
            for c in range(q):
                for p in range(lanes):
                    squares[i, j, p] -= cross[i, c, p] * cross[j, c, p]
    for p in range(lanes):
        cost[p] = cost[p] if squares[0, 0, p] > least[0, p] else np.inf
    for i in range(own):
        for p in range(lanes):
            # A further column that is dependent on the others (a transient that has decayed, say) gets no coefficient.
            new = squares[i, i, p] > least[i, p]
            squares[i, i, p] = squares[i, i, p] if new else 1.0
            cross[i, q, p] = cross[i, q, p] if new else 0.0
            for j in range(i + 1, own):
                squares[j, i, p] = squares[j, i, p] if new else 0.0
        for j in range(i + 1, own):
            for p in range(lanes):
                factor = squares[j, i, p] / squares[i, i, p]
                cross[j, q, p] -= factor * cross[i, q, p]
                squares[i, j, p] = factor
            for m in range(i + 1, j + 1):
                for p in range(lanes):
                    squares[j, m, p] -= squares[i, j, p] * squares[m, i, p]
        for p in range(lanes):
            cost[p] -= cross[i, q, p] * cross[i, q, p] / squares[i, i, p]
    for p in range(lanes):
        value = max(cost[p], 0.0)
        cost[p] = value if np.isfinite(value) else np.inf
    for i in range(own - 1, -1, -1):
        for p in range(lanes):
            sizes[i, p] = cross[i, q, p] / squares[i, i, p]
        for j in range(i + 1, own):
            for p in range(lanes):
                sizes[i, p] -= squares[i, j, p] * sizes[j, p]
