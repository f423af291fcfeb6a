"""Time stamps as nanoseconds: the format of a column is decided over all its rows, or the column is refused.

Text goes through Arrow's ISO parser, else through one of a few patterns applied to the whole column. Numbers are
elapsed time, epoch (s, ms, µs, ns), Excel serials or FILETIME, told apart by their size.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ...errors import DataError
from ...typing import BoolArray, IntArray
from ..bytes.arrow import floats, integers, whole
from ..words.cells import shown
from .clock import EARLIEST_NS, LATEST_NS, SECOND, Times
from .datetext import parse_text

Place = Callable[[int], str]
"""Words for file, line and column of a row."""
_EXCEL_EPOCH_S = -2_209_161_600
"""1899-12-30 00:00 in epoch seconds: day 0 of Excel serials."""
_EXCEL_1904_S = -2_082_844_800
"""1904-01-01 00:00 in epoch seconds: day 0 of Excel for old Macintosh."""
_FILETIME_S = -11_644_473_600
"""1601-01-01 in epoch seconds: zero of Windows FILETIME (100 ns units)."""
_UNITS_S = {
    "s": 1.0,
    "sec": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "min": 60.0,
    "minutes": 60.0,
    "m": 60.0,
    "h": 3600.0,
    "hr": 3600.0,
    "hours": 3600.0,
    "ms": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "ns": 1e-9,
    "d": 86400.0,
    "days": 86400.0,
}
_EPOCHS = (
    (5e8, 1e10, 1.0, "epoch seconds"),
    (5e11, 1e13, 1e-3, "epoch milliseconds"),
    (5e14, 1e16, 1e-6, "epoch microseconds"),
    (5e17, 1e19, 1e-9, "epoch nanoseconds"),
)
"""Numbers from 1985 on (5e8 s) in each unit: ranges that do not overlap; elapsed time stays below 5e8 s (15 years)."""
_FILETIME = (1.2e17, 1.8e17)
"""FILETIME of 1981 to 2171."""
_EXCEL = (20_000.0, 80_000.0)
"""Excel serials of 1954 to 2119, days."""

FORMATS = ("iso", "dmy", "mdy", "ymd", "epoch", "excel", "excel1904", "filetime", "seconds")
"""Words for `--time-format`."""


def parse_times(
    columns: list[Any], name: str, unit: str, *, dayfirst: bool | None, time_format: str | None, place: Place
) -> Times:
    """The stamps in one column, or in a date and a clock column. DataError where days and months can't be told."""
    column = whole(columns[0]) if len(columns) == 1 else _joined([whole(c) for c in columns])
    kind = column.type
    if pa.types.is_timestamp(kind):
        text = "ISO 8601 time stamps" if not kind.tz else f"time stamps in {kind.tz}"
        return Times(*_in_ns(column), False, text, kind.tz)
    if pa.types.is_date(kind):
        return Times(*_in_ns(column.cast(pa.timestamp("s"))), False, "dates without a time of day")
    if pa.types.is_time(kind):
        return _clock(column)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return _numeric(column, name, unit, time_format, place)
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        raise DataError(f"{place(0)}: {kind} is no time", "name the time column with --time")
    return parse_text(column, dayfirst=dayfirst, time_format=time_format, place=place)


def _joined(parts: list[Any]) -> Any:
    """Date and time of day as one column."""
    import pyarrow.compute as pc

    date, clock = parts
    if pa.types.is_date(date.type) and pa.types.is_time(clock.type):
        days = date.cast(pa.date32()).cast(pa.int32()).cast(pa.int64())
        ns = clock.cast(pa.time64("ns")).cast(pa.int64())
        return pc.add(pc.multiply(days, 86_400 * SECOND), ns).cast(pa.timestamp("ns"))
    return pc.binary_join_element_wise(date.cast(pa.string()), clock.cast(pa.string()), " ")


_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


