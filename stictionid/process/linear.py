"""Linear process dynamics: exact response to a held valve position, at the samples, for many candidates at once.

G(s) = K e^{-L s} / ((T1 s + 1)(T2 s + 1)), or the same over s when integrating; T2 = 0 is the base process. The gain
K stays outside (it is linear), so responses are per unit of gain and start from rest at the first position. Further
linear elements in series with it run in process/state_space.py.

The position is held over each of `substeps` equal parts of a sampling interval. Between parts nothing is approximated,
and the dead time L may be any fraction of a part. Wrong when the position moves inside a part. Source: exact
discretisation of cascaded lags (zero-order hold), docs/details.md, sections 2 and 6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..numerics.jit import LANES, LINE, kernel, output, scratch
from ..typing import FloatArray, IntArray
from .directional import directional_lag
from .state_space import Element, series_run

# Rows of the coefficient table. First the decays over a part of either lag and of an integral, the weights of their
# sums in the response, and that of the position there. For one lag the weights of the position in the part and before
# follow. For two lags the second one's decay over the rest of a part and the first one's share in the response follow.
_A1, _A2, _ENDLESS, _W1, _W2, _W_ENDLESS, _W_NOW, _B1, _C1, _E2, _CROSS = range(11)
_COEFFICIENTS = 11
# Decay rows of the sums that `_run` keeps: two lags, or lags with an integral; one lag alone has kernels of its own.
_TWO_LAGS, _INTEGRAL, _INTEGRAL_TWO = (np.array(rows) for rows in ((_A1, _A2), (_A1, _ENDLESS), (_A1, _A2, _ENDLESS)))
# Rows of the working table of `_run`: first position, part to report, weight of the position there, response. Every
# mode adds decay, weight and sum.
_START, _PICK, _WEIGHT, _OUT, _ROWS = range(5)
_DECAY, _SHARE, _TOTAL = range(3)
# Parts taken in one pass over the lanes; the sums then stay in the registers.
_TOGETHER = 4
# Two time constants closer than this share are spread apart, because the cascade's formula divides by their difference.
# Unit: 1; at 1e-6 the response moves by less than 1e-6 of its size.
_SPREAD = 1e-6


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Time constants and dead time of P candidates, each (P,), in seconds; `integrating` holds for all.

    `elements` of unit gain stand in series with the lags. `closing` (P,) is the first lag's time constant while it
    falls, as a multiple of that while it rises; None is 1. `dead_time_drift` (P,) is the growth of the dead time in a
    second, as a share of `dead_time_s`, which holds at the start of the whole record; None is 0. The first sample
    comes `since_s` seconds after that start.
    """

    time_constant_s: FloatArray
    dead_time_s: FloatArray
    second_time_constant_s: FloatArray
    integrating: bool
    elements: tuple[Element, ...] = ()
    closing: FloatArray | None = None
    dead_time_drift: FloatArray | None = None
    since_s: float = 0.0


