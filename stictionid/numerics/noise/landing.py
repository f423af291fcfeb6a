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
           good: BoolArray, inverse: FloatArray, gain: FloatArray, alone: FloatArray) -> None:
    """Fill 1/sqrt(F) (n,) and gains (n, m + 1) of the rows that are good, and the variance (n,) of PV `alone`.

    The latter is that of the error itself, in which PV corrects nothing. Before a row that is `still` (n,) the stem
    rests, and one product with `rest` (m + 1, m + 1) leads from the row before.
    """
    n, m = inverse.size, row.size
    d = m + 1
    # Two covariances at once: that of the filter, and that without any correction.
    P, Q = np.zeros((2, d, d)), np.zeros((2, d, d))
    A, pulse = np.zeros((d, d)), take[1].copy()
    for r in range(m):
        for c in range(m):
            pulse[r] += keep[1, r, c] * take[0, c]
    H, PH = np.empty(d), np.empty(d)
    for r in range(d):
        H[r] = row[r] if r < m else through
    for k in range(n):
        for part in range(1 if still[k] else parts if k > 0 else 0):
            i = (k - 1) * parts + part - late
            if i < 0 and not still[k]:
                continue
            for half in range(1 if still[k] else 2):
                for r in range(d):
                    for c in range(d):
                        A[r, c] = rest[r, c] if still[k] else keep[half, r, c] if r < m and c < m else 0.0
                    if r < m and not still[k]:
                        A[r, m] = take[half, r]
                A[m, m] = 1.0
                for b in range(2):
                    for r in range(d):
                        for c in range(d):
                            value = 0.0
                            for j in range(d):
                                value += A[r, j] * P[b, j, c]
                            Q[b, r, c] = value
                    for r in range(d):
                        for c in range(d):
                            value = 0.0
                            for j in range(d):
                                value += Q[b, r, j] * A[c, j]
                            P[b, r, c] = value
                    if half == 0 and not still[k]:
                        for r in range(d):
                            P[b, r, m] *= carried[i]
                            P[b, m, r] *= carried[i]
                        P[b, m, m] += drawn[i]
                        for r in range(m if early[i] > 0.0 else 0):
                            for c in range(m):
                                P[b, r, c] += early[i] * pulse[r] * pulse[c]
        for b in range(2):
            F = 1.0
            for r in range(d):
                PH[r] = 0.0
                for c in range(d):
                    PH[r] += P[b, r, c] * H[c]
                F += H[r] * PH[r]
            if b == 1:
                alone[k] = F
            elif good[k]:
                inverse[k] = 1.0 / np.sqrt(F)
                for r in range(d):
                    gain[k, r] = PH[r] / F
                for r in range(d):
                    for c in range(d):
                        P[b, r, c] -= PH[r] * PH[c] / F


@kernel
def _apply(base: FloatArray, samples: int, keep: FloatArray, take: FloatArray, row: FloatArray, through: float,
           late: int, parts: int, carried: FloatArray, still: BoolArray, rest: FloatArray, inverse: FloatArray,
           gain: FloatArray) -> None:
    """Scaled innovations of each stretch of `samples` rows in place; 0 where a row does not count."""
    m, lanes = row.size, base.shape[1]
    x, after = np.empty((m + 1, lanes)), np.empty((m, lanes))
    for first in range(0, base.shape[0], samples):
        x[:] = 0.0
        for k in range(samples):
            if still[k]:
                for r in range(m):
                    b = rest[r, m]
                    for p in range(lanes):
                        after[r, p] = b * x[m, p]
                    for c in range(m):
                        a = rest[r, c]
                        for p in range(lanes):
                            after[r, p] += a * x[c, p]
                for r in range(m):
                    for p in range(lanes):
                        x[r, p] = after[r, p]
            for part in range(0 if still[k] or k == 0 else parts):
                i = (k - 1) * parts + part - late
                if i < 0:
                    continue
                for half in range(2):
                    for r in range(m):
                        b = take[half, r]
                        for p in range(lanes):
                            after[r, p] = b * x[m, p]
                        for c in range(m):
                            a = keep[half, r, c]
                            for p in range(lanes):
                                after[r, p] += a * x[c, p]
                    for r in range(m):
                        for p in range(lanes):
                            x[r, p] = after[r, p]
                    if half == 0:
                        for p in range(lanes):
                            x[m, p] *= carried[i]
            sink, s = base[first + k], inverse[k]
            if s == 0.0:
                for p in range(lanes):
                    sink[p] = 0.0
                continue
            for p in range(lanes):
                sink[p] -= through * x[m, p]
            for r in range(m):
                for p in range(lanes):
                    sink[p] -= row[r] * x[r, p]
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
        self.inverse = np.zeros(good.size)
        self._gain, self.alone = np.zeros((good.size, row.size + 1)), np.empty(good.size)
        _gains(*self._chain, drawn, early, good, self.inverse, self._gain, self.alone)

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
