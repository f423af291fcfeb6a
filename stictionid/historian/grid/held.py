"""A PV that is recorded less often than OP and repeated in between: only its fresh values are measurements.

The valve runs on OP at its own step, and the cost counts where PV is fresh. Taken for measurements, the repeats would
lengthen the dead time by half the distance of the fresh values. Wrong where a transmitter is so coarse that its PV
changes at even distances by chance. Source: HISTORIAN.md 3.15.
"""

from __future__ import annotations

import numpy as np

from ...typing import BoolArray, IntArray
from .grid import Frame, GridStep

FEWEST_MOVES = 20
"""Changes of PV needed before "always at the same phase" means anything."""
MOST_REPEATS = 60
"""Longest repetition looked for, samples: one value a minute beside an OP every second."""
MIN_REGULAR, MIN_PHASE = 0.5, 0.98
"""Least share of the fresh places at which PV changes, and least share of its changes that are at fresh places."""


def repeats(frame: Frame, step: GridStep) -> tuple[int, BoolArray]:
    """Number of samples k from one fresh PV to the next, and mask (n,) of those that only repeat; 1 and none without.

    OP must change between the fresh values at least as often as PV does: otherwise the whole record has the longer
    step (`ladder`).
    """
    pv, op = frame.values["process_value"], frame.values["output"]
    none = np.zeros(pv.size, np.bool_)
    moves = _changes(frame, "process_value")
    if moves.size < FEWEST_MOVES:
        return 1, none
    # Gaps are counted in the phase: a tag keeps its rhythm through them.
    place = np.rint((frame.ns - frame.ns[0]) / step.ns).astype(np.int64)
    for every in range(min(MOST_REPEATS, pv.size // FEWEST_MOVES), 1, -1):
        phase = int(np.bincount(place[moves] % every, minlength=every).argmax())
        fresh = place % every == phase
        if np.mean(fresh[moves]) < MIN_PHASE or moves.size < MIN_REGULAR * fresh.sum():
            continue
        if np.sum(~fresh[_changes(frame, "output")]) < moves.size:
            return 1, none
        fresh[moves] = True
        return every, ~fresh & ~np.isnan(pv) & ~np.isnan(op)
    return 1, none


def _changes(frame: Frame, role: str) -> IntArray:
    """Samples at which a signal differs from its last value; missing values and the starts of stretches are none."""
    values = frame.values[role]
    there = np.flatnonzero(~np.isnan(values))
    changed = there[1:][np.diff(values[there]) != 0.0]
    return np.asarray(np.setdiff1d(changed, frame.starts), np.int64)
