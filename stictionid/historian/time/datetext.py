"""Dates as text: one pattern for the whole column; all rows together decide on day and month, or it is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa

from ...errors import DataError
from ...typing import BoolArray, IntArray
from ..bytes.arrow import booleans, coded, integers
from ..words.cells import shown
from .clock import EARLIEST_NS, LATEST_NS, SECOND, Times

CENTURY_PIVOT = 69
"""Two-digit years below are 20xx, others 19xx: the POSIX rule of strptime."""
MIN_MATCHING = 0.5
"""Share of cells that must fit a pattern for a column to be a time column."""

_SPELLINGS = (
    "jan january januar jänner janvier janv ene enero gen gennaio янв января январь",
    "feb february februar février févr fév febrero febbraio фев февраля февр",
    "mar march mär märz mrz maerz mars marzo мар марта март",
    "apr april avr avril abr abril aprile апр апреля",
    "may mai mayo mag maggio maj мая май",
    "jun june juni juin junio giu giugno июн июня",
    "jul july juli juil juillet julio lug luglio июл июля",
    "aug august août aout ago agosto авг августа",
    "sep sept september septembre septiembre settembre set сен сентября сент",
    "oct october okt oktober octobre octubre ott ottobre окт октября",
    "nov november novembre noviembre ноя ноября нояб",
    "dec december dez dezember déc décembre dic diciembre dicembre дек декабря",
)
"""Names of the twelve months in lower case, blanks between them."""
_MONTHS = {word: month for month, words in enumerate(_SPELLINGS, 1) for word in words.split()}

_CLOCK = (
    r"(?P<h>\d{1,2})\s?[:.hH]\s?(?P<m>\d{2})(?:\s?[:.m]\s?(?P<s>\d{2})(?:[.,:](?P<f>\d{1,9}))?)?s?"
    r"(?:\s*(?P<ap>[AaPp])\.?\s?[Mm]\.?)?"
)
_ZONE = r"(?:\s*(?P<z>Z|UTC|GMT|[A-Z]{3,5}|[+\-−]\d{2}:?\d{2}))?"
_PATTERNS = (
    ("ymd", r"^(?P<y>\d{4})[-/. ](?P<mo>\d{1,2})[-/. ](?P<d>\d{1,2})(?:[T ,_]+" + _CLOCK + _ZONE + r")?$"),
    (
        "cjk",
        r"^(?P<y>\d{4})年\s?(?P<mo>\d{1,2})月\s?(?P<d>\d{1,2})日(?:\s*(?P<h>\d{1,2})[:时時](?P<m>\d{2})[:分]?(?:(?P<s>\d{2})秒?)?)?$",
    ),
    (
        "compact",
        r"^(?P<y>\d{4})(?P<mo>\d{2})(?P<d>\d{2})[T _]?(?P<h>\d{2}):?(?P<m>\d{2}):?(?P<s>\d{2})(?:[.,](?P<f>\d{1,9}))?"
        + _ZONE
        + "$",
    ),
    (
        "dmy",
        r"^(?P<d>\d{1,2})(?P<sep>[-/. ])(?P<mo>\d{1,2})[-/. ](?P<y>\d{4}|\d{2})(?:[T ,]+" + _CLOCK + _ZONE + r")?$",
    ),
    (
        "dby",
        r"^(?:\pL{2,9}\.?,?\s+)?(?P<d>\d{1,2})\.?[-/. ]{1,2}(?P<b>\pL{3,10})\.?[-/. ]\s?(?P<y>\d{4}|\d{2})(?:[T ,]+"
        + _CLOCK
        + _ZONE
        + r")?$",
    ),
    (
        "bdy",
        r"^(?:\pL{2,9}\.?,?\s+)?(?P<b>\pL{3,10})\.?[-/. ]\s?(?P<d>\d{1,2}),?[-/. ]\s?(?P<y>\d{4}|\d{2})(?:[T ,]+"
        + _CLOCK
        + _ZONE
        + r")?$",
    ),
    ("ybd", r"^(?P<y>\d{4})[-/. ](?P<b>\pL{3,10})\.?[-/. ](?P<d>\d{1,2})(?:[T ,]+" + _CLOCK + _ZONE + r")?$"),
)


_COMPILED = tuple(re.compile(p.replace(r"\d", "[0-9]").replace(r"\pL", r"[^\W\d_]")) for _, p in _PATTERNS)
"""The same patterns for a few cells: Arrow compiles each anew for every call, 1 ms for those with letters."""


def looks_like_time(cells: list[str]) -> bool:
    """True where at least 80 % of the non-empty cells fit one of the patterns."""
    texts = [c.strip() for c in cells if c.strip()]
    return bool(texts) and any(sum(map(bool, map(p.match, texts))) >= 0.8 * len(texts) for p in _COMPILED)


def parse_text(
    column: Any, *, dayfirst: bool | None, time_format: str | None, place: Callable[[int], str]
) -> Times:
    """A text column as stamps. DataError where no pattern fits or day and month can't be told apart."""
    import pyarrow.compute as pc

    text = pc.utf8_trim_whitespace(column)
    text = pc.replace_substring_regex(text, r"[\x{00A0}\x{202F}\s]+", " ")
    kind, parts = _best_pattern(text, place)
    fields = {f.name: parts.field(f.name) for f in parts.type}
    valid = booleans(pc.is_valid(parts))
    year, day = _number(fields["y"]), _number(fields["d"])
    month = _number(fields["mo"]) if "mo" in fields else _months(fields["b"])
    clock_ns, clock_text = _clock(fields)
    if np.any(valid & (year < 100)):
        year = np.where(year < CENTURY_PIVOT, year + 2000, np.where(year < 100, year + 1900, year))
    words = "year-month-day" if kind in ("ymd", "cjk", "compact") else "day month-name year"
    assumptions: tuple[str, ...] = ()
    if kind == "dmy":
        if time_format in ("dmy", "mdy"):
            dayfirst = time_format == "dmy"
        dayfirst, assumptions = _day_order(day, month, year, clock_ns, valid, fields["sep"], dayfirst, column, place)
        day, month = (day, month) if dayfirst else (month, day)
        words = "day/month/year" if dayfirst else "month/day/year"
    ns, real = _to_ns(year, month, day)
    zone_ns, zone = _zones(fields.get("z"))
    ns += clock_ns - zone_ns
    valid &= real & (clock_ns >= 0) & (ns > EARLIEST_NS) & (ns < LATEST_NS)
    return Times(np.where(valid, ns, 0), valid, False, words + clock_text, zone, assumptions)


