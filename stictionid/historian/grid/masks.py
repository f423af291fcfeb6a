"""Masks of samples that do not count: manual, saturated, frozen and start-up stretches."""

from __future__ import annotations

import numpy as np

from ...numerics.archived import runs_of
from ...typing import BoolArray, FloatArray
from ..words.modes import CONTROLLING, Modes
from .grid import Frame, long_runs

MIN_SATURATED_RUN = 3
"""Samples in a row at the limit before OP counts as clamped."""
MIN_FROZEN_RUN = 20
"""Samples in a row in which nothing changes before the record counts as frozen."""
FROZEN_FACTOR = 5
"""A frozen run is at least this many times longer than the longest usual one (95 % of all runs)."""
MIN_LIVELY_SHARE = 0.5
"""Share of samples at which a live PV changes; below it (coarse PV) silence is no sign of a frozen record."""
MIN_MOVING_SHARE = 0.05
"""Share of samples at which OP must move for a mode of unknown meaning to count as controlling."""
FAR = 3.0
"""Distance from the usual range, in widths of it, at which a loop is not where it is run."""
MIN_STARTUP_RUN = 10
"""Samples off the range of a record, at its begin or end, before they count as start-up or shut-down."""
LIMITS = ((-6.9, 106.9), (-5.0, 105.0), (0.0, 100.0))
"""Limits at which controllers clamp their output, %."""


def manual(frame: Frame, modes: Modes | None) -> tuple[BoolArray, dict[str, int]]:
    """True (n,) where the controller does not control; number of samples of each unclear mode.

    A mode of unknown meaning counts as controlling only where OP moves in it, and is always reported.
    """
    off = np.zeros(frame.ns.size, np.bool_)
    unclear: dict[str, int] = {}
    codes = frame.values.get("mode")
    if modes is None or codes is None:
        return off, unclear
    op = frame.values["output"]
    # With one mode throughout, the mode can't distinguish samples.
    single = np.unique(codes[~np.isnan(codes)]).size == 1
    for code, (word, meaning) in enumerate(zip(modes.words, modes.meaning, strict=True)):
        here = codes == code
        if not here.any() or meaning in CONTROLLING:
            continue
        if meaning == "UNKNOWN":
            unclear[word] = int(np.count_nonzero(here))
            moves = np.count_nonzero(np.diff(op[here]) != 0)
            if single or moves > MIN_MOVING_SHARE * here.sum():
                continue
        off |= here
    return off, unclear


def saturated(op: FloatArray, *, percent: bool) -> BoolArray:
    """True (n,) where OP stays at its limit."""
    if not percent or not op.size or np.isnan(op).all():
        return np.zeros(op.size, np.bool_)
    low, high = float(np.nanmin(op)), float(np.nanmax(op))
    clamp = np.zeros(op.size, np.bool_)
    for below, above in LIMITS:
        at = ((op == low) & (abs(low - below) < 0.05)) | ((op == high) & (abs(high - above) < 0.05))
        clamp |= long_runs(at, MIN_SATURATED_RUN)
    return clamp


def frozen(frame: Frame) -> BoolArray:
    """True (n,) where every signal is constant far longer than elsewhere, in a record with live noise."""
    pv, op = frame.values["process_value"], frame.values["output"]
    n = pv.size
    none = np.zeros(n, np.bool_)
    if n < 3 * MIN_FROZEN_RUN:
        return none
    still = (np.diff(pv) == 0) & (np.diff(op) == 0)
    long = long_runs(still, MIN_FROZEN_RUN)
    if not 0 < long.sum() <= 0.8 * n:
        return none
    if np.mean(~still[~long]) < MIN_LIVELY_SHARE or not _noisy(pv, ~long):
        return none
    first, end = runs_of(still & ~long)
    usual = (end - first).max(initial=1)
    return np.concatenate([[False], long_runs(still, max(MIN_FROZEN_RUN, FROZEN_FACTOR * usual))])


def startup(frame: Frame) -> BoolArray:
    """True (n,) during a start-up: from a first sample far outside the later range of PV until PV first reaches it.

    Far means several widths of that range away. OP must also rest, be shut, fully open, or be as far outside its own
    range. The response to a setpoint step is then not taken for a start-up. Backwards in time it is a shut-down.
    """
    found = np.zeros(frame.ns.size, np.bool_)
    for way in (1, -1):
        end = _off_range(frame.values["process_value"][::way], frame.values["output"][::way])
        found[::way][:end] = True
    return found


def _off_range(pv: FloatArray, op: FloatArray) -> int:
    """Number of samples at the start of the record that are start-up; 0 for none."""
    n = pv.size
    if n < 3 * MIN_STARTUP_RUN:
        return 0
    later = slice(n // 3, None)
    if _within(pv[:MIN_STARTUP_RUN], pv[later], FAR).any():
        return 0
    end = int(np.argmax(_within(pv, pv[later], 0.0)))
    if not MIN_STARTUP_RUN <= end <= n // 3:
        return 0
    first = op[:end]
    idle = np.concatenate([[False], np.diff(first) == 0]) | (first <= 0.0) | (first >= 100.0)
    idle |= ~_within(first, op[later], FAR)
    return end if np.mean(idle) > 0.5 else 0


def _within(values: FloatArray, usual: FloatArray, wide: float) -> BoolArray:
    """True where values lie within the range of others, widened by a factor; unknown values count as inside."""
    known = usual[~np.isnan(usual)]
    if not known.size:
        return np.ones(values.size, np.bool_)
    low, high = (float(v) for v in np.quantile(known[::max(1, known.size // 200_000)], [0.005, 0.995]))
    room = wide * (high - low) + 1e-9 * max(abs(low), abs(high))
    return np.asarray(np.isnan(values) | ((values >= low - room) & (values <= high + room)))


def _noisy(pv: FloatArray, outside: BoolArray) -> bool:
    """True where a signal has noise from sample to sample; without noise a record at rest is not taken for frozen."""
    steps = np.abs(np.diff(pv))[outside]
    bends = np.abs(np.diff(pv, 2))[outside[1:]]
    return bool(steps.size and np.median(bends) > 0.5 * np.median(steps) > 0)
