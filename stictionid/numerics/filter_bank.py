"""Fast cost of a valve position without a process model: y is fitted by a bank of fixed first-order lags and delays.

Every path of the valve position goes through the same lags. They are fitted to y together with a level and the decay
of an unknown start, once for each delay; the best delay counts. Two parts of the work are shared by all candidates.
Products with y are products of the path with y filtered backwards by the lags. The sums of squares of one delay follow
from those of the delay before, by the rows that enter and leave the window.

Wrong where a process is much faster than the shortest lag, or its dead time exceeds the longest delay.
Source: normal equations as in numerics/varpro.py; adjoint of a filter: Claerbout 1992, chapter 5.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..typing import BoolArray, FloatArray, IntArray
from .jit import LANES, LINE, kernel
from .varpro import Shared


class LagBank:
    """Bank of lags and delays for one y (n,) over the rows (n,) of `count`; lags and decay in s, delays in samples.

    The shortest lag comes last. No row up to the longest delay may count, and delays ascend.
    """

    def __init__(self, y: FloatArray, count: BoolArray, lags_s: Sequence[float], decay_s: float,
                 delays: Sequence[int], *, step_s: float, parts: int) -> None:
        n = y.size
        decay = np.exp(-np.arange(n) * step_s / decay_s)
        self.shared = Shared.prepare(y, np.stack([np.ones(n), decay], axis=1), count)
        self.delays = np.asarray(delays, np.int64)
        self._parts = parts
        self._decays = np.exp(-step_s / (parts * np.asarray(lags_s)))
        self._decay = decay
        w = count.astype(np.int8)
        # Rows of a path that count for the first delay, and the changes from each delay to the next.
        moved = np.array([np.append(w[d:], np.zeros(d, np.int8)) for d in delays])
        self._enters = np.concatenate([moved[:1], np.diff(moved, axis=0)])
        edges = np.abs(self._enters[1:]).sum(axis=0) > 0
        self._edges = edges
        # Orthonormal columns of `shared`, written in level and decay of a path's own rows (later by the delay).
        mix = np.linalg.lstsq(np.stack([np.ones(n), decay], axis=1)[count], self.shared.basis[count], rcond=None)[0]
        later = np.exp(-self.delays * step_s / decay_s)
        self._mix = np.stack([np.ones((self.delays.size, 1)) * mix[0], later[:, None] * mix[1]], axis=1)
        self._adjoint, self._first = _backwards(self.shared.target, self.delays, self._decays, parts)

    def costs(self, position: FloatArray) -> FloatArray:
        """Sum of squared errors (P,) of paths (n*parts, P), each with its best delay; inf for a constant path."""
        lanes, many, lags, q = position.shape[1], self.delays.size, self._decays.size, self.shared.freedom
        # Products of the lags with each other, with a constant, and with a decay.
        sums = np.empty((many, lags * (lags + 1) // 2 + 2 * lags, lanes))
        _sums(position, self._parts, self._decays, self._enters, self._edges, self._decay, sums)
        squares: FloatArray = np.empty((lags, lags, many, lanes))
        cross = np.empty((lags, q + 1, many, lanes))
        shown = (self._adjoint @ position).reshape(lags, many, lanes)
        _normals(sums, self._mix, shown, self._first, position[0], squares, cross)
        squares = squares.reshape(lags, lags, -1)
        cost = self.shared.solved(squares, cross.reshape(lags, q + 1, -1))[0]
        return np.asarray(cost.reshape(many, lanes).min(axis=0))


def _backwards(y: FloatArray, delays: IntArray, decays: FloatArray, parts: int) -> tuple[FloatArray, FloatArray]:
    """Rows (lags*delays, n*parts) whose products with a path are those of y (n,) with the path's lags, and their sums.

    `y` is 0 in rows that do not count.
    """
    n = y.size
    out = np.empty((decays.size, delays.size, n, parts))
    _filter_backwards(y, delays, decays, out)
    rows = out.reshape(decays.size * delays.size, n * parts)
    return rows, rows.sum(axis=1).reshape(decays.size, delays.size)


@kernel
def _filter_backwards(y: FloatArray, delays: IntArray, decays: FloatArray, out: FloatArray) -> None:
    n, parts = out.shape[2:]
    for i in range(decays.size):
        a = decays[i]
        for t in range(delays.size):
            total = 0.0
            # The last part of the record affects no measured sample.
            for s in range(parts):
                out[i, t, n - 1, s] = 0.0
            for k in range(n - 1, 0, -1):
                row = k + delays[t]
                total = a**parts * total + (y[row] if row < n else 0.0)
                for s in range(parts):
                    out[i, t, k - 1, s] = (1.0 - a) * a ** (parts - 1 - s) * total


@kernel
def _sums(position: FloatArray, parts: int, decays: FloatArray, enters: IntArray, edges: BoolArray, decay: FloatArray,
          sums: FloatArray) -> None:
    """Fill sums (delays, sums, P): those of the first delay, then the increment of each further delay."""
    samples, lanes, lags = edges.size, position.shape[1], decays.size
    many, formed = sums.shape[:2]
    pairs = formed - 2 * lags
    # States of the lags, first positions, and the sums of the first delay, each for all lanes.
    work = np.empty((lags + 1 + formed) * LANES + LINE)
    work = work[-(work.ctypes.data // 8) % LINE:]
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        last = first + width
        work[:] = 0.0
        sums[:, :, first:last] = 0.0
        start = work[lags * LANES:lags * LANES + width]
        own = work[(lags + 1) * LANES:]
        for p in range(width):
            start[p] = position[0, first + p]
        for k in range(1, samples):
            for s in range(parts):
                row = position[(k - 1) * parts + s, first:last]
                for i in range(lags):
                    a, state = decays[i], work[i * LANES:i * LANES + width]
                    for p in range(width):
                        u = row[p] - start[p]
                        state[p] = a * (state[p] - u) + u
            e = decay[k]
            if enters[0, k]:
                at = 0
                for i in range(lags):
                    one = work[i * LANES:i * LANES + width]
                    for j in range(i + 1):
                        two, sink = work[j * LANES:j * LANES + width], own[at * LANES:at * LANES + width]
                        for p in range(width):
                            sink[p] += one[p] * two[p]
                        at += 1
                    level = own[(pairs + i) * LANES:(pairs + i) * LANES + width]
                    decayed = own[(pairs + lags + i) * LANES:(pairs + lags + i) * LANES + width]
                    for p in range(width):
                        level[p] += one[p]
                        decayed[p] += one[p] * e
            if edges[k]:
                for t in range(1, many):
                    if enters[t, k]:
                        sign = float(enters[t, k])
                        at = 0
                        for i in range(lags):
                            one = work[i * LANES:i * LANES + width]
                            for j in range(i + 1):
                                two, sink = work[j * LANES:j * LANES + width], sums[t, at, first:last]
                                for p in range(width):
                                    sink[p] += sign * (one[p] * two[p])
                                at += 1
                            level, decayed = sums[t, pairs + i, first:last], sums[t, pairs + lags + i, first:last]
                            for p in range(width):
                                level[p] += sign * one[p]
                                decayed[p] += sign * e * one[p]
        for x in range(formed):
            for p in range(width):
                sums[0, x, first + p] = own[x * LANES + p]


@kernel
def _normals(sums: FloatArray, mix: FloatArray, shown: FloatArray, first: FloatArray, start: FloatArray,
             squares: FloatArray, cross: FloatArray) -> None:
    """Normal equations of every delay and lane; `sums` holds increments on entry and every delay's sums on exit."""
    many, formed, lanes = sums.shape
    lags, q = first.shape[0], mix.shape[2]
    pairs = formed - 2 * lags
    for t in range(many):
        if t:
            for x in range(formed):
                for p in range(lanes):
                    sums[t, x, p] += sums[t - 1, x, p]
        at = 0
        for i in range(lags):
            for j in range(i + 1):
                for p in range(lanes):
                    squares[i, j, t, p] = sums[t, at, p]
                    squares[j, i, t, p] = sums[t, at, p]
                at += 1
            for c in range(q):
                one, two = mix[t, 0, c], mix[t, 1, c]
                for p in range(lanes):
                    cross[i, c, t, p] = one * sums[t, pairs + i, p] + two * sums[t, pairs + lags + i, p]
            offset = first[i, t]
            for p in range(lanes):
                cross[i, q, t, p] = shown[i, t, p] - offset * start[p]