def _best_pattern(text: Any, place: Callable[[int], str]) -> tuple[str, Any]:
    """The pattern that most cells fit, with the fields of the cells."""
    import pyarrow.compute as pc

    head = text.drop_null().slice(0, 2000).to_pylist()
    best, which = max((sum(map(bool, map(p.match, head))), -i) for i, p in enumerate(_COMPILED))
    if not head or best < MIN_MATCHING * len(head):
        raise DataError(
            f"{place(0)}: {shown(head[0] if head else '')} is no time stamp that is known here",
            "use ISO 8601 (2024-05-31 14:00:00), name another column with --time, or give --step SECONDS",
        )
    kind, pattern = _PATTERNS[-which]
    return kind, pc.extract_regex(text, pattern)


def _number(column: Any) -> IntArray:
    import pyarrow.compute as pc

    filled = pc.fill_null(pc.if_else(pc.equal(column, ""), "0", column), "0")
    return integers(filled.cast(pa.int64()))[0]


def _months(column: Any) -> IntArray:
    words, index = coded(column)
    table = [_MONTHS.get(str(w).lower().rstrip("."), _MONTHS.get(str(w).lower()[:3], 0)) for w in words]
    return np.array([*table, 0], np.int64)[index]


def _clock(fields: dict[str, Any]) -> tuple[IntArray, str]:
    """Time of day in ns, -1 where it is invalid, and its description."""
    import pyarrow.compute as pc

    if "h" not in fields:
        return np.zeros(len(fields["y"]), np.int64), ""
    hour, minute, second = (_number(fields[k]) for k in ("h", "m", "s"))
    words = ""
    if "ap" in fields:
        half = pc.utf8_lower(pc.fill_null(fields["ap"], ""))
        pm, am = (booleans(pc.equal(half, c)) for c in "pa")
        if pm.any() or am.any():
            words = ", 12-hour clock"
            hour = np.where(pm & (hour < 12), hour + 12, np.where(am & (hour == 12), 0, hour))
    fraction: IntArray | int = 0
    if "f" in fields:
        fraction = _number(pc.utf8_slice_codeunits(pc.utf8_rpad(pc.fill_null(fields["f"], ""), 9, "0"), 0, 9))
    ns = ((hour * 60 + minute) * 60 + second) * SECOND + fraction
    good = (hour < 24) & (minute < 60) & (second < 61)
    # 24:00 is midnight of the next day in some exports.
    good |= (hour == 24) & (minute == 0) & (second == 0)
    return np.where(good, ns, -1), words


