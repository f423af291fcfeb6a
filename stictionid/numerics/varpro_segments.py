"""Separable least squares over a record of several segments, each with linear columns of its own.

Every candidate has common columns (the response of the process, linear effects), whose sizes hold for all segments.
Its local columns (the remainder of each segment's unknown start) have sizes of their own in each segment. So have
the level and drift that all candidates share. Sums are formed on each segment's own rows, local columns are eliminated
there, and the rest is added up. The work is that of one segment of the same length, whatever the number of segments.

Source: block elimination of the normal equations of numerics/varpro.py; Shang et al., Eq. 16 to 19.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import FloatArray
from .cross_products import products
from .jit import kernel
from .varpro import DEPENDENT, REJECTED, Shared, enforce_sign


@dataclass(frozen=True, slots=True)
class Blockwise:
    """Least squares of each segment, with their first rows (`firsts`); the first `common` own columns have one size."""

    blocks: tuple[Shared, ...]
    common: int

    @property
    def firsts(self) -> tuple[int, ...]:
        """First row of each segment."""
        return tuple(np.cumsum([0, *(b.target.size for b in self.blocks[:-1])]).tolist())

    @property
    def sign(self) -> float:
        """Sign of the first own column's coefficient in most segments that know it; 0 where none does."""
        return float(np.sign(sum(b.sign for b in self.blocks)))

    @property
    def target_energy(self) -> float:
        """Sum of squares of the target."""
        return float(sum(b.target_energy for b in self.blocks))

    @property
    def rows(self) -> int:
        """Number of rows that count."""
        return sum(b.rows for b in self.blocks)

    @property
    def freedom(self) -> int:
        """Number of shared columns of all segments together."""
        return sum(b.freedom for b in self.blocks)

    @property
    def basis(self) -> FloatArray:
        """Shared columns (n, q), orthonormal, each zero outside its segment."""
        return block_columns([b.basis for b in self.blocks])

    def costs(self, base: FloatArray, offsets: tuple[int, ...] = (0,)) -> FloatArray:
        """Sum of squared residuals (P,) of each candidate; `inf` where a candidate's columns never move."""
        return self.solve(base, offsets)[0]

    def solve(self, base: FloatArray, offsets: tuple[int, ...] = (0,)) -> tuple[FloatArray, FloatArray]:
        """Sum of squared residuals (P,) and own coefficients (segments, own, P); common ones stand in each segment.

        `base` is (rows, P): column i of candidate p is base[offsets[i] : offsets[i] + n, p], for all segments.
        """
        own, lanes, count = len(offsets), base.shape[1], len(self.blocks)
        squares = np.empty((count, own, own, lanes))
        cross = np.empty((count, own, lanes))
        raw = np.empty((count, own, lanes))
        for i, (block, first) in enumerate(zip(self.blocks, self.firsts, strict=True)):
            among, part = products(base, tuple(o + first for o in offsets), block.right, *block.runs)
            raw[i] = np.einsum("iip->ip", among)
            shared = part[:, :block.freedom]
            squares[i] = among - np.einsum("icp,jcp->ijp", shared, shared)
            cross[i] = part[:, block.freedom]
        cost, sizes = np.empty(lanes), np.zeros((count, own, lanes))
        _solve(squares, cross, raw, self.common, self.target_energy, cost, sizes)
        enforce_sign(cost, sizes, sizes[0, 0], self.sign, self.target_energy)
        return cost, sizes

    def residuals(self, base: FloatArray, offsets: tuple[int, ...] = (0,), *, lent: bool = False) -> FloatArray:
        """Residuals (n, P) of each candidate after the fit of `solve`, 0 where a row does not count; never lent."""
        cost, sizes = self.solve(base, offsets)
        parts = []
        for i, (block, first) in enumerate(zip(self.blocks, self.firsts, strict=True)):
            n = block.target.size
            out = np.repeat(block.target[:, None], base.shape[1], axis=1)
            for o, size in zip(offsets, sizes[i], strict=True):
                out -= base[o + first:o + first + n] * size
            out *= block.weight[:, None]
            out -= block.basis @ (block.basis.T @ out)
            parts.append(out)
        whole = np.concatenate(parts)
        whole[:, ~np.isfinite(cost)] = REJECTED
        return whole


