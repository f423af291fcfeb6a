"""Sums of products for the normal equations of many candidates, formed in lockstep with candidates as the fast axis.

`products` serves any own columns. `lagged_products` serves an ARX model, whose columns are one signal at neighbouring
lags against y at neighbouring lags. Sums that differ by a shift only are formed once, over one window. They are moved
to the next lag by the few rows that enter and leave the window. Both functions take four rows a pass: a pass loads and
stores each sum once, and all sums share the loaded values.

Source: normal equations of Shang et al., Eq. 17; the shift structure is that of covariance-type linear prediction
(Morf, Dickinson, Kailath and Vieira 1977).
"""

from __future__ import annotations

import numpy as np

from ..typing import FloatArray, IntArray
from .jit import LANES, LINE, kernel

# Number of sums of the pass that forms most of them.
_SUMS = 7


@kernel
def _of_pair(base: FloatArray, i: int, j: int, right: FloatArray, c: int, starts: IntArray, stops: IntArray, first: int,
             width: int, work: FloatArray) -> None:
    """Squares and product of columns at rows i.. and j.., and their products with columns c, c+1 of `right`."""
    work[:_SUMS * LANES] = 0.0
    last = first + width
    for run in range(starts.size):
        k = starts[run]
        while k + 4 <= stops[run]:
            a0 = base[i + k, first:last]
            a1 = base[i + k + 1, first:last]
            a2 = base[i + k + 2, first:last]
            a3 = base[i + k + 3, first:last]
            b0 = base[j + k, first:last]
            b1 = base[j + k + 1, first:last]
            b2 = base[j + k + 2, first:last]
            b3 = base[j + k + 3, first:last]
            r0, r1, r2, r3 = right[k, c], right[k + 1, c], right[k + 2, c], right[k + 3, c]
            s0, s1, s2, s3 = right[k, c + 1], right[k + 1, c + 1], right[k + 2, c + 1], right[k + 3, c + 1]
            for p in range(width):
                v0, v1, v2, v3 = a0[p], a1[p], a2[p], a3[p]
                w0, w1, w2, w3 = b0[p], b1[p], b2[p], b3[p]
                work[p] += (v0 * v0 + v1 * v1) + (v2 * v2 + v3 * v3)
                work[LANES + p] += (v0 * w0 + v1 * w1) + (v2 * w2 + v3 * w3)
                work[2 * LANES + p] += (w0 * w0 + w1 * w1) + (w2 * w2 + w3 * w3)
                work[3 * LANES + p] += (v0 * r0 + v1 * r1) + (v2 * r2 + v3 * r3)
                work[4 * LANES + p] += (v0 * s0 + v1 * s1) + (v2 * s2 + v3 * s3)
                work[5 * LANES + p] += (w0 * r0 + w1 * r1) + (w2 * r2 + w3 * r3)
                work[6 * LANES + p] += (w0 * s0 + w1 * s1) + (w2 * s2 + w3 * s3)
            k += 4
        while k < stops[run]:
            a0 = base[i + k, first:last]
            b0 = base[j + k, first:last]
            r0, s0 = right[k, c], right[k, c + 1]
            for p in range(width):
                v0, w0 = a0[p], b0[p]
                work[p] += v0 * v0
                work[LANES + p] += v0 * w0
                work[2 * LANES + p] += w0 * w0
                work[3 * LANES + p] += v0 * r0
                work[4 * LANES + p] += v0 * s0
                work[5 * LANES + p] += w0 * r0
                work[6 * LANES + p] += w0 * s0
            k += 1


@kernel
def _of_one(base: FloatArray, h: int, i: int, j: int, right: FloatArray, c: int, starts: IntArray, stops: IntArray,
            first: int, width: int, work: FloatArray) -> None:
    """Square of the column at rows h.., its products with those at i.. and j.., and with columns c, c+1 of `right`."""
    work[:5 * LANES] = 0.0
    last = first + width
    for run in range(starts.size):
        k = starts[run]
        while k + 4 <= stops[run]:
            a0 = base[h + k, first:last]
            a1 = base[h + k + 1, first:last]
            a2 = base[h + k + 2, first:last]
            a3 = base[h + k + 3, first:last]
            b0 = base[i + k, first:last]
            b1 = base[i + k + 1, first:last]
            b2 = base[i + k + 2, first:last]
            b3 = base[i + k + 3, first:last]
            d0 = base[j + k, first:last]
            d1 = base[j + k + 1, first:last]
            d2 = base[j + k + 2, first:last]
            d3 = base[j + k + 3, first:last]
            r0, r1, r2, r3 = right[k, c], right[k + 1, c], right[k + 2, c], right[k + 3, c]
            s0, s1, s2, s3 = right[k, c + 1], right[k + 1, c + 1], right[k + 2, c + 1], right[k + 3, c + 1]
            for p in range(width):
                v0, v1, v2, v3 = a0[p], a1[p], a2[p], a3[p]
                work[p] += (v0 * v0 + v1 * v1) + (v2 * v2 + v3 * v3)
                work[LANES + p] += (v0 * b0[p] + v1 * b1[p]) + (v2 * b2[p] + v3 * b3[p])
                work[2 * LANES + p] += (v0 * d0[p] + v1 * d1[p]) + (v2 * d2[p] + v3 * d3[p])
                work[3 * LANES + p] += (v0 * r0 + v1 * r1) + (v2 * r2 + v3 * r3)
                work[4 * LANES + p] += (v0 * s0 + v1 * s1) + (v2 * s2 + v3 * s3)
            k += 4
        while k < stops[run]:
            a0 = base[h + k, first:last]
            b0 = base[i + k, first:last]
            d0 = base[j + k, first:last]
            r0, s0 = right[k, c], right[k, c + 1]
            for p in range(width):
                v0 = a0[p]
                work[p] += v0 * v0
                work[LANES + p] += v0 * b0[p]
                work[2 * LANES + p] += v0 * d0[p]
                work[3 * LANES + p] += v0 * r0
                work[4 * LANES + p] += v0 * s0
            k += 1


