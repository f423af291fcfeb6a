"""Signals that repeat or do not vary, and the list of all tests for spoilt data."""

from __future__ import annotations

import numpy as np

from ...record.loop import Finding
from ..grid.grid import Frame
from ..grid.held import FEWEST_MOVES, MOST_REPEATS
from ..words.findings import finding
from .averages import averaged
from .texture import Signals, clipped, identical, quantised, re_ranged, swapped, thinned

MAX_JUDGED = 500_000
"""Number of samples from the start on which texture is judged; more carry no further information."""
MIN_JUDGED = 60
"""Number of samples below which texture is not judged: shares of so few are unreliable."""
DEAD_SPAN = 1e-9
"""Span below this share of the magnitude is rounding noise, not a signal."""
TINY = 1e-30
"""Magnitudes below are denormal rubbish of single-precision registers (3.5E-44), not measurements."""


def ladder(frame: Frame) -> tuple[int, int]:
    """(k, phase) where every signal changes at every k-th sample only; (1, 0) otherwise."""
    changed = np.zeros(frame.ns.size - 1, np.bool_)
    each = []
    for values in (frame.values["process_value"], frame.values["output"]):
        moves = np.diff(values) != 0
        moves &= ~(np.isnan(values[1:]) & np.isnan(values[:-1]))
        each.append(int(moves.sum()))
        changed |= moves
    at = np.flatnonzero(changed) + 1
    if min(each) < FEWEST_MOVES or at.size > 0.55 * frame.ns.size:
        return 1, 0
    every = int(np.gcd.reduce(np.diff(at)))
    if not 2 <= every <= MOST_REPEATS or at.size < 0.5 * frame.ns.size / every:
        return 1, 0
    return every, int(at[0] % every)


def spoilt_findings(
    loop: Signals, *, name_hints: list[str], names: dict[str, str], fractions: float = 0.0
) -> list[Finding]:
    """Findings of all tests on the signals; `caps_verdict` forbids a sure verdict."""
    found = _dead(loop)
    if found or loop.output.size < MIN_JUDGED:
        return found
    part = loop.head(MAX_JUDGED)
    tests = (identical(part, names) or swapped(part, names), *thinned(part), averaged(part, name_hints, fractions),
             re_ranged(loop), *quantised(part), clipped(part))
    return [told for told in tests if told is not None]


def _dead(loop: Signals) -> list[Finding]:
    """Findings on signals that have no variation beyond rounding."""
    found = []
    for role, values in (("process value", loop.process_value), ("output", loop.output)):
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        size = max(abs(low), abs(high))
        if size < TINY or high - low <= DEAD_SPAN * size:
            found.append(finding("dead-signal", {"low": low, "high": high}, role=role, low=low, high=high))
    return found
