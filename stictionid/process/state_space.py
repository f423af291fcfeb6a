"""Linear elements in series with the process: exact response of lags, integrator and elements to held positions.

An element has unit gain and is given by its state space x' = A x + B u, y = C x + D u, for many candidates at once. The
whole chain is u -> lag T1 -> lag T2 -> elements -> integral. It is discretised exactly for an input that is held over a
part of a sample, with a dead time of any fraction of a part. `free_run` in process/linear.py calls it where a process
has elements; lags alone have faster kernels there.

Wrong when the input moves inside a part. At a sample the output has not yet seen the move made there.
Source: zero-order hold by the exponential of the augmented matrix, scaled and squared (Moler and Van Loan 2003).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numerics.jit import LANES, kernel, output
from ..typing import FloatArray, IntArray

# Shortest lag of the chain, in parts of a sample: a shorter one has ended within its part. Unit: 1.
_SHORTEST = 1e-3
# Terms of the exponential's series after the matrix was scaled to a norm of at most _SCALED.
_TERMS, _SCALED = 13, 0.5


@dataclass(frozen=True, slots=True)
class Element:
    """A linear element of P candidates: A (P, m, m), B (P, m), C (P, m) and D (P,), with gain 1 at frequency zero."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

    @property
    def order(self) -> int:
        """Number of states m."""
        return self.B.shape[1]


def element_of(numerator: FloatArray, denominator: FloatArray) -> Element:
    """Element of transfer functions with coefficients (m + 1, P) in falling powers of s, the denominator's first not 0.

    The states are those of the observer form.
    """
    m, lanes = denominator.shape[0] - 1, denominator.shape[1]
    a, b = denominator[1:] / denominator[0], numerator / denominator[0]
    A = np.zeros((lanes, m, m))
    A[:, :, :1] = -a.T[:, :, None]
    A[:, np.arange(m - 1), np.arange(1, m)] = 1.0
    C = np.zeros((lanes, m))
    C[:, :1] = 1.0
    return Element(A, (b[1:] - a * b[0]).T, C, b[0].copy())


def _chain(T1: FloatArray, T2: FloatArray, elements: tuple[Element, ...], integrating: bool,
           part_s: float) -> Element:
    """Lags, elements and integral in series as one element; a lag that is 0 for all is left out."""
    lags = [lag for lag in (T1, T2) if lag.max() > _SHORTEST * part_s]
    m = len(lags) + sum(e.order for e in elements) + int(integrating)
    lanes = T1.size
    A, B = np.zeros((lanes, m, m)), np.zeros((lanes, m))
    # Output of the chain so far: row (P, m) of the states and feedthrough (P,) of the input.
    row, through, at = np.zeros((lanes, m)), np.ones(lanes), 0
    for lag in lags:
        rate = 1.0 / np.maximum(lag, _SHORTEST * part_s)
        A[:, at] = rate[:, None] * row
        A[:, at, at] = -rate
        B[:, at] = rate * through
        row, through, at = np.eye(m)[at][None].repeat(lanes, axis=0), np.zeros(lanes), at + 1
    for e in elements:
        own = slice(at, at + e.order)
        A[:, own] = e.B[:, :, None] * row[:, None, :]
        A[:, own, own] = e.A
        B[:, own] = e.B * through[:, None]
        row, through, at = e.D[:, None] * row, e.D * through, at + e.order
        row[:, own] = e.C
    if integrating:
        A[:, at], B[:, at] = row, through
        row, through = np.eye(m)[at][None].repeat(lanes, axis=0), np.zeros(lanes)
    return Element(A, B, row, through)


