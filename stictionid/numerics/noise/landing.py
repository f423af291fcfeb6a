"""Filter of PV for a stem that lands a little beside its place: an error of the valve that stays until it moves again.

A stem lands where the command that it sees, less the kinetic friction, puts it. Where the record knows that command to
an error only, the model stands beside the stem until the next move, and the process passes the difference on to PV.
Beside white noise of variance 1 on PV the state (x, w) of the difference obeys, from one value of the command to the
next, x' = A x + B w, and w' = carried w + N(0, drawn) where the stem moves. The Kalman filter of that state turns
errors of PV into innovations of variance 1.

A slip that comes earlier than the record shows passes on a pulse: its step, for as long as it is early.

A stem that slides has nothing of its error before, and one that slips has some: the force at which it broke away lies
beside f_s by the errors at both ends of the slip. Wrong for errors of the command that hang together longer than that.
Source: docs/details.md, section 14; Harvey 1989, 3.2 (the filter), 3.4 (the likelihood by its innovations).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...typing import BoolArray, FloatArray
from ..jit import kernel


@kernel
def _means(carried: FloatArray, force: FloatArray, out: FloatArray) -> None:
    """Fill the expected error (commands,) of a stem whose slips have a `force` (commands,) beside f_s, 0 elsewhere."""
    w = 0.0
    for i in range(out.size):
        w = carried[i] * (w - force[i])
        out[i] = w


def expected(carried: FloatArray, force: FloatArray) -> FloatArray:
    """Expected error (commands,) of a stem, in the unit of `force` (commands,), which is by how much slips lie off f_s.

    A slip at less than f_s, as the record has it, began from a command or a place that was further on.
    """
    out = np.empty(carried.size)
    _means(carried, force, out)
    return out


@kernel
def _gains(keep: FloatArray, take: FloatArray, row: FloatArray, through: float, late: int, parts: int,
           carried: FloatArray, still: BoolArray, rest: FloatArray, drawn: FloatArray, early: FloatArray,
           good: BoolArray, spread: FloatArray, gain: FloatArray) -> None:
    """Fill F (n,), the variance of PV, and the gains (n, m + 1) of the rows that are good, which correct the state.

    Before a row that is `still` (n,) the stem rests, and one product with `rest` (m + 1, m + 1) leads from the row
    before.
    """
    n, m = spread.size, row.size
    d = m + 1
    P, Q = np.zeros((d, d)), np.zeros((d, d))
    A, pulse = np.zeros((3, d, d)), take[1].copy()
    for r in range(m):
        for c in range(m):
            pulse[r] += keep[1, r, c] * take[0, c]
            A[0, r, c], A[1, r, c] = keep[0, r, c], keep[1, r, c]
        A[0, r, m], A[1, r, m] = take[0, r], take[1, r]
    for r in range(d):
        A[0, m, r] = A[1, m, r] = 1.0 if r == m else 0.0
        for c in range(d):
            A[2, r, c] = rest[r, c]
    A[2, m, m] = 1.0
    H, PH = np.empty(d), np.empty(d)
    for r in range(d):
        H[r] = row[r] if r < m else through
    for k in range(n):
        for part in range(1 if still[k] else parts if k > 0 else 0):
            i = (k - 1) * parts + part - late
            if i < 0 and not still[k]:
                continue
            for half in range(2 if still[k] else 0, 3 if still[k] else 2):
                for r in range(d):
                    for c in range(d):
                        value = 0.0
                        for j in range(d):
                            value += A[half, r, j] * P[j, c]
                        Q[r, c] = value
                for r in range(d):
                    for c in range(d):
                        value = 0.0
                        for j in range(d):
                            value += Q[r, j] * A[half, c, j]
                        P[r, c] = value
                if half == 0:
                    for r in range(d):
                        P[r, m] *= carried[i]
                        P[m, r] *= carried[i]
                    P[m, m] += drawn[i]
                    for r in range(m if early[i] > 0.0 else 0):
                        for c in range(m):
                            P[r, c] += early[i] * pulse[r] * pulse[c]
        F = 1.0
        for r in range(d):
            PH[r] = 0.0
            for c in range(d):
                PH[r] += P[r, c] * H[c]
            F += H[r] * PH[r]
        spread[k] = F
        if good[k]:
            for r in range(d):
                gain[k, r] = PH[r] / F
            for r in range(d):
                for c in range(d):
                    P[r, c] -= PH[r] * PH[c] / F


@kernel
def _apply(base: FloatArray, samples: int, keep: FloatArray, take: FloatArray, row: FloatArray, through: float,
           late: int, parts: int, carried: FloatArray, still: BoolArray, rest: FloatArray, inverse: FloatArray,
           gain: FloatArray) -> None:
    """Scaled innovations of each stretch of `samples` rows in place; 0 where a row does not count."""
    m, lanes = row.size, base.shape[1]
    # Most models have one lag or two. Two states, of which one may stay 0, take one pass over the lanes.
    few, states = m <= 2, max(m, 2)
    x, after = np.empty((states + 1, lanes)), np.empty((states, lanes))
    # Steps of the process from a row to the next: the halves of a part, or the whole way of a stem that rests.
    A, B, H = np.zeros((3, states, states)), np.zeros((3, states)), np.zeros(states)
    for r in range(m):
        B[0, r], B[1, r], B[2, r], H[r] = take[0, r], take[1, r], rest[r, m], row[r]
        for c in range(m):
            A[0, r, c], A[1, r, c], A[2, r, c] = keep[0, r, c], keep[1, r, c], rest[r, c]
    one, two, stem = x[0], x[1], x[states]
    for first in range(0, base.shape[0], samples):
        x[:] = 0.0
        for k in range(samples):
            for step in range(1 if still[k] else 2 * parts if k > 0 else 0):
                i, half = (k - 1) * parts + step // 2 - late, 2 if still[k] else step % 2
                if half < 2 and i < 0:
                    continue
                left = carried[i] if half == 0 else 1.0
                if few:
                    a, b, c, d = A[half, 0, 0], A[half, 0, 1], A[half, 1, 0], A[half, 1, 1]
                    e, f = B[half, 0], B[half, 1]
                    for p in range(lanes):
                        y, z, w = one[p], two[p], stem[p]
                        one[p] = (e * w + a * y) + b * z
                        two[p] = (f * w + c * y) + d * z
                        stem[p] = w * left
                    continue
                for r in range(m):
                    b = B[half, r]
                    for p in range(lanes):
                        after[r, p] = b * stem[p]
                    for c in range(m):
                        a = A[half, r, c]
                        for p in range(lanes):
                            after[r, p] += a * x[c, p]
                for r in range(m):
                    for p in range(lanes):
                        x[r, p] = after[r, p]
                for p in range(lanes):
                    stem[p] *= left
            sink, s = base[first + k], inverse[k]
            if s == 0.0:
                for p in range(lanes):
                    sink[p] = 0.0
                continue
            if few:
                a, b, e, f, g = H[0], H[1], gain[k, 0], gain[k, 1] if m > 1 else 0.0, gain[k, m]
                for p in range(lanes):
                    y, z, w = one[p], two[p], stem[p]
                    left = ((sink[p] - through * w) - a * y) - b * z
                    one[p], two[p], stem[p] = y + e * left, z + f * left, w + g * left
                    sink[p] = left * s
                continue
            for p in range(lanes):
                sink[p] -= through * stem[p]
            for r in range(m):
                for p in range(lanes):
                    sink[p] -= H[r] * x[r, p]
            for r in range(m + 1):
                g = gain[k, r]
                for p in range(lanes):
                    x[r, p] += g * sink[p]
            for p in range(lanes):
                sink[p] *= s


def _resting(keep: FloatArray, take: FloatArray, late: int, parts: int, rests: BoolArray,
             n: int) -> tuple[BoolArray, FloatArray]:
    """Rows (n,) before which a stem that `rests` (commands,) moves nowhere, and the matrix of all parts before one."""
    m = keep.shape[1]
    halves = np.zeros((2, m + 1, m + 1))
    halves[:, :m, :m], halves[:, :m, m], halves[:, m, m] = keep, take, 1.0
    moved = np.concatenate([[0], np.cumsum(~rests)])
    first = np.arange(-1, n - 1) * parts - late
    still = (first >= 0) & (moved[np.clip(first + parts, 0, rests.size)] == moved[np.clip(first, 0, rests.size)])
    return still, np.linalg.matrix_power(halves[1] @ halves[0], parts)


class LandingFilter:
    """The filter of one segment for errors that are `carried` and `drawn` (commands,), on rows (n,) that are `good`.

    `keep` (2, m, m), `take` (2, m), `row` (m,), `through` and `late` are the process (`state_space.Held`); `parts` are
    commands in a sample. `drawn` is a variance of the stem's error times the gain over the white noise. `early`
    (commands,) is the same of a step of the stem that comes a whole command early. Immutable.
    """

    def __init__(self, keep: FloatArray, take: FloatArray, row: FloatArray, through: float, late: int, *, parts: int,
                 carried: FloatArray, drawn: FloatArray, early: FloatArray, good: BoolArray) -> None:
        still, rest = _resting(keep, take, late, parts, (carried == 1.0) & (drawn == 0.0), good.size)
        self._chain = keep, take, row, through, late, parts, carried, still, rest
        self._drawn = drawn, early
        spread, self._gain = self._spread(good)
        # (PV has its own noise, whatever rounding leaves of a stem's error that is a million times as large)
        self.inverse = np.where(good, 1.0 / np.sqrt(np.maximum(spread, 1.0)), 0.0)

    def _spread(self, good: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Variance (n,) of PV and gains (n, m + 1), with a state that PV corrects at the rows (n,) that are good."""
        spread, gain = np.empty(good.size), np.zeros((good.size, self._chain[2].size + 1))
        _gains(*self._chain, *self._drawn, good, spread, gain)
        return spread, gain

    @cached_property
    def alone(self) -> FloatArray:
        """Variance (n,) of the error itself, in which PV corrects nothing."""
        return self._spread(np.zeros(self.inverse.size, bool))[0]

    def apply_stack(self, base: FloatArray, samples: int) -> None:
        """Replace every column of a stack (k*samples, P) by its scaled innovations, in place; 0 where no row counts."""
        _apply(base, samples, *self._chain, self.inverse, self._gain)

    def applied(self, columns: FloatArray) -> FloatArray:
        """Scaled innovations (n, c) of columns (n, c)."""
        out = np.array(columns, dtype=np.float64, order="C")
        self.apply_stack(out, len(out))
        return out

    def log_scale(self, counted: BoolArray) -> float:
        """Sum of log F over the rows (n,) that are counted."""
        seen = self.inverse[counted & (self.inverse > 0.0)]
        return float(-2.0 * np.log(seen).sum())
