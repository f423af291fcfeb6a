"""Cells to numbers: decimal comma, thousands marks, Unicode minus, units and per cent signs, states as words.

Whole columns at a time with pyarrow's string functions; a cell that is no number becomes NaN and its text
is counted.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import DataError
from ..loop import BoolArray, FloatArray
from .arrow import booleans, floats, texts

NULLS = ("", "NaN", "nan", "NAN", "null", "NULL", "Null", "None", "NA", "N/A", "#N/A", "n/a")
"""Cells that stand for "nothing here"; other states are counted by their own word."""

_POINT = re.compile(r"\d{1,3}(?:,\d{3})+\.\d|\d{1,3}(?:,\d{3}){2,}(?!\d)|[1-9]\d*\.\d+")
_COMMA = re.compile(
    r"(?:^|[^\d,])0,\d|\d,(?:\d{1,2}|\d{4,})(?!\d)|\d{4,},\d|\d\.\d{3},\d|,\d+[eE]|[\d'\u00a0\u202f ]{4,},\d{1,2}(?!\d)"
)
_OPEN = re.compile(r"[1-9]\d{0,2},\d{3}(?!\d)")
_CLEAN = r"^[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?$"
_UNIT_TAIL = r"^([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(?:%|°\s?[CFK]|[A-Za-z][\w/³²°]{0,7})$"


@dataclass(frozen=True, slots=True)
class Numbers:
    """A column as numbers: `values` (n,) with NaN where there is none; `words` counts the texts found instead."""

    values: FloatArray
    words: dict[str, int] = field(default_factory=dict)
    first_word_row: int = -1


def shown(cell: object, limit: int = 60) -> str:
    """A cell as it stands, in quotes, cut where it is too long for a sentence."""
    text = str(cell)
    return repr(text if len(text) <= limit else text[:limit] + "…")


def decimal_evidence(cells: list[str]) -> tuple[str, str, str]:
    """One example each of a cell with a decimal point, with a decimal comma, and of one that may be either."""
    found = {"point": "", "comma": "", "open": ""}
    for cell in cells:
        if _COMMA.search(cell):
            found["comma"] = found["comma"] or cell
        elif _POINT.search(cell):
            found["point"] = found["point"] or cell
        elif _OPEN.search(cell):
            found["open"] = found["open"] or cell
    return found["point"], found["comma"], found["open"]


def to_numbers(column: Any, decimal: str = ".") -> Numbers:
    """A pyarrow column of any type as numbers; infinities and absurd magnitudes become NaN."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or pa.types.is_decimal(column.type):
        return Numbers(_finite(floats(column)))
    if pa.types.is_null(column.type):
        return Numbers(np.full(len(column), np.nan))
    if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        return Numbers(np.full(len(column), np.nan), {str(column.type): len(column)}, 0)
    text = pc.utf8_trim_whitespace(column)
    clean = _normalised(text, decimal)
    numeric = pc.fill_null(pc.match_substring_regex(clean, _CLEAN), False)
    values = floats(pc.if_else(numeric, clean, pa.scalar(None, pa.string())).cast(pa.float64()))
    words_mask = pc.and_(pc.and_(pc.invert(numeric), pc.is_valid(text)), pc.invert(pc.is_in(text, texts(NULLS))))
    if not pc.any(words_mask).as_py():
        return Numbers(_finite(values))
    words = pc.value_counts(text.filter(words_mask)).to_pylist()
    first = int(np.argmax(booleans(words_mask)))
    ranked = sorted(words, key=lambda w: (-w["counts"], w["values"]))
    return Numbers(_finite(values), {w["values"]: w["counts"] for w in ranked}, first)


def _normalised(text: Any, decimal: str) -> Any:
    """Number texts in the plain form "-1234.5e-3"; texts that are no numbers stay what they are."""
    import pyarrow.compute as pc

    text = pc.replace_substring_regex(text, "^[−–]", "-")
    text = pc.replace_substring_regex(text, r"[eE]−", "e-")
    text = pc.replace_substring_regex(text, r'^="?([^"]*)"?$', r"\1")
    text = pc.replace_substring_regex(text, r"(\d)[\x{00A0}\x{202F}\x{2009} '’](\d)", r"\1\2")
    text = pc.replace_substring_regex(text, r"(\d)[\x{00A0}\x{202F}\x{2009} '’](\d)", r"\1\2")
    if decimal == ",":
        text = pc.replace_substring_regex(text, r"(\d)\.(\d{3})", r"\1\2")
        text = pc.replace_substring(text, ",", ".", max_replacements=1)
    else:
        # Twice, because neighbouring groups of three share their border digit.
        text = pc.replace_substring_regex(text, r"(\d),(\d{3})", r"\1\2")
        text = pc.replace_substring_regex(text, r"(\d),(\d{3})", r"\1\2")
    text = pc.replace_substring_regex(text, r"[\x{00A0}\x{202F}]", " ")
    return pc.replace_substring_regex(text, _UNIT_TAIL, r"\1")


def check_thousands(column: Any, decimal: str, place: Any) -> None:
    """Refuse a text column whose commas may be thousands or decimals, when the sample did not settle it.

    `place` turns a row into the words for file, line and column.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    if decimal != "." or not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        return
    commas = column.filter(pc.fill_null(pc.match_substring(column, ","), False))
    if not len(commas):
        return
    point, comma, unclear = decimal_evidence([str(c) for c in commas.slice(0, 20000).to_pylist()])
    if comma:
        raise DataError(
            f"{place(_row_of(column, comma))}: {shown(comma)} has a decimal comma where other cells have none",
            "say --decimal ,",
        )
    dotted = pc.any(pc.fill_null(pc.match_substring_regex(column, r"\d\.\d"), False)).as_py()
    if unclear and not point and not dotted:
        raise DataError(
            f"{place(_row_of(column, unclear))}: {shown(unclear)} may be a thousand or a decimal fraction",
            "say --decimal . or --decimal ,",
        )


def _row_of(column: Any, cell: str) -> int:
    import pyarrow.compute as pc

    return int(pc.index(column, cell).as_py())


LARGEST, SMALLEST = 1e100, 1e-100
"""Magnitudes beyond which a number is no measurement: larger ones are no value, smaller ones are zero. Squares and
ratios of what remains stay inside double precision."""


def _finite(values: FloatArray) -> FloatArray:
    size = np.abs(values)
    large: BoolArray = size > LARGEST
    small: BoolArray = (size < SMALLEST) & (size > 0)
    if large.any() or small.any():
        values = np.where(large, np.nan, np.where(small, 0.0, values))
    return values