@kernel
def _held(A: FloatArray, B: FloatArray, seconds: FloatArray, keep: FloatArray, take: FloatArray) -> None:
    """Fill keep (P, m, m) and take (P, m): states after some seconds (P,) with the input held."""
    lanes, m = B.shape
    big, term = np.empty((m + 1, m + 1)), np.empty((m + 1, m + 1))
    after, total = np.empty((m + 1, m + 1)), np.empty((m + 1, m + 1))
    # Element by element: arithmetic of whole arrays takes five times as long to compile.
    for p in range(lanes):
        size = 0.0
        for i in range(m):
            row = abs(B[p, i] * seconds[p])
            for j in range(m):
                big[i, j] = A[p, i, j] * seconds[p]
                row += abs(big[i, j])
            big[i, m] = B[p, i] * seconds[p]
            size = max(size, row)
        halvings = 0
        while size > _SCALED and halvings < 60:
            size *= 0.5
            halvings += 1
        scale = 0.5 ** halvings
        for j in range(m + 1):
            big[m, j] = 0.0
            for i in range(m + 1):
                big[i, j] *= scale
                total[i, j] = term[i, j] = 1.0 if i == j else 0.0
        for n in range(1, _TERMS):
            for i in range(m + 1):
                for j in range(m + 1):
                    s = 0.0
                    for k in range(m + 1):
                        s += term[i, k] * big[k, j]
                    after[i, j] = s / n
            for i in range(m + 1):
                for j in range(m + 1):
                    term[i, j] = after[i, j]
                    total[i, j] += after[i, j]
        for _ in range(halvings):
            for i in range(m + 1):
                for j in range(m + 1):
                    s = 0.0
                    for k in range(m + 1):
                        s += total[i, k] * total[k, j]
                    after[i, j] = s
            for i in range(m + 1):
                for j in range(m + 1):
                    total[i, j] = after[i, j]
        for i in range(m):
            take[p, i] = total[i, m]
            for j in range(m):
                keep[p, i, j] = total[i, j]


@kernel
def _run(position: FloatArray, substeps: int, keep: FloatArray, across: FloatArray, old: FloatArray, new: FloatArray,
         row: FloatArray, through: FloatArray, whole: IntArray, pick: IntArray, response: FloatArray) -> None:
    """Fill response (samples + longest whole delay, P); tables have the candidates last.

    A lane's output is taken behind part `pick` of a sample. Its states go there from one sample to the next at once, by
    `across`, which is `keep` over all parts. What every part adds to them, now or at the next sample, is known before.
    """
    m, lanes = new.shape
    shared = position.shape[1] < lanes
    samples = position.shape[0] // substeps
    # A block of lanes has its constants and states in a table of its own: indices from 0 need no check for a sign.
    rows, states, sums, later = m * m, m * m + m, m * m + 2 * m, m * m + 3 * m
    start = later + m
    now, out, total, feed, adds = start + 1, start + 2, start + 3, start + 4, start + 5
    carries = adds + substeps * m
    work, at = np.empty((carries + substeps * m, LANES)), np.empty(LANES, np.int64)
    # Parts that add to a sample of any lane, to the next one, and behind which the output of some lane is taken.
    does = np.empty((3, substeps), np.int64)
    after, steps = np.empty(m), np.empty((2, m))
    flat = response.reshape(response.size)
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        work[:] = 0.0
        does[:] = 0
        for p in range(width):
            q = first + p
            for i in range(m):
                work[rows + i, p], steps[0, i], steps[1, i] = row[i, q], new[i, q], old[i, q]
                for j in range(m):
                    work[i * m + j, p] = across[i, j, q]
            for n in range(substeps):
                # (a command counts once where it arrives, and once as the one before)
                for which in range(2):
                    part = pick[q] - n - which
                    does[0 if part >= 0 else 1, part if part >= 0 else part + substeps] = 1
                    to = adds + part * m if part >= 0 else carries + (part + substeps) * m
                    for i in range(m):
                        work[to + i, p] += steps[which, i]
                    for i in range(m):
                        s = 0.0
                        for j in range(m):
                            s += keep[i, j, q] * steps[which, j]
                        after[i] = s
                    for i in range(m):
                        steps[which, i] = after[i]
            work[start, p], work[feed, p] = position[0, 0 if shared else q], through[q]
            does[2, pick[q]] = 1 if through[q] != 0.0 else does[2, pick[q]]
            at[p] = (1 + whole[q]) * lanes + q
        for k in range(samples - 1):
            for s in range(substeps):
                here = position[k * substeps + s]
                if shared:
                    for p in range(width):
                        work[now, p] = here[0] - work[start, p]
                else:
                    here = here[first:first + width]
                    for p in range(width):
                        work[now, p] = here[p] - work[start, p]
                for i in range(m if s == 0 else 0):
                    for p in range(width):
                        work[sums + i, p] = work[later + i, p] + work[adds + i, p] * work[now, p]
                        work[later + i, p] = work[carries + i, p] * work[now, p]
                for i in range(m if s > 0 and does[0, s] == 1 else 0):
                    for p in range(width):
                        work[sums + i, p] += work[adds + s * m + i, p] * work[now, p]
                for i in range(m if s > 0 and does[1, s] == 1 else 0):
                    for p in range(width):
                        work[later + i, p] += work[carries + s * m + i, p] * work[now, p]
                for p in range(width if does[2, s] == 1 else 0):
                    work[out, p] = work[feed, p] * work[now, p] if pick[first + p] == s else work[out, p]
            for i in range(m):
                for j in range(m):
                    for p in range(width):
                        work[sums + i, p] += work[i * m + j, p] * work[states + j, p]
            for i in range(m):
                for p in range(width):
                    work[states + i, p] = work[sums + i, p]
                    work[total, p] = (work[total, p] if i else work[out, p]) + work[rows + i, p] * work[sums + i, p]
            shift = k * lanes
            for p in range(width):
                # Every lane writes into its own later row, so that dead times differ without a gather.
                flat[np.uint64(at[p] + shift)] = work[total, p]


