"""Rows of an input, a DataFrame or a file: the sample that each became, and its time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..typing import IntArray

if TYPE_CHECKING:
    from ..historian.reading import Reading

_SECOND_NS = 1e9


@dataclass(frozen=True, slots=True)
class InputRows:
    """Rows of an input: the sample that each became (rows,), -1 for none, and their times.

    `time` holds one value for each row: stamps, or seconds where the input has no calendar. `name` is its column.
    """

    sample: IntArray
    time: Any
    name: str = "time"


def rows_behind(reading: Reading, count: int, own: Any) -> InputRows:
    """The input rows of a reading; `own` is the time of each as the caller has it, None for the times that were read.
    """
    sample = np.full(count, -1)
    for rows in reading.behind:
        there = np.flatnonzero(rows >= 0)
        sample[rows[there]] = there
    name = reading.columns.get("time") or "time_s"
    if own is not None:
        return InputRows(sample, own, str(getattr(own, "name", None) or name))
    stamps = reading.stamps
    if stamps is None:
        time = np.where(sample >= 0, reading.loop.clock_s[sample], np.nan)
        return InputRows(sample, time, "time_s")
    if stamps.elapsed:
        return InputRows(sample, np.where(stamps.valid, stamps.ns / _SECOND_NS, np.nan), name)
    return InputRows(sample, np.where(stamps.valid, stamps.ns.astype("datetime64[ns]"), np.datetime64("NaT")), name)
