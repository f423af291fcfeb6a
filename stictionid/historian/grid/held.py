"""A tag that is recorded less often than the other and repeated in between.

Of a PV only fresh values are measurements: the valve runs on OP at its own step, and the cost counts where PV is fresh.
Taken for measurements, the repeats would lengthen the dead time by half the distance of the fresh values. An OP that
rests between its changes sets the step of the record: a valve law that sees each command ten times stops ten times.
Wrong where a transmitter is so coarse that its PV changes at even distances by chance. Source: docs/traps.md, export
trap 15.
"""

from __future__ import annotations

import numpy as np

from ...typing import BoolArray, FloatArray, IntArray
from .grid import Frame, GridStep

FEWEST_MOVES = 20
"""Changes needed before "always at the same phase" means anything."""
MOST_REPEATS = 60
"""Longest repetition looked for, samples: one value a minute recorded every second."""
MIN_REGULAR, MIN_PHASE = 0.5, 0.98
"""Least share of the fresh places at which the tag changes, and least share of its changes that are at fresh places."""


def repeats(frame: Frame, step: GridStep) -> tuple[int, BoolArray]:
    """Number of samples k from one fresh PV to the next, and mask (n,) of those that only repeat; 1 and none without.
    """
    every, fresh = _rhythm(frame, step, "process_value", "output")
    fresh[_changes(frame, "process_value")] = True
    return every, ~fresh & ~np.isnan(frame.values["process_value"]) & ~np.isnan(frame.values["output"])


def slower_output(frame: Frame, step: GridStep) -> tuple[int, BoolArray, tuple[float, float]]:
    """Number of samples k from one change of OP to the next, mask (n,) of the places of change, and errors of two laws.

    k is 1 where OP is no slower than PV. The errors are those of `law_errors`.
    """
    every, fresh = _rhythm(frame, step, "output", "process_value")
    at = np.flatnonzero(fresh)
    if every == 1 or (np.diff(_places(frame, step)) != 1).any():
        return every, fresh, (1.0, 1.0)
    error = frame.values["process_value"].copy()
    if "setpoint" in frame.values and not np.isnan(frame.values["setpoint"]).all():
        error -= frame.values["setpoint"]
    return every, fresh, law_errors(frame.values["output"], error, at, every)


def law_errors(output: FloatArray, error: FloatArray, at: IntArray, every: int) -> tuple[float, float]:
    """Errors of a PI law for the changes of OP, as shares of their size.

    The first is that of a controller that sees only the samples `at` which OP changes, the second that of one that adds
    up all samples in between.
    """
    change, law = np.diff(output[at]), np.diff(error[at])
    summed = np.convolve(error, np.ones(every))[at[1:]]
    found = []
    for added in (error[at[1:]], summed):
        columns = np.stack([np.ones(change.size), law, added], axis=1)
        good = np.isfinite(columns).all(axis=1) & np.isfinite(change)
        if good.sum() < FEWEST_MOVES or not np.ptp(change[good]):
            return 1.0, 1.0
        scale = np.maximum(np.abs(columns[good]).max(axis=0), 1e-300)
        fit, *_ = np.linalg.lstsq(columns[good] / scale, change[good], rcond=1e-10)
        found.append(float(np.std(change[good] - columns[good] / scale @ fit) / np.std(change[good])))
    return found[0], found[1]


def _rhythm(frame: Frame, step: GridStep, role: str, other: str) -> tuple[int, BoolArray]:
    """Number of samples from one change of a signal to the next, and mask (n,) of their places; 1 and all without.

    The other signal must change in between at least as often: otherwise the whole record has the longer step
    (`ladder`).
    """
    n = frame.ns.size
    moves = _changes(frame, role)
    if moves.size < FEWEST_MOVES:
        return 1, np.ones(n, np.bool_)
    place = _places(frame, step)
    for every in range(min(MOST_REPEATS, n // FEWEST_MOVES), 1, -1):
        phase = int(np.bincount(place[moves] % every, minlength=every).argmax())
        fresh = place % every == phase
        if np.mean(fresh[moves]) < MIN_PHASE or moves.size < MIN_REGULAR * fresh.sum():
            continue
        if np.sum(~fresh[_changes(frame, other)]) < moves.size:
            break
        return every, fresh
    return 1, np.ones(n, np.bool_)


def _places(frame: Frame, step: GridStep) -> IntArray:
    """Places (n,) on the even grid, gaps counted: a tag keeps its rhythm through them."""
    return np.rint((frame.ns - frame.ns[0]) / step.ns).astype(np.int64)


def _changes(frame: Frame, role: str) -> IntArray:
    """Samples at which a signal differs from its last value; missing values and the starts of stretches are none."""
    values = frame.values[role]
    there = np.flatnonzero(~np.isnan(values))
    changed = there[1:][np.diff(values[there]) != 0.0]
    return np.asarray(np.setdiff1d(changed, frame.starts), np.int64)
