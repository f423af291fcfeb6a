"""Series with stamps of their own, brought to those of the slower of PV and OP; offsets are kept.

A PV at whole multiples of OP's step keeps OP's stamps: the valve runs on these, and the cost counts where PV is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import DataError
from ...typing import FloatArray, IntArray
from ..series.shaped import Series
from .grid import JITTER_TOLERANCE, MAX_FILLED, MIN_REGULAR_SHARE, Frame, GridStep, find_step

SLOWER = 1.5
"""Ratio of steps from which one tag counts as sampled more slowly than another."""
MOST_OUTPUTS = 50
"""Values of OP to one of PV up to which all of them are kept."""
WHOLE = 0.01
"""Deviation of the ratio of two steps from a whole number that is still one."""


def align(series: dict[str, Series]) -> Frame:
    """One frame of all series. DataError where PV and OP do not overlap in time."""
    pv, op = series["process_value"], series["output"]
    if all(s.ns is pv.ns or (s.ns.size == pv.ns.size and np.array_equal(s.ns, pv.ns)) for s in series.values()):
        same = all(s.rows is pv.rows for s in series.values())
        sources = [pv.rows] if same else [s.rows for s in series.values()]
        return Frame(pv.ns, {k: s.values for k, s in series.items()}, sources)
    low, high = max(pv.ns[0], op.ns[0]), min(pv.ns[-1], op.ns[-1])
    if high <= low:
        raise DataError("PV and OP have no time in common", "export both tags over the same window")
    steps = {role: find_step(s.ns) if s.ns.size > 2 else GridStep(float("inf"), "irregular")
             for role, s in series.items()}
    slower = steps["output"].kind != "irregular" and steps["output"].ns > SLOWER * steps["process_value"].ns
    base = "output" if slower or _within(pv, op, steps["process_value"], steps["output"]) else "process_value"
    slack = int(steps["process_value"].ns) if pv.ns.size > 2 else 0
    ns = series[base].ns
    frame = Frame(ns[(ns >= op.ns[0] - slack) & (ns <= high + slack)], {}, [])
    if slower:
        frame.thinned = max(1, round(steps["output"].ns / steps["process_value"].ns))
    for role, one in series.items():
        if role == "process_value" and steps[role].ns > SLOWER * steps[base].ns:
            frame.values[role], rows = _placed(frame.ns, one, steps[base])
        else:
            frame.values[role], rows = _onto(frame, one, role, steps[role], steps[base])
        frame.rows.append(rows)
    return frame


def _within(pv: Series, op: Series, pv_step: GridStep, op_step: GridStep) -> bool:
    """True where PV comes at whole multiples of OP's step, at stamps of OP: OP then keeps its own step."""
    if "irregular" in (pv_step.kind, op_step.kind):
        return False
    times = pv_step.ns / op_step.ns
    if not SLOWER < times <= MOST_OUTPUTS or abs(times - round(times)) > WHOLE:
        return False
    inside = pv.ns[(pv.ns >= op.ns[0]) & (pv.ns <= op.ns[-1])]
    distance = np.abs(op.ns[_nearest(op.ns, inside)] - inside)
    return bool(inside.size and np.mean(distance <= JITTER_TOLERANCE * op_step.ns) >= MIN_REGULAR_SHARE)


def _placed(ns: IntArray, one: Series, base: GridStep) -> tuple[FloatArray, IntArray]:
    """Values of a slower series at the stamps it shares with `ns`, none elsewhere, and the file row behind each."""
    place = _nearest(one.ns, ns)
    close = np.abs(one.ns[place] - ns) <= JITTER_TOLERANCE * base.ns
    return np.where(close, one.values[place], np.nan), np.where(close, one.rows[place], -1)