def series_run(position: FloatArray, T1: FloatArray, L: FloatArray, T2: FloatArray, elements: tuple[Element, ...],
               integrating: bool, *, step_s: float, substeps: int, ahead: bool, room: int, lent: bool) -> FloatArray:
    """Response per unit of gain (n + room, P) of the whole chain; see `free_run` in process/linear.py."""
    part = step_s / substeps
    lanes = T1.size
    delay = np.maximum(L - (part if ahead else 0.0), 0.0) / part
    steps = np.floor(delay + 1e-12)
    first = np.clip(delay - steps, 0.0, 1.0) * part
    chain = _chain(T1, T2, elements, integrating, part)
    m = chain.order
    early, late = (np.empty((lanes, m, m)) for _ in range(2))
    taken, new = (np.empty((lanes, m)) for _ in range(2))
    _held(chain.A, chain.B, first, early, taken)
    _held(chain.A, chain.B, part - first, late, new)
    keep, old = late @ early, (late @ taken[:, :, None])[:, :, 0]
    whole = (steps // substeps).astype(np.int64)
    pick = substeps - 1 - (steps.astype(np.int64) - whole * substeps)
    samples = position.shape[0] // substeps
    response = output("response", samples + max(int(whole.max()), room), lanes, lent)
    response[:int(whole.max()) + 1] = 0.0
    across = np.linalg.matrix_power(keep, substeps)
    _run(np.ascontiguousarray(position), substeps, np.ascontiguousarray(np.moveaxis(keep, 0, 2)),
         np.ascontiguousarray(np.moveaxis(across, 0, 2)), np.ascontiguousarray(old.T), np.ascontiguousarray(new.T),
         np.ascontiguousarray(chain.C.T), chain.D, whole, pick, response)
    return response[:samples + room]


@dataclass(frozen=True, slots=True)
class Held:
    """A chain advanced over a part before (0) and behind (1) the fraction of its dead time, the input held over each.

    `keep` (2, m, m) and `take` (2, m) give the states, `row` (m,) and `through` the response; `late` are whole parts.
    """

    keep: FloatArray
    take: FloatArray
    row: FloatArray
    through: float
    late: int

    def over(self, parts: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Tables (2 + parts, s, s) and (2 + parts, s) over each half and over 1 to `parts` parts, and the row (s,).

        One state alone has another beside it that stays 0.
        """
        m = self.row.size
        states = max(m, 2)
        hold, feed, row = np.zeros((2 + parts, states, states)), np.zeros((2 + parts, states)), np.zeros(states)
        hold[:2, :m, :m], feed[:2, :m], row[:m] = self.keep, self.take, self.row
        for many in range(2, 2 + parts):
            first, then = (0, 1) if many == 2 else (many - 1, 2)
            feed[many] = feed[then] + np.einsum("rs,s->r", hold[then], feed[first])
            hold[many] = np.einsum("rs,sc->rc", hold[then], hold[first])
        return hold, feed, row


def held_chain(T1: FloatArray, L: FloatArray, T2: FloatArray, elements: tuple[Element, ...], integrating: bool, *,
               part_s: float, ahead: bool) -> Held:
    """The chain of one candidate as it runs from one value of the command to the next; see `series_run`."""
    delay = max(float(L[0]) - (part_s if ahead else 0.0), 0.0) / part_s
    late = int(np.floor(delay + 1e-12))
    first = min(max(delay - late, 0.0), 1.0) * part_s
    chain = _chain(T1[:1], T2[:1], elements, integrating, part_s)
    m = chain.order
    keep, take = np.empty((2, m, m)), np.empty((2, m))
    two = np.repeat(chain.A, 2, axis=0), np.repeat(chain.B, 2, axis=0)
    _held(*two, np.array([first, part_s - first]), keep, take)
    return Held(keep, take, chain.C[0].copy(), float(chain.D[0]), late)


@kernel
def _modes(keep: FloatArray, row: FloatArray, out: FloatArray) -> None:
    """Fill out (m * samples, P): what every state alone (column i), once 1, leaves in the output at the samples.

    Tables have the candidates last. What has decayed in all of a block of lanes is zero from there on.
    """
    m, lanes = row.shape
    samples = out.shape[0] // m
    rows, states, after, total = m * m, m * m + m, m * m + 2 * m, m * m + 3 * m
    work = np.empty((total + 1, LANES))
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        for p in range(width):
            for i in range(m):
                work[rows + i, p] = row[i, first + p]
                for j in range(m):
                    work[i * m + j, p] = keep[i, j, first + p]
        for i in range(m):
            for j in range(m):
                work[states + j] = 1.0 if j == i else 0.0
            left = 1.0
            for k in range(samples):
                line = out[i * samples + k, first:first + width]
                if left == 0.0:
                    line[:] = 0.0
                    continue
                work[total] = 0.0
                for j in range(m):
                    for p in range(width):
                        work[total, p] += work[rows + j, p] * work[states + j, p]
                for p in range(width):
                    y = work[total, p]
                    line[p] = y if abs(y) > 1e-14 else 0.0
                left = 0.0
                for j in range(m):
                    work[after + j] = 0.0
                    for n in range(m):
                        for p in range(width):
                            work[after + j, p] += work[j * m + n, p] * work[states + n, p]
                for j in range(m):
                    for p in range(width):
                        s = work[after + j, p]
                        s = s if abs(s) > 1e-14 else 0.0
                        work[states + j, p] = s
                        left += abs(s)


def modes(element: Element, out: FloatArray, *, step_s: float) -> None:
    """Fill `out` (m * samples, P) with what is left of an unknown start of each state; their sizes are linear."""
    lanes, m = element.B.shape
    keep, take = np.empty((lanes, m, m)), np.empty((lanes, m))
    _held(element.A, element.B, np.full(lanes, step_s), keep, take)
    _modes(np.ascontiguousarray(np.moveaxis(keep, 0, 2)), np.ascontiguousarray(element.C.T), out)


class Stepped:
    """One element advanced step by step, for a simulation: the input is held, or its mean, over every step."""

    def __init__(self, element: Element, step_s: float) -> None:
        m = element.order
        keep, take = np.empty((1, m, m)), np.empty((1, m))
        _held(element.A, element.B, np.full(1, step_s), keep, take)
        self._keep, self._take, self._row = keep[0].tolist(), take[0].tolist(), element.C[0].tolist()
        self._through, self._state = float(element.D[0]), [0.0] * m

    def advance(self, mean: float, end: float) -> float:
        """Output at the end of a step over which the input had a mean, and ended at `end`."""
        before = self._state
        self._state = [sum(k * x for k, x in zip(row, before, strict=True)) + b * mean
                       for row, b in zip(self._keep, self._take, strict=True)]
        return sum(c * x for c, x in zip(self._row, self._state, strict=True)) + self._through * end
