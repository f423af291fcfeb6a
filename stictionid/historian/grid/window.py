"""Time window of a record (--start and --end), and the text form of stamps."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from datetime import time as clock_time

import numpy as np

from ...errors import DataError, UsageError
from ...typing import BoolArray
from ..time.clock import SECOND
from ..words.cells import shown
from .grid import Frame

_NUMBER = re.compile(r"\s*\d+(?:\.\d+)?\s*\Z")


def outside(frame: Frame, start: str | None, end: str | None, *, elapsed: bool) -> BoolArray:
    """True (n,) for the samples of a frame outside start ≤ time ≤ end. DataError where none is inside.

    A bound is a time stamp, a time of day (of the first day), or seconds since the first row.
    """
    if (start is None and end is None) or not frame.ns.size:
        return np.zeros(frame.ns.size, np.bool_)
    first, last = int(frame.ns[0]), int(frame.ns[-1])
    low = first if start is None else _bound(start, "--start", first, elapsed)
    high = last if end is None else _bound(end, "--end", first, elapsed)
    if high <= low:
        raise UsageError(
            f"--start {start} is not before --end {end}"
            if start and end
            else f"--{'start ' + str(start) if start else 'end ' + str(end)} leaves nothing of the record, from "
            f"{stamp_text(first, elapsed, None)} to {stamp_text(last, elapsed, None)}",
            "give a window inside the record",
        )
    left_out = (frame.ns < low) | (frame.ns > high)
    if left_out.all():
        raise DataError(
            f"no row lies between {stamp_text(low, elapsed, None)} and {stamp_text(high, elapsed, None)}; "
            f"the record runs from "
            f"{stamp_text(first, elapsed, None)} to {stamp_text(last, elapsed, None)}",
            "change --start or --end",
        )
    return left_out


def check_bound(text: str, flag: str) -> None:
    """UsageError for a text that can be no bound of any record."""
    _bound(text, flag, 0, False)


def _bound(text: str, flag: str, first: int, elapsed: bool) -> int:
    if _NUMBER.match(text):
        return first + round(float(text) * SECOND)
    if elapsed:
        raise UsageError(
            f"{flag} {shown(text)} is a time stamp, but the file only has seconds", "give seconds since the first row"
        )
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        try:
            day = datetime(1970, 1, 1) + timedelta(seconds=first // SECOND)
            moment = datetime.combine(day.date(), clock_time.fromisoformat(text.strip()))
        except ValueError:
            raise UsageError(
                f"{flag} {shown(text)} is no time", "use 2024-05-31T14:00:00, 14:00:00, or seconds since the first row"
            ) from None
    if moment.tzinfo is not None:
        moment = moment.astimezone(UTC).replace(tzinfo=None)
    return int((moment - datetime(1970, 1, 1)) / timedelta(microseconds=1)) * 1000


def stamp_text(ns: int, elapsed: bool, zone: str | None) -> str:
    """A stamp in ISO 8601 (with Z where it is UTC), or seconds where the file has no calendar."""
    if elapsed:
        return f"{ns / SECOND:.9g} s"
    text = str(np.datetime64(ns, "ns"))
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return text + ("Z" if zone is not None else "")
