"""Stamps of rows, their time order and their zone: newest first, duplicates, seconds dropped, clocks set back.

Local time becomes UTC for a zone that the user gives; the order of rows settles the hour that occurs twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ...errors import UsageError
from ...typing import BoolArray, IntArray
from ..bytes.arrow import integers, timestamps
from ..words.cells import shown

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


def apply_zone(times: Times, zone: str | None, keep: IntArray) -> Times:
    """Naive local stamps of rows `keep` as UTC; stamps with a zone of their own and elapsed times stay."""
    if zone is None or times.elapsed or times.zone is not None:
        return times
    local = times.ns[keep]
    early, late = _to_utc(local, zone)
    newest_first = local.size > 1 and np.count_nonzero(np.diff(local) < 0) > 0.5 * local.size
    order = slice(None, None, -1) if newest_first else slice(None)
    utc = _ordered(local[order], early[order], late[order])[order]
    ns = times.ns.copy()
    ns[keep] = utc
    return replace(times, ns=ns, zone=zone)


def check_zone(zone: str) -> None:
    """UsageError for an unknown time zone."""
    _to_utc(np.zeros(1, dtype=np.int64), zone)


def _to_utc(local: IntArray, zone: str) -> tuple[IntArray, IntArray]:
    """Local stamps as UTC, in ns: the earlier and the later one where the clock shows the same hour twice."""
    import pyarrow.compute as pc

    array = timestamps(local)
    try:
        early, late = (
            integers(
                pc.assume_timezone(array, zone, ambiguous=side, nonexistent="earliest")
                .cast(pa.timestamp("ns", "UTC"))
                .cast(pa.int64())
            )[0]
            for side in ("earliest", "latest")
        )
    except (pa.ArrowInvalid, pa.ArrowKeyError, ValueError):
        raise UsageError(
            f"time zone {shown(zone)} is unknown", "use a name such as Europe/Berlin or America/Chicago"
        ) from None
    return early, late


def _ordered(local: IntArray, early: IntArray, late: IntArray) -> IntArray:
    """UTC of each row: in the doubled hour the earlier one until the local clock steps back, then the later one."""
    utc = early.copy()
    doubled = np.flatnonzero(early != late)
    if not doubled.size:
        return utc
    for piece in np.split(doubled, np.flatnonzero(np.diff(doubled) > 1) + 1):
        back = np.flatnonzero(np.diff(local[piece]) < 0)
        if back.size:
            second = piece[back[0] + 1 :]
            utc[second] = late[second]
        elif piece[0] > 0 and utc[piece[0] - 1] >= early[piece[0]]:
            utc[piece] = late[piece]
    return utc