def _to_ns(year: IntArray, month: IntArray, day: IntArray) -> tuple[IntArray, BoolArray]:
    real = (month >= 1) & (month <= 12) & (day >= 1) & (year >= 1900) & (year <= 2200)
    safe_month = np.where(real, month, 1)
    months = ((np.where(real, year, 1970) - 1970) * 12 + safe_month - 1).astype("datetime64[M]")
    following = months + np.timedelta64(1, "M")
    length = (following.astype("datetime64[D]") - months.astype("datetime64[D]")).astype(np.int64)
    real &= day <= length
    days = months.astype("datetime64[D]").astype(np.int64) + np.where(real, day, 1) - 1
    return days * 86_400 * SECOND, real


def _zones(column: Any) -> tuple[IntArray | int, str | None]:
    """UTC offsets in ns and the word for the zone; zone abbreviations are reported, never converted."""
    if column is None:
        return 0, None
    found, index = coded(column)
    words = [str(w).replace("−", "-") for w in found]
    if not any(words):
        return 0, None
    table = []
    for word in words:
        sign = -1 if word.startswith("-") else 1
        digits = word.strip("+-").replace(":", "")
        table.append(sign * (int(digits[:2]) * 60 + int(digits[2:])) * 60 * SECOND if digits.isdigit() else 0)
    offsets = np.array([*table, 0], np.int64)
    named = sorted({w for w in words if w and w[0] not in "+-"})
    return offsets[index], "UTC" if not named or named[0] in ("Z", "UTC", "GMT") else named[0]


def _day_order(
    day: IntArray,
    month: IntArray,
    year: IntArray,
    clock: IntArray,
    valid: BoolArray,
    separator: Any,
    dayfirst: bool | None,
    column: Any,
    place: Callable[[int], str],
) -> tuple[bool, tuple[str, ...]]:
    """True where the first number is the day, with the assumptions made for it."""
    first_high, second_high = np.flatnonzero(valid & (day > 12)), np.flatnonzero(valid & (month > 12))
    if dayfirst is not None:
        wrong = second_high if dayfirst else first_high
        if wrong.size:
            raise DataError(
                f"{place(int(wrong[0]))}: {shown(column[int(wrong[0])].as_py())} can't be "
                f"{'day' if dayfirst else 'month'} first",
                f"say {'--monthfirst' if dayfirst else '--dayfirst'}",
            )
        return dayfirst, ()
    if first_high.size and second_high.size:
        one, other = int(first_high[0]), int(second_high[0])
        a, b = (shown(column[row].as_py()) for row in (one, other))
        raise DataError(
            f"{place(one)}: {a} is day first, and {b} ({place(other).split(', ')[-2]}) is month first",
            "export it again with ISO dates",
        )
    if first_high.size or second_high.size:
        return bool(first_high.size), ()
    if not valid.any() or bool(np.all(day[valid] == month[valid])):
        return True, ()
    stamps = ((_to_ns(year, m, d)[0] + clock)[valid] for d, m in ((day, month), (month, day)))
    spans = [int(np.abs(np.diff(ns)).max(initial=0)) for ns in stamps]
    # Twenty times: days in order make steps of a scan or an hour, months in order make steps of 28 days or more.
    if max(spans) > 20 * min(spans) and max(spans) >= 86_400 * 20 * SECOND:
        return spans[0] < spans[1], (
            f"dates {'day' if spans[0] < spans[1] else 'month'} first, because only so the rows follow each other",
        )
    row = int(np.argmax(valid))
    if separator[row].as_py() == ".":
        return True, ("dates with dots read as day first",)
    raise DataError(
        f"{place(row)}: {shown(column[row].as_py())} may be day first or month first, "
        "and no row of the file settles it",
        "say --dayfirst or --monthfirst",
    )