@kernel
def products_kernel(base: FloatArray, offsets: IntArray, right: FloatArray, starts: IntArray, stops: IntArray,
                    squares: FloatArray, cross: FloatArray) -> None:
    own = offsets.size
    count = right.shape[1]
    lanes = base.shape[1]
    work = np.empty(_SUMS * LANES + LINE)
    work = work[-(work.ctypes.data // 8) % LINE:]
    none = own - own  # 0 of the type of `own`: a literal would have another type and compile a second version
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        for i in range(0, own, 2):
            j = i + 1
            for c in range(0, count, 2):
                if j < own:
                    _of_pair(base, offsets[i], offsets[j], right, c, starts, stops, first, width, work)
                    for p in range(width):
                        squares[i, i, first + p] = work[p]
                        squares[i, j, first + p] = work[LANES + p]
                        squares[j, j, first + p] = work[2 * LANES + p]
                        cross[i, c, first + p] = work[3 * LANES + p]
                        cross[i, c + 1, first + p] = work[4 * LANES + p]
                        cross[j, c, first + p] = work[5 * LANES + p]
                        cross[j, c + 1, first + p] = work[6 * LANES + p]
                else:
                    one = min(1, own - 1)
                    _of_one(base, offsets[i], offsets[0], offsets[one], right, c, starts, stops, first, width, work)
                    for p in range(width):
                        squares[i, i, first + p] = work[p]
                        if i > 0:
                            squares[0, i, first + p] = work[LANES + p]
                            squares[1, i, first + p] = work[2 * LANES + p]
                        cross[i, c, first + p] = work[3 * LANES + p]
                        cross[i, c + 1, first + p] = work[4 * LANES + p]
            # Products of columns of different pairs; a single last column already has those with the first pair.
            for h in range(i, min(i + 2, own)):
                for g in range(0 if j < own else 2, i, 2):
                    _of_one(base, offsets[h], offsets[g], offsets[g + 1], right, none, starts, stops, first, width,
                            work)
                    for p in range(width):
                        squares[g, h, first + p] = work[LANES + p]
                        squares[g + 1, h, first + p] = work[2 * LANES + p]
    for i in range(own):
        for j in range(i):
            for p in range(lanes):
                squares[i, j, p] = squares[j, i, p]


def products(base: FloatArray, offsets: tuple[int, ...], right: FloatArray, starts: IntArray,
             stops: IntArray) -> tuple[FloatArray, FloatArray]:
    """Products (own, own, P) among own columns and (own, c, P) with the columns `right` (n, c), c even.

    Column i of candidate p is base[offsets[i] + row, p], so lagged copies and stacked signals need no copying.
    Rows starts[r] to stops[r] - 1 of every run r count.
    """
    own, lanes = len(offsets), base.shape[1]
    squares, cross = np.empty((own, own, lanes)), np.empty((own, right.shape[1], lanes))
    products_kernel(base, np.asarray(offsets, np.int64), right, starts, stops, squares, cross)
    return squares, cross


# Rows of the table of lagged sums: v^2, v v(-1), v, then v against y at four neighbouring lags.
_LAGS = 4


@kernel
def _lagged(base: FloatArray, level: float, y: FloatArray, start: int, stop: int, delays: IntArray,
            table: FloatArray) -> None:
    """Fill table (delays, 7, P) with sums over the window of every delay; see `lagged_products`."""
    lanes = base.shape[1]
    work = np.empty(_SUMS * LANES + LINE)
    work = work[-(work.ctypes.data // 8) % LINE:]
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        last = first + width
        work[:3 * LANES] = 0.0
        for t in range(delays.size):
            begin = start - delays[t] - 1
            end = stop - delays[t] - 1
            if t == 0:
                for k in range(begin, end):
                    a0 = base[k, first:last]
                    a1 = base[k - 1, first:last]
                    for p in range(width):
                        v0 = a0[p] - level
                        work[p] += v0 * v0
                        work[LANES + p] += v0 * (a1[p] - level)
                        work[2 * LANES + p] += v0
            else:
                # From one delay to a longer one the window moves back: rows enter before it and leave at its end.
                moved = delays[t] - delays[t - 1]
                for k in range(moved):
                    a0 = base[begin + k, first:last]
                    a1 = base[begin + k - 1, first:last]
                    b0 = base[end + k, first:last]
                    b1 = base[end + k - 1, first:last]
                    for p in range(width):
                        v0 = a0[p] - level
                        w0 = b0[p] - level
                        work[p] += v0 * v0 - w0 * w0
                        work[LANES + p] += v0 * (a1[p] - level) - w0 * (b1[p] - level)
                        work[2 * LANES + p] += v0 - w0
            work[3 * LANES:] = 0.0
            far = delays[t] - 1
            k = begin
            while k + 4 <= end:
                a0 = base[k, first:last]
                a1 = base[k + 1, first:last]
                a2 = base[k + 2, first:last]
                a3 = base[k + 3, first:last]
                at = k + far
                y0, y1, y2, y3 = y[at], y[at + 1], y[at + 2], y[at + 3]
                y4, y5, y6 = y[at + 4], y[at + 5], y[at + 6]
                for p in range(width):
                    v0, v1, v2, v3 = a0[p] - level, a1[p] - level, a2[p] - level, a3[p] - level
                    work[3 * LANES + p] += (v0 * y0 + v1 * y1) + (v2 * y2 + v3 * y3)
                    work[4 * LANES + p] += (v0 * y1 + v1 * y2) + (v2 * y3 + v3 * y4)
                    work[5 * LANES + p] += (v0 * y2 + v1 * y3) + (v2 * y4 + v3 * y5)
                    work[6 * LANES + p] += (v0 * y3 + v1 * y4) + (v2 * y5 + v3 * y6)
                k += 4
            while k < end:
                a0 = base[k, first:last]
                at = k + far
                for x in range(_LAGS):
                    y0 = y[at + x]
                    for p in range(width):
                        work[(3 + x) * LANES + p] += (a0[p] - level) * y0
                k += 1
            for x in range(_SUMS):
                for p in range(width):
                    table[t, x, first + p] = work[x * LANES + p]


@kernel
def _unshifted(base: FloatArray, level: float, y: FloatArray, mix: FloatArray, start: int, stop: int, delays: IntArray,
               table: FloatArray, squares: FloatArray, cross: FloatArray) -> None:
    """Normal equations of every delay from the table of `_lagged`: the second column is the first one row earlier."""
    lanes = base.shape[1]
    count = mix.shape[1]
    for t in range(delays.size):
        before = start - delays[t] - 2
        final = stop - delays[t] - 2
        y_before = before + delays[t] + 2
        y_final = final + delays[t] + 2
        sums = table[t]
        for p in range(lanes):
            enters, leaves = base[before, p] - level, base[final, p] - level
            squares[t, 0, 0, p] = sums[0, p]
            squares[t, 0, 1, p] = squares[t, 1, 0, p] = sums[1, p]
            squares[t, 1, 1, p] = sums[0, p] + enters * enters - leaves * leaves
        for c in range(count):
            for p in range(lanes):
                enters, leaves = base[before, p] - level, base[final, p] - level
                one = mix[3, c] * sums[2, p]
                two = mix[3, c] * (sums[2, p] + enters - leaves)
                for j in range(3):
                    one += mix[j, c] * sums[5 - j, p]
                    two += mix[j, c] * (sums[6 - j, p] + enters * y[y_before - j] - leaves * y[y_final - j])
                cross[t, 0, c, p] = one
                cross[t, 1, c, p] = two


def lagged_products(base: FloatArray, level: float, y: FloatArray, mix: FloatArray, rows: tuple[int, int],
                    delays: IntArray) -> tuple[FloatArray, FloatArray]:
    """Products (D, 2, 2, P) and (D, 2, c, P) of an ARX model of order 2 for each of `delays` (D,), ascending.

    Own columns at row k are v(k-d-1) and v(k-d-2) with v = base - level; right columns are `mix` (4, c) of y(k),
    y(k-1), y(k-2) and 1. All of `rows` (start, stop) count, and start exceeds the longest delay by 3 at least. `y`
    (n + 1,) ends with one 0, which is multiplied but never counts.
    """
    lanes, many = base.shape[1], delays.size
    table = np.empty((many, _SUMS, lanes))
    _lagged(base, level, y, rows[0], rows[1], delays, table)
    squares, cross = np.empty((many, 2, 2, lanes)), np.empty((many, 2, mix.shape[1], lanes))
    _unshifted(base, level, y, mix, rows[0], rows[1], delays, table, squares, cross)
    return squares, cross