def _onto(frame: Frame, one: Series, role: str, step: GridStep, base: GridStep) -> tuple[FloatArray, IntArray]:
    """Values of a series at the stamps of a frame, and the file row behind each."""
    ns = frame.ns
    if step.kind != "irregular" and base.kind != "irregular" and step.ns < SLOWER * base.ns:
        place = _nearest(one.ns, ns)
        distance = one.ns[place] - ns
        alike = step.ns > base.ns / SLOWER
        close = np.abs(distance) <= 0.5 * (min(step.ns, base.ns) if alike else base.ns)
        offset = float(np.median(distance[close])) / 1e9 if close.any() else 0.0
        if offset and alike:
            frame.offsets_s[role] = offset
        return np.where(close, one.values[place], np.nan), np.where(close, one.rows[place], -1)
    last = np.searchsorted(one.ns, ns, side="right") - 1
    before = last < 0
    at = np.maximum(last, 0)
    if role in ("output", "setpoint", "mode"):
        frame.on_change.add(role)
        fresh = np.concatenate([[True], np.diff(at) > 0]) & ~before
        return np.where(before, np.nan, one.values[at]), np.where(fresh, one.rows[at], -1)
    return _between(ns, one, at, before, base)


def _between(
    ns: IntArray, one: Series, at: IntArray, before: NDArray[np.bool_], base: GridStep
) -> tuple[FloatArray, IntArray]:
    """Straight lines between the two records around each stamp, where they are near enough."""
    after = np.minimum(at + 1, one.ns.size - 1)
    gap = (one.ns[after] - one.ns[at]).astype(np.float64)
    share = np.where(gap > 0, (ns - one.ns[at]) / np.where(gap > 0, gap, 1.0), 0.0)
    exact = ns == one.ns[at]
    near = exact | ((gap <= (MAX_FILLED + 1) * base.ns) & (share <= 1.0))
    values = np.where(exact, one.values[at], (1 - share) * one.values[at] + share * one.values[after])
    fresh = np.concatenate([[True], np.diff(at) > 0])
    return np.where(near & ~before, values, np.nan), np.where(fresh & ~before, one.rows[at], -1)


def _nearest(stamps: IntArray, ns: IntArray) -> IntArray:
    right = np.clip(np.searchsorted(stamps, ns), 1, max(stamps.size - 1, 1))
    right = np.minimum(right, stamps.size - 1)
    left = np.maximum(right - 1, 0)
    return np.where(ns - stamps[left] <= stamps[right] - ns, left, right)


def _grids(stamps: IntArray, step_ns: float) -> IntArray:
    """Even stamps over every stretch without a long gap."""
    first = np.concatenate([[0], np.flatnonzero(np.diff(stamps) > (MAX_FILLED + 1) * step_ns) + 1])
    last = np.concatenate([first[1:], [stamps.size]]) - 1
    counts = ((stamps[last] - stamps[first]) // step_ns).astype(np.int64) + 1
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.asarray(np.repeat(stamps[first], counts) + np.rint(within * step_ns).astype(np.int64))


def resample(frame: Frame, step_ns: float) -> IntArray:
    """Put irregular stamps onto even grids, in place: PV by straight lines over short gaps, held signals held.

    A gap too long to be filled ends a grid, and the next begins at the first stamp behind it. A clock that was wrong
    once by years then makes no million empty samples.

    Returns the rows (of the first source) that no grid sample represents.
    """
    ns = _grids(frame.ns, step_ns)
    at = np.searchsorted(frame.ns, ns, side="right") - 1
    base = GridStep(step_ns, "irregular")
    values = {}
    for role, own in frame.values.items():
        if role in ("output", "setpoint", "mode"):
            values[role] = own[at]
            frame.on_change.add(role)
        else:
            known = ~np.isnan(own)
            if not known.any():
                values[role] = np.full(ns.size, np.nan)
                continue
            one = Series(frame.ns[known], own[known], np.flatnonzero(known))
            place = np.maximum(np.searchsorted(one.ns, ns, side="right") - 1, 0)
            values[role], _ = _between(ns, one, place, ns < one.ns[0], base)
    fresh = np.concatenate([[True], np.diff(at) > 0])
    left_out = np.setdiff1d(np.arange(frame.ns.size), at)
    frame.rows = [np.where(fresh, r[at], -1) for r in frame.rows]
    frame.reason = np.where(fresh, frame.reason[at], 0).astype(np.uint8)
    frame.ns, frame.values = ns, values
    return left_out
