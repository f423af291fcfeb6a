"""Numbers from text cells: decimal comma, thousands marks, Unicode minus, units and per cent signs, states as words.

Whole columns are converted with pyarrow's string functions. A cell that is no number becomes NaN and its text is
counted.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from ...errors import DataError
from ...record.loop import LARGEST
from ...typing import BoolArray, FloatArray
from ..bytes.arrow import coded, floats, texts

NULLS = ("", "NaN", "nan", "NAN", "null", "NULL", "Null", "None", "NA", "N/A", "#N/A", "n/a")
"""Cells that mean "no value"; other states are counted under their own word."""

_POINT = re.compile(r"\d{1,3}(?:,\d{3})+\.\d|\d{1,3}(?:,\d{3}){2,}(?!\d)|[1-9]\d*\.\d+")
_COMMA = re.compile(
    r"(?:^|[^\d,])0,\d|\d,(?:\d{1,2}|\d{4,})(?!\d)|\d{4,},\d|\d\.\d{3},\d|,\d+[eE]|[\d'\u00a0\u202f ]{4,},\d{1,2}(?!\d)"
)
_OPEN = re.compile(r"[1-9]\d{0,2},\d{3}(?!\d)")
# Longest column name in a message, in characters.
_LONGEST_NAME = 60
_CLEAN = r"^[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?$"
# No unit begins with x (0x10), and none with e and a digit (1e5).
_UNIT = r"[A-DF-WYZa-df-wyz][\w/³²°]{0,7}|[eE][A-Za-z][\w/³²°]{0,6}"
_UNIT_TAIL = rf"^([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(?:%|°\s?[CFK]|{_UNIT})$"


@dataclass(frozen=True, slots=True)
class Numbers:
    """A column as numbers: `values` (n,) with NaN where a cell has none; `words` counts the texts of those cells."""

    values: FloatArray
    words: dict[str, int] = field(default_factory=dict)


def shown(cell: object, limit: int = 60) -> str:
    """A cell as written, in quotes, cut where it is too long for a sentence."""
    text = str(cell)
    return repr(text if len(text) <= limit else text[:limit] + "…")


def brief(name: str) -> str:
    """A name as written, on one line, cut where it is too long for a sentence."""
    text = " ".join(name.split())
    return text if len(text) <= _LONGEST_NAME else text[:_LONGEST_NAME] + "…"


def decimal_evidence(cells: list[str]) -> tuple[str, str, str]:
    """One example each of a cell with a decimal point, with a decimal comma, and of one that may be either."""
    found = {_POINT: "", _COMMA: "", _OPEN: ""}
    for cell in cells:
        kind = next((pattern for pattern in (_COMMA, _POINT, _OPEN) if pattern.search(cell)), None)
        if kind is not None and not found[kind]:
            found[kind] = cell
    return found[_POINT], found[_COMMA], found[_OPEN]


def to_numbers(column: Any, decimal: str = ".") -> Numbers:
    """A pyarrow column of any type as numbers; infinities and absurd magnitudes become NaN."""
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or pa.types.is_decimal(column.type):
        return _numbers(floats(column))
    if pa.types.is_null(column.type):
        return Numbers(np.full(len(column), np.nan))
    if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        return Numbers(np.full(len(column), np.nan), {str(column.type): len(column)})
    import pyarrow.compute as pc

    text = pc.utf8_trim_whitespace(column)
    if len(column) <= FEW_CELLS or pc.count_distinct(text).as_py() <= FEW_CELLS:
        return _few(text, decimal)
    clean = text
    for pattern, new in _steps(decimal):
        clean = pc.replace_substring_regex(clean, pattern.pattern, new)
    numeric = pc.fill_null(pc.match_substring_regex(clean, _CLEAN), False)
    values = floats(pc.if_else(numeric, clean, pa.scalar(None, pa.string())).cast(pa.float64()))
    words_mask = pc.and_(pc.and_(pc.invert(numeric), pc.is_valid(text)), pc.invert(pc.is_in(text, texts(NULLS))))
    words = pc.value_counts(text.filter(words_mask)).to_pylist()
    ranked = sorted(words, key=lambda w: (-w["counts"], w["values"]))
    return _numbers(values, {w["values"]: w["counts"] for w in ranked})


FEW_CELLS = 2000
"""Different cells up to which each is looked at by itself; Arrow compiles its patterns anew for every column."""
_GROUP = ("([0-9])[\u00a0\u202f\u2009 '’]([0-9])", r"\1\2")
_MARKS = {
    ".": ((r"([0-9]),([0-9]{3})", r"\1\2"),) * 2,
    ",": ((r"([0-9])\.([0-9]{3})", r"\1\2"), ("^([^,]*),", r"\1.")),
}
"""Thousands and decimal marks; groups are joined twice, because neighbouring ones share their border digit."""


@functools.cache
def _steps(decimal: str) -> tuple[tuple[re.Pattern[str], str], ...]:
    """Patterns and replacements, for Python and for Arrow, that leave a number in the plain form "-1234.5e-3"."""
    steps = (("^[−–]", "-"), ("[eE]−", "e-"), ('^="?([^"]*)"?$', r"\1"), _GROUP, _GROUP, *_MARKS[decimal],
             ("[\u00a0\u202f]", " "), (_UNIT_TAIL, r"\1"))
    return tuple((re.compile(pattern, re.ASCII), new) for pattern, new in steps)


_NUMBER = re.compile(_CLEAN.replace("$", r"\Z"), re.ASCII)


def _few(text: Any, decimal: str) -> Numbers:
    """A column of few different cells as numbers; each different cell is converted once."""
    cells, code = coded(text)
    found = np.array([*(_number(str(c), decimal) for c in cells), np.nan])
    counts = np.bincount(code, minlength=len(cells) + 1)
    words = {c: int(counts[i]) for i, c in enumerate(cells) if np.isnan(found[i]) and c not in NULLS}
    return _numbers(found[code], dict(sorted(words.items(), key=lambda w: (-w[1], w[0]))))


def _number(cell: str, decimal: str) -> float:
    """The number in one cell, NaN where it has none."""
    if decimal == "," or not _NUMBER.match(cell):
        for pattern, new in _steps(decimal):
            cell = pattern.sub(new, cell)
    return float(cell) if _NUMBER.match(cell) else float("nan")


def check_thousands(column: Any, decimal: str, place: Any) -> None:
    """Refuse a text column whose commas may be thousands or decimals, where the sample did not settle it.

    `place` turns a row into the words for file, line and column.
    """
    if decimal != "." or not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        return
    import pyarrow.compute as pc

    commas = column.filter(pc.fill_null(pc.match_substring(column, ","), False))
    if not len(commas):
        return
    point, comma, unclear = decimal_evidence([str(c) for c in commas.slice(0, 20000).to_pylist()])
    if comma:
        raise DataError(
            f"{place(pc.index(column, comma).as_py())}: {shown(comma)} has a decimal comma where other cells have none",
            "say --decimal ,",
        )
    dotted = pc.any(pc.fill_null(pc.match_substring_regex(column, r"\d\.\d"), False)).as_py()
    if unclear and not point and not dotted:
        raise DataError(
            f"{place(pc.index(column, unclear).as_py())}: {shown(unclear)} may be a thousand or a decimal fraction",
            "say --decimal . or --decimal ,",
        )


SMALLEST = 1e-100
"""Magnitude below which a number is zero; above `LARGEST` it is no value. Squares and ratios of what remains stay
inside double precision."""


def _numbers(values: FloatArray, words: dict[str, int] | None = None) -> Numbers:
    """Numbers without absurd magnitudes; those too large are counted among the words."""
    size, words = np.abs(values), words or {}
    large: BoolArray = size > LARGEST
    small: BoolArray = (size < SMALLEST) & (size > 0)
    if large.any() or small.any():
        values = np.where(large, np.nan, np.where(small, 0.0, values))
    if large.any():
        words[f"beyond {LARGEST:g}"] = int(large.sum())
    return Numbers(values, words)