def _in_ns(column: Any) -> tuple[IntArray, BoolArray]:
    """Arrow time stamps of any unit in ns, and a mask of those that are present and within the accepted years."""
    per_second = _PER_SECOND[column.type.unit]
    whole, valid = integers(column.cast(pa.int64()))
    valid = valid & (whole > EARLIEST_NS // SECOND * per_second) & (whole < LATEST_NS // SECOND * per_second)
    return np.where(valid, whole, 0) * (SECOND // per_second), valid


def _clock(column: Any) -> Times:
    """A clock without dates, which starts again at midnight."""
    ns, valid = integers(column.cast(pa.time64("ns")).cast(pa.int64()))
    # Each step back of more than half a day is a new day.
    days = np.concatenate([[0], np.cumsum(np.diff(ns) < -43_200 * SECOND)])
    return Times(
        ns + days * 86_400 * SECOND,
        valid,
        True,
        "time of day without a date",
        assumptions=("time of day without a date: days counted at midnight",) if days[-1] else (),
    )


def _numeric(column: Any, name: str, unit: str, time_format: str | None, place: Place) -> Times:
    """A column of numbers: elapsed time, epoch, serial days or FILETIME."""
    if pa.types.is_integer(column.type):
        whole, valid = integers(column if column.type == pa.int64() else column.cast(pa.int64(), safe=False))
        numbers = whole.astype(np.float64)
    else:
        numbers = floats(column)
        valid = np.abs(numbers) < 1e20  # a FILETIME is 1e17; False for NaN as well
        numbers = np.where(valid, numbers, 0.0)
        whole = None
    if not valid.any():
        raise DataError(f"{place(0)}: no time stamp at all", "name the time column with --time, or give --step SECONDS")
    words, scale, offset = _numeric_kind(numbers[valid], name, unit, time_format)
    elapsed = bool(np.isnan(offset))
    zero = 0 if elapsed else int(offset)
    seconds = numbers * scale + zero
    valid = valid & (seconds > EARLIEST_NS / SECOND) & (seconds < LATEST_NS / SECOND)
    numbers, whole = np.where(valid, numbers, 0.0), None if whole is None else np.where(valid, whole, 0)
    if whole is not None and scale <= 1.0:
        # Whole numbers are scaled as integers: a nanosecond epoch does not fit a float, nor 1601 a 64-bit nanosecond.
        per_second = round(1 / scale)
        ns = (whole - np.int64(-zero * per_second) if zero else whole) * np.int64(SECOND // per_second)
    else:
        ns = np.rint(np.where(valid, numbers * (scale * SECOND) + float(zero) * SECOND, 0.0)).astype(np.int64)
        if scale >= 60.0:
            # Days in a float resolve about a microsecond, in text often less; rounded to ms the stamps are even again.
            ns = np.rint(ns / 1e6).astype(np.int64) * 1_000_000
    zone = None if elapsed or not words.startswith("epoch") else "UTC"
    said = elapsed or time_format is not None
    return Times(ns, valid, elapsed, words, zone, () if said else (f"time column read as {words} (--time-format)",))


def _numeric_kind(
    numbers: NDArray[np.float64], name: str, unit: str, time_format: str | None
) -> tuple[str, float, float]:
    """(words, seconds per unit, epoch offset or NaN for elapsed time) of a numeric time column."""
    middle = float(np.median(numbers))
    if time_format in ("excel", "excel1904"):
        return f"{time_format} serial days", 86400.0, _EXCEL_EPOCH_S if time_format == "excel" else _EXCEL_1904_S
    if time_format == "filetime" or (time_format is None and _FILETIME[0] < middle < _FILETIME[1]):
        return "Windows FILETIME", 1e-7, _FILETIME_S
    if time_format in (None, "epoch"):
        for low, high, scale, words in _EPOCHS:
            if low <= middle < high:
                return words, scale, 0.0
        if time_format == "epoch":
            return "epoch seconds", 1.0, 0.0
    said = _unit_of(name, unit)
    if 1.9e7 < middle < 2.2e7 and time_format is None and not said:
        raise DataError(
            f"the time column {shown(name)} holds dates like {middle:.0f} without a time of day",
            "export the time of day as well, or give --step SECONDS",
        )
    steps = np.diff(numbers[:100_000])
    in_days = _EXCEL[0] < middle < _EXCEL[1] and (steps.size == 0 or np.median(np.abs(steps)) < 0.5)
    if in_days and said is None and time_format is None:
        return "Excel serial days", 86400.0, _EXCEL_EPOCH_S
    seconds = _UNITS_S[said] if said and time_format is None else 1.0
    return f"elapsed time in {said or 's'}", seconds, float("nan")


def _unit_of(name: str, unit: str) -> str | None:
    """Unit of a numeric time column, from its unit cell or the end of its name, or None."""
    last = re.split(r"[\[(_ ]", re.sub(r"[\])]", "", name.strip().lower()))[-1]
    for word in (unit.strip().lower(), last):
        if word in _UNITS_S and not (word == "m" and word != unit):
            return word
    return "s" if last in ("t", "elapsed") or name.strip().lower() in ("t", "seconds", "sec") else None