def block_columns(parts: list[FloatArray]) -> FloatArray:
    """Columns (n_i, q_i) of segments as columns (n, q) of the whole, each zero outside its segment.

    The first columns of all segments come first, then the second ones.
    """
    rows = np.cumsum([0, *(len(p) for p in parts)])
    columns = []
    for j in range(max(p.shape[1] for p in parts)):
        for i, part in enumerate(parts):
            if j < part.shape[1]:
                column = np.zeros(rows[-1])
                column[rows[i]:rows[i + 1]] = part[:, j]
                columns.append(column)
    return np.stack(columns, axis=1) if columns else np.empty((int(rows[-1]), 0))


@kernel
def _solve(squares: FloatArray, cross: FloatArray, raw: FloatArray, common: int, energy: float, cost: FloatArray,
           sizes: FloatArray) -> None:
    """Normal equations of every candidate: each segment's local columns by elimination, then the common ones.

    A column that depends on the others (a transient that has decayed, say) gets no coefficient. `squares` is
    overwritten.
    """
    count, own, lanes = cross.shape
    a = np.empty((count, own, own))
    b = np.empty((count, own))
    A = np.empty((common, common))
    B = np.empty(common)
    R = np.empty(common)
    x = np.empty(common)
    for p in range(lanes):
        gain = 0.0
        A[:] = 0.0
        B[:] = 0.0
        R[:] = 0.0
        moving = 0.0
        for s in range(count):
            for i in range(own):
                b[s, i] = cross[s, i, p]
                for j in range(own):
                    a[s, i, j] = squares[s, i, j, p]
            moving += a[s, 0, 0]
            for i in range(common, own):
                if not a[s, i, i] > DEPENDENT * raw[s, i, p]:
                    a[s, i, i] = 0.0
                    continue
                for j in range(own):
                    if j >= common and j <= i:
                        continue
                    factor = a[s, j, i] / a[s, i, i]
                    for c in range(own):
                        if c < common or c >= i:
                            a[s, j, c] -= factor * a[s, i, c]
                    b[s, j] -= factor * b[s, i]
                gain += b[s, i] * b[s, i] / a[s, i, i]
            for i in range(common):
                R[i] += raw[s, i, p]
                B[i] += b[s, i]
                for j in range(common):
                    A[i, j] += a[s, i, j]
        moved = moving > DEPENDENT * R[0]
        for i in range(common):
            if not A[i, i] > DEPENDENT * R[i]:
                A[i, i] = 0.0
                continue
            for j in range(i + 1, common):
                factor = A[j, i] / A[i, i]
                for c in range(i, common):
                    A[j, c] -= factor * A[i, c]
                B[j] -= factor * B[i]
            gain += B[i] * B[i] / A[i, i]
        for i in range(common - 1, -1, -1):
            x[i] = 0.0
            if A[i, i] > 0.0:
                total = B[i]
                for j in range(i + 1, common):
                    total -= A[i, j] * x[j]
                x[i] = total / A[i, i]
        for s in range(count):
            for i in range(common):
                sizes[s, i, p] = x[i]
            for i in range(own - 1, common - 1, -1):
                sizes[s, i, p] = 0.0
                if a[s, i, i] > 0.0:
                    total = b[s, i]
                    for j in range(common):
                        total -= a[s, i, j] * x[j]
                    for j in range(i + 1, own):
                        total -= a[s, i, j] * sizes[s, j, p]
                    sizes[s, i, p] = total / a[s, i, i]
        value = max(energy - gain, 0.0)
        cost[p] = value if moved and np.isfinite(value) else np.inf
