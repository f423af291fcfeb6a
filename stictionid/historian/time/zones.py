"""Local time to UTC, for a zone given by the user; the order of rows settles the hour that occurs twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa

from ...errors import UsageError
from ...typing import IntArray
from ..bytes.arrow import integers, timestamps
from ..words.cells import shown
from .clock import Times


def apply_zone(times: Times, zone: str | None, keep: IntArray) -> Times:
    """Naive local stamps of rows `keep` as UTC; stamps with a zone of their own and elapsed times stay."""
    if zone is None or times.elapsed or times.zone is not None:
        return times
    local = times.ns[keep]
    early, late = _to_utc(local, zone)
    newest_first = local.size > 1 and np.count_nonzero(np.diff(local) < 0) > 0.5 * local.size
    order = slice(None, None, -1) if newest_first else slice(None)
    utc = _unfold(local[order], early[order], late[order])[order]
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


def _unfold(local: IntArray, early: IntArray, late: IntArray) -> IntArray:
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
