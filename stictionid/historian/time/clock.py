"""Stamps of rows and their time order: newest first, out of order, duplicates, seconds dropped, clocks set back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...typing import BoolArray, IntArray

SECOND = 1_000_000_000
_HOUR = 3600 * SECOND
_MINUTE = 60 * SECOND
EARLIEST_NS, LATEST_NS = -2_240_000_000 * SECOND, 6_900_000_000 * SECOND
"""1899 to 2188, or 71 years before and 218 after an arbitrary zero: differences of such stamps fit 64 bits."""


@dataclass(frozen=True, slots=True)
class Times:
    """Stamps of all rows: `ns` (n,) since the epoch, or since zero where `elapsed`; `valid` (n,) False for no time."""

    ns: IntArray
    valid: BoolArray
    elapsed: bool
    text: str
    zone: str | None = None
    assumptions: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Order:
    """Rows `index` (m,) in time order, their stamps `ns` (m,), `duplicates` left out, and counts of corrections."""

    index: IntArray
    ns: IntArray
    duplicates: IntArray
    newest_first: bool = False
    out_of_order: int = 0
    spread: int = 0
    folded: int = 0


def put_in_order(
    ns: IntArray, *, elapsed: bool, zoned: bool, worth: Callable[[], NDArray[np.float64]] | None = None
) -> Order:
    """Rows in time order without duplicates: of several rows with one stamp the best wins, of equals the last written.

    `worth` gives the rank of each row; it is called only where stamps repeat.
    """
    index = np.arange(ns.size)
    steps = np.diff(ns)
    if steps.size == 0 or (steps > 0).all():
        return Order(index, ns, index[:0])
    newest_first = bool(np.count_nonzero(steps < 0) > 0.5 * steps.size)
    if newest_first:
        index, ns = index[::-1], ns[::-1]
        steps = np.diff(ns)
    spread = _spread_minutes(ns, steps)
    if spread:
        ns = _spread(ns)
        return Order(index, ns, index[:0], newest_first, spread=spread)
    folded = 0
    if not elapsed and not zoned:
        ns, folded = _unfold(ns, steps)
        steps = np.diff(ns)
    out_of_order = int(np.count_nonzero(steps < 0))
    if out_of_order:
        order = np.argsort(ns, kind="stable")
        index, ns = index[order], ns[order]
    if worth is not None and (np.diff(ns) == 0).any():
        order = np.lexsort((worth()[index], ns))
        index, ns = index[order], ns[order]
    # Newest-first files list the last value of a stamp first; either way the one written last wins.
    same = np.concatenate([np.diff(ns) == 0, [False]])
    return Order(index[~same], ns[~same], index[same], newest_first, out_of_order, folded=folded)


def _spread_minutes(ns: IntArray, steps: IntArray) -> int:
    """Rows per minute when a display dropped the seconds (every stamp a whole minute, repeated alike), else 0."""
    if (ns % _MINUTE).any() or (steps < 0).any():
        return 0
    counts = np.diff(np.flatnonzero(np.concatenate([[True], steps > 0, [True]])))
    if counts.size < 3:
        return 0
    inner = counts[1:-1]
    usual = int(np.median(inner))
    return usual if usual >= 2 and np.mean(inner == usual) > 0.8 and 60 % usual == 0 else 0


def _spread(ns: IntArray) -> IntArray:
    """Stamps of the rows of each minute spread evenly over it; the record may begin late in the first minute."""
    new = np.concatenate([[True], np.diff(ns) > 0])
    first = np.flatnonzero(new)
    counts = np.diff(np.concatenate([first, [ns.size]]))
    usual = int(np.median(counts))
    within = np.arange(ns.size) - np.repeat(first, counts)
    within[: counts[0]] += max(usual - int(counts[0]), 0)
    per_row = np.repeat(np.maximum(counts, usual), counts)
    return ns + within * _MINUTE // per_row


def _unfold(ns: IntArray, steps: IntArray) -> tuple[IntArray, int]:
    """Stamps after a clock that went back one hour (end of daylight saving time), moved on by that hour."""
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    back = np.flatnonzero(steps < 0)
    if back.size != 1 or usual >= _HOUR or abs(steps[back[0]] + _HOUR - usual) > 0.5 * usual:
        return ns, 0
    at = int(back[0]) + 1
    if ns[at:].size * usual < _MINUTE:
        return ns, 0
    return np.concatenate([ns[:at], ns[at:] + _HOUR]), int(ns.size - at)