# The kernels below repeat the lines that end a sample. In a kernel of their own, called from here, these lines doubled
# the time of a short one (108 against 47 µs for 64,000 positions, measured).
@kernel
def _run(position: FloatArray, substeps: int, table: FloatArray, kinds: IntArray, whole: IntArray, fine: IntArray,
         response: FloatArray) -> None:
    """Fill response (samples + longest whole delay, P); rows before a lane's delay stay as they are (zero).

    Every mode is a sum over all positions so far, decayed by age: s = a s + u for each part, a = 1 for an integral.
    The response is the weighted position of the part to report plus the weighted sums of the modes before it. Two lags
    respond as the weighted difference of two single lags.
    """
    modes, lanes = kinds.size, response.shape[1]
    samples = position.shape[0] // substeps
    room = np.empty((_ROWS + 3 * modes) * LANES + LINE)
    shift = -(room.ctypes.data // 8) % LINE
    work = room[shift:shift + _ROWS * LANES].reshape(_ROWS, LANES)
    shift += _ROWS * LANES
    sums = room[shift:shift + 3 * modes * LANES].reshape(3, modes, LANES)
    at = np.empty(LANES, np.int64)
    flat = response.reshape(response.size)
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        last = first + width
        work[:] = 0.0
        for p in range(width):
            q = first + p
            work[_START, p] = position[0, q]
            work[_PICK, p] = float(substeps - 1 - fine[q])
            work[_WEIGHT, p] = table[_W_NOW, q]
            at[p] = (1 + whole[q]) * lanes + q
            for i in range(modes):
                sums[_DECAY, i, p], sums[_SHARE, i, p] = table[kinds[i], q], table[kinds[i] + _W1 - _A1, q]
                sums[_TOTAL, i, p] = 0.0
        alike = (whole[first:last] == whole[first]).all()
        for k in range(samples - 1):
            if substeps == 1:
                here = position[k, first:last]
                for i in range(modes):
                    for p in range(width):
                        u, total = here[p] - work[_START, p], sums[_TOTAL, i, p]
                        work[_OUT, p] = sums[_SHARE, i, p] * total + (work[_WEIGHT, p] * u if i == 0 else work[_OUT, p])
                        sums[_TOTAL, i, p] = sums[_DECAY, i, p] * total + u
            for s in range(0, substeps if substeps > 1 else 0, _TOGETHER):
                count = min(_TOGETHER, substeps - s)
                row = k * substeps + s
                if count < _TOGETHER:
                    for j in range(0, count, 2):  # (pairs, and a last one alone)
                        second = min(j + 1, count - 1)
                        here, there = position[row + j, first:last], position[row + second, first:last]
                        one, two = float(s + j), float(s + second)
                        for i in range(modes):
                            for p in range(width):
                                start, decay, pick = work[_START, p], sums[_DECAY, i, p], work[_PICK, p]
                                before, now, out = sums[_TOTAL, i, p], here[p] - start, work[_OUT, p]
                                total = decay * before + now
                                if second > j:
                                    u = there[p] - start
                                    before, now = (total, u) if pick == two else (before, now)
                                    total = decay * total + u
                                sums[_TOTAL, i, p] = total
                                y = sums[_SHARE, i, p] * before + (work[_WEIGHT, p] * now if i == 0 else out)
                                work[_OUT, p] = y if (one <= pick) & (pick <= two) else out
                    continue
                r0, r1 = position[row, first:last], position[row + 1, first:last]
                r2, r3 = position[row + 2, first:last], position[row + 3, first:last]
                p0, p1, p2, p3 = float(s), float(s + 1), float(s + 2), float(s + 3)
                for i in range(modes):
                    for p in range(width):
                        pick, start, decay, out = work[_PICK, p], work[_START, p], sums[_DECAY, i, p], work[_OUT, p]
                        u0, u1, u2, u3 = r0[p] - start, r1[p] - start, r2[p] - start, r3[p] - start
                        before, now = sums[_TOTAL, i, p], u0
                        total = decay * before + u0
                        before, now = (total, u1) if pick == p1 else (before, now)
                        total = decay * total + u1
                        before, now = (total, u2) if pick == p2 else (before, now)
                        total = decay * total + u2
                        before, now = (total, u3) if pick == p3 else (before, now)
                        sums[_TOTAL, i, p] = decay * total + u3
                        y = sums[_SHARE, i, p] * before + (work[_WEIGHT, p] * now if i == 0 else out)
                        work[_OUT, p] = y if (p0 <= pick) & (pick <= p3) else out
            if alike:
                sink = response[1 + k + whole[first], first:last]
                for p in range(width):
                    sink[p] = work[_OUT, p]
            else:
                shift = k * lanes
                for p in range(width):
                    # Every lane writes into its own later row, so that dead times differ without a gather.
                    flat[np.uint64(at[p] + shift)] = work[_OUT, p]


@kernel
def _run_plain(position: FloatArray, table: FloatArray, whole: IntArray, response: FloatArray) -> None:
    """`_run` for one lag and positions held between samples, the most frequent case in a search."""
    lanes = response.shape[1]
    work = np.empty(6 * LANES + LINE)
    work = work[-(work.ctypes.data // 8) % LINE:]
    at = np.empty(LANES, np.int64)
    flat = response.reshape(response.size)
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        last = first + width
        for p in range(width):
            work[p] = table[_A1, first + p]
            work[LANES + p] = table[_B1, first + p]
            work[2 * LANES + p] = table[_C1, first + p]
            work[3 * LANES + p] = position[0, first + p]
            work[4 * LANES + p] = 0.0
            work[5 * LANES + p] = 0.0
            at[p] = (1 + whole[first + p]) * lanes + first + p
        alike = (whole[first:last] == whole[first]).all()
        for k in range(position.shape[0] - 1):
            row = position[k, first:last]
            for p in range(width):
                now = row[p] - work[3 * LANES + p]
                work[4 * LANES + p] = work[p] * work[4 * LANES + p] + (
                    work[2 * LANES + p] * work[5 * LANES + p] + work[LANES + p] * now)
                work[5 * LANES + p] = now
            if alike:
                sink = response[1 + k + whole[first], first:last]
                for p in range(width):
                    sink[p] = work[4 * LANES + p]
            else:
                shift = k * lanes
                for p in range(width):
                    flat[np.uint64(at[p] + shift)] = work[4 * LANES + p]


@kernel
def _run_parts(position: FloatArray, substeps: int, table: FloatArray, whole: IntArray, fine: IntArray,
               response: FloatArray) -> None:
    """`_run` for one lag and parts of samples: each sample is a decay of the last one and a weighted sum of its parts.

    The weights are h_0 = b and h_i = a^(i-1) (a b + c) for a part that ended i parts before the sample. The response at
    a sample is a^m times the one before, plus the h_i of the m parts since then, plus a^(m-1) c of the part before
    these.
    """
    lanes = response.shape[1]
    samples = position.shape[0] // substeps
    even = (substeps + 1) // 2 * 2
    # For every part its weight now and at the next sample; then decay, weights' sum times start, x, now, next.
    room = np.empty(even * 2 * LANES + LINE)
    shift = -(room.ctypes.data // 8) % LINE
    weights = room[shift:shift + even * 2 * LANES].reshape(even, 2, LANES)
    work = np.empty(5 * LANES + LINE)
    work = work[-(work.ctypes.data // 8) % LINE:]
    at = np.empty(LANES, np.int64)
    flat = response.reshape(response.size)
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        last = first + width
        for p in range(width):
            q = first + p
            a, b, c = table[_A1, q], table[_B1, q], table[_C1, q]
            pick = substeps - 1 - fine[q]
            total = 0.0
            for s in range(even):
                age = pick - s
                now = 0.0 if age < 0 or s >= substeps else b if age == 0 else a ** (age - 1) * (a * b + c)
                age = substeps + pick - s
                late = 0.0 if s < pick or s >= substeps else (
                    a ** (substeps - 1) * c if s == pick else a ** (age - 1) * (a * b + c))
                weights[s, 0, p] = now
                weights[s, 1, p] = late
                total += now + late
            work[p] = a ** substeps
            work[LANES + p] = total * position[0, q]
            work[2 * LANES + p] = 0.0
            work[3 * LANES + p] = 0.0
            # Before the record the position was the first one, so that no earlier part contributes.
            start = 0.0
            for s in range(substeps):
                start += weights[s, 1, p] * position[0, q]
            work[4 * LANES + p] = start
            at[p] = (1 + whole[q]) * lanes + q
        alike = (whole[first:last] == whole[first]).all()
        now_0, next_0, now_1, next_1 = weights[0, 0], weights[0, 1], weights[1, 0], weights[1, 1]
        for k in range(samples - 1):
            row = position[k * substeps, first:last]
            after = position[k * substeps + 1, first:last]
            for p in range(width):
                u0, u1 = row[p], after[p]
                left = work[4 * LANES + p] - work[LANES + p]
                work[3 * LANES + p] = left + (now_0[p] * u0 + now_1[p] * u1)
                work[4 * LANES + p] = next_0[p] * u0 + next_1[p] * u1
            for s in range(2, substeps, 2):
                row = position[k * substeps + s, first:last]
                after = position[k * substeps + min(s + 1, substeps - 1), first:last]
                now_2, next_2, now_3, next_3 = weights[s, 0], weights[s, 1], weights[s + 1, 0], weights[s + 1, 1]
                for p in range(width):
                    u0, u1 = row[p], after[p]
                    work[3 * LANES + p] += now_2[p] * u0 + now_3[p] * u1
                    work[4 * LANES + p] += next_2[p] * u0 + next_3[p] * u1
            for p in range(width):
                work[2 * LANES + p] = work[p] * work[2 * LANES + p] + work[3 * LANES + p]
            if alike:
                sink = response[1 + k + whole[first], first:last]
                for p in range(width):
                    sink[p] = work[2 * LANES + p]
            else:
                shift = k * lanes
                for p in range(width):
                    flat[np.uint64(at[p] + shift)] = work[2 * LANES + p]


@kernel
def _run_path(path: FloatArray, substeps: int, table: FloatArray, whole: IntArray, fine: IntArray, lags: int,
              response: FloatArray) -> None:
    """`_run_parts` for one path (n*substeps,) that all lanes share and one or two `lags`, and no path to load for each.

    Two lags respond as the weighted difference of two single lags; their weights are (T1, -T2) / (T1 - T2).
    """
    lanes = response.shape[1]
    samples = path.size // substeps
    fours = (substeps + 3) // 4
    # For every lag and part its weight now and at the next sample; then for every lag decay, x, now, next.
    weights = np.zeros(lags * fours * 8 * LANES + LINE)
    weights = weights[-(weights.ctypes.data // 8) % LINE:]
    work = np.empty((4 * lags + 1) * LANES + LINE)
    work = work[-(work.ctypes.data // 8) % LINE:]
    u = np.zeros(4 * fours)
    at = np.empty(LANES, np.int64)
    flat = response.reshape(response.size)
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        work[:] = 0.0
        for p in range(width):
            q = first + p
            pick = substeps - 1 - fine[q]
            for lag in range(lags):
                a = table[_A2 if lag else _A1, q]
                e = table[_E2, q] if lag else a + table[_C1, q]
                b, c = 1.0 - e, e - a
                for s in range(substeps):
                    age = pick - s
                    now = 0.0 if age < 0 else b if age == 0 else a ** (age - 1) * (a * b + c)
                    age += substeps
                    late = 0.0 if s < pick else a ** (substeps - 1) * c if s == pick else a ** (age - 1) * (a * b + c)
                    i = (lag * fours * 4 + s) * 2 * LANES + p
                    weights[i] = now
                    weights[i + LANES] = late
                work[4 * lag * LANES + p] = a ** substeps
            work[4 * lags * LANES + p] = table[_CROSS, q]
            at[p] = (1 + whole[q]) * lanes + q
        for k in range(samples - 1):
            for s in range(substeps):
                # From rest at the first position: no earlier part contributes.
                u[s] = path[k * substeps + s] - path[0]
            for lag in range(lags):
                i = 4 * lag * LANES
                for p in range(width):
                    work[i + LANES + p] = work[i + p] * work[i + LANES + p] + work[i + 3 * LANES + p]
                    work[i + 2 * LANES + p] = 0.0
                    work[i + 3 * LANES + p] = 0.0
                for four in range(fours):
                    u0, u1, u2, u3 = u[4 * four], u[4 * four + 1], u[4 * four + 2], u[4 * four + 3]
                    j = (lag * fours + four) * 8 * LANES
                    for p in range(width):
                        work[i + 2 * LANES + p] += (u0 * weights[j + p] + u1 * weights[j + 2 * LANES + p]) + (
                            u2 * weights[j + 4 * LANES + p] + u3 * weights[j + 6 * LANES + p])
                        work[i + 3 * LANES + p] += (u0 * weights[j + LANES + p] + u1 * weights[j + 3 * LANES + p]) + (
                            u2 * weights[j + 5 * LANES + p] + u3 * weights[j + 7 * LANES + p])
                for p in range(width):
                    work[i + LANES + p] += work[i + 2 * LANES + p]
            shift = k * lanes
            if lags == 1:
                for p in range(width):
                    flat[np.uint64(at[p] + shift)] = work[LANES + p]
            else:
                for p in range(width):
                    x, z = work[LANES + p], work[5 * LANES + p]
                    flat[np.uint64(at[p] + shift)] = z + work[8 * LANES + p] * (x - z)


@kernel
def _coefficients(T1: FloatArray, L: FloatArray, T2: FloatArray, part: float, substeps: int, ahead: bool,
                  integrating: bool, table: FloatArray, whole: IntArray, fine: IntArray) -> tuple[bool, int]:
    """Fill the coefficient table, and the dead times in whole samples and in parts.

    Returns True where any second lag acts, and the longest dead time in whole samples.
    """
    any_lagged = False
    late = 0
    for p in range(T1.size):
        t1 = max(T1[p], 1e-9 * part)
        t2 = T2[p]
        lagged = t2 > 1e-9 * part
        any_lagged = any_lagged or lagged
        if abs(t2 - t1) < _SPREAD * t1:
            t2 = t1 * (1.0 + _SPREAD)
        delay = max(L[p] - (part if ahead else 0.0), 0.0) / part
        steps = np.floor(delay + 1e-12)
        f = min(max(delay - steps, 0.0), 1.0)
        rest = (1.0 - f) * part
        a1, e1 = np.exp(-part / t1), np.exp(-rest / t1)
        a2, e2 = (np.exp(-part / t2), np.exp(-rest / t2)) if lagged else (0.0, 0.0)
        cross = t1 / (t1 - t2) if lagged else 1.0
        # Shares of the lags in the response; an integral is reduced by the content of either lag.
        one = -t1 - t2 * cross if integrating else cross
        two = -t2 * (1.0 - cross) if integrating else 1.0 - cross
        table[_A1, p], table[_A2, p], table[_ENDLESS, p] = a1, a2, 1.0
        table[_W1, p], table[_W2, p], table[_W_ENDLESS, p] = one * (e1 * (1.0 - a1)), two * (e2 * (1.0 - a2)), part
        table[_W_NOW, p] = one * (1.0 - e1) + two * (1.0 - e2) + (rest if integrating else 0.0)
        table[_B1, p], table[_C1, p] = 1.0 - e1, e1 - a1
        table[_E2, p], table[_CROSS, p] = e2, cross
        whole[p] = int(steps) // substeps
        fine[p] = int(steps) - whole[p] * substeps
        late = max(late, whole[p])
    return any_lagged, late


def _for_each(x: FloatArray, lanes: int) -> FloatArray:
    """One number for every candidate (P,), as a contiguous array."""
    return x if x.shape == (lanes,) and x.flags.c_contiguous else np.ascontiguousarray(np.broadcast_to(x, lanes))


def free_run(position: FloatArray, dynamics: Dynamics, *, step_s: float, substeps: int = 1,
             ahead: bool = False, room: int = 0, lent: bool = False) -> FloatArray:
    """Response per unit of gain (n, P) at the samples to positions (n*substeps, P), from rest at the first one.

    Positions (n*substeps, 1) are a path that all candidates share. `step_s` is the sampling time. A position holds
    over the part that follows its instant. With `ahead` it holds over the part that ended there (see `interval_means`
    in process/intersample.py), and dead times below one part count as one part.
    `room` rows, with undefined content, follow the response for further columns of the caller. A `lent` response holds
    until the next call (see `scratch` in numerics/jit.py).
    """
    lanes = max(position.shape[1], dynamics.time_constant_s.size)
    T1, L = _for_each(dynamics.time_constant_s, lanes), _for_each(dynamics.dead_time_s, lanes)
    T2 = _for_each(dynamics.second_time_constant_s, lanes)
    if dynamics.closing is not None or dynamics.dead_time_drift is not None:
        part, n = step_s / substeps, position.shape[0] // substeps
        closing = np.ones(lanes) if dynamics.closing is None else _for_each(dynamics.closing, lanes)
        growth = np.zeros(lanes) if dynamics.dead_time_drift is None else L * dynamics.dead_time_drift
        # A position of a part that ended arrives one part late.
        first = L + growth * (dynamics.since_s + 0.5 * part) - (part if ahead else 0.0)
        ends, means = directional_lag(position, T1, first, closing, growth, part)
        if dynamics.elements or dynamics.integrating or T2.any():
            rest = replace(dynamics, time_constant_s=np.zeros(lanes), dead_time_s=np.zeros(lanes), closing=None,
                           dead_time_drift=None)
            return free_run(means, rest, step_s=step_s, substeps=substeps, room=room, lent=lent)
        response = output("response", n + room, lanes, lent)
        response[0], response[1:n] = 0.0, ends[substeps - 1:-1:substeps]
        return response
    if dynamics.elements:
        return series_run(position, T1, L, T2, dynamics.elements, dynamics.integrating, step_s=step_s,
                          substeps=substeps, ahead=ahead, room=room, lent=lent)
    table = np.empty((_COEFFICIENTS, lanes))
    whole, fine = np.empty(lanes, np.int64), np.empty(lanes, np.int64)
    lagged, late = _coefficients(T1, L, T2, step_s / substeps, substeps, ahead, dynamics.integrating, table, whole,
                                 fine)
    samples = position.shape[0] // substeps
    response = output("response", samples + max(late, room), lanes, lent)
    response[:late + 1] = 0.0
    position = np.ascontiguousarray(position)
    common = position.shape[1] < lanes
    if common and (substeps == 1 or dynamics.integrating):
        path = scratch("path", position.shape[0], lanes)
        path[:] = position
        position, common = path, False
    if common:
        _run_path(position[:, 0].copy(), substeps, table, whole, fine, 1 + int(lagged), response)
    elif dynamics.integrating or lagged:
        kinds = (_INTEGRAL_TWO if lagged else _INTEGRAL) if dynamics.integrating else _TWO_LAGS
        _run(position, substeps, table, kinds, whole, fine, response)
    elif substeps == 1:
        _run_plain(position, table, whole, response)
    else:
        _run_parts(position, substeps, table, whole, fine, response)
    return response[:samples + room]


@kernel
def _decay(T: FloatArray, step_s: float, out: FloatArray) -> None:
    samples, lanes = out.shape
    factor = np.empty(lanes)
    for p in range(lanes):
        alive = T[p] > 0.02 * step_s
        factor[p] = np.exp(-step_s / T[p]) if alive else 0.0
        out[0, p] = 1.0 if alive else 0.0
    for k in range(1, samples):
        before = out[k - 1]
        row = out[k]
        for p in range(lanes):
            # Below this the transient has decayed; denormal numbers would only cost time.
            row[p] = before[p] * factor[p] if before[p] > 1e-14 else 0.0


def transient(time_constant_s: FloatArray, out: FloatArray, *, step_s: float) -> None:
    """Fill `out` (samples, P) with what is left of an unknown start, exp(-t/T) at the samples; its size is linear."""
    _decay(np.ascontiguousarray(time_constant_s, dtype=np.float64), step_s, out)
