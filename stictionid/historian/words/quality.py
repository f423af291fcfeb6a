"""Quality columns: OPC codes, words, PHD confidence, PI flags; result good, uncertain or bad for each row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from ...typing import BoolArray
from ..bytes.arrow import booleans, coded
from .cells import to_numbers

OPC_MASK, OPC_GOOD, OPC_UNCERTAIN = 0xC0, 0xC0, 0x40
"""Quality bits of OPC DA: 0xC0 good, 0x40 uncertain, 0 bad (216 = good, local override)."""
MIN_PHD_CONFIDENCE = 50.0
"""Confidence of Honeywell PHD, 0 to 100, from which a value is kept."""
_GOOD_WORDS = """
    0xc0, 1, annotated, bon, bueno, buono, c0, g, good, good (192), good local override, good-modified,
    good_localoverride, goodlocaloverride, gut, ok, snapshot, substituted, true, valid, y, yes, достоверно, норма,
    хорошее, 好, 正常, 良, 良好
"""
_GOOD = frozenset(w.strip() for w in _GOOD_WORDS.split(","))
_UNCERTAIN_WORDS = """
    incertain, interpolated, q, questionable, substitute, suspect, u, uncertain, unsicher, недостоверно?, 不确定, 可疑
"""
_UNCERTAIN = frozenset(w.strip() for w in _UNCERTAIN_WORDS.split(","))

KINDS = ("opc", "phd", "ip21", "flag", "words", "used")


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality per row (n,): `bad` where the value must not be used, `uncertain` where it is used with a caution."""

    bad: BoolArray
    uncertain: BoolArray
    kind: str


def read_quality(column: Any, name: str, kind: str | None) -> Quality:
    """A quality column; `kind` overrides the guess by its values."""
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if pa.types.is_boolean(column.type):
        flag = booleans(column)
        none = np.zeros(flag.size, np.bool_)
        if name.strip().lower() in ("questionable", "bad", "q"):
            return Quality(none, flag, "flag")
        return Quality(~flag, none, "flag")
    numbers = to_numbers(column)
    if numbers.words or kind == "words":
        return _by_words(column)
    values = numbers.values
    kind = kind or _kind_of(values, name)
    empty = np.isnan(values)
    none = np.zeros(values.size, np.bool_)
    if kind == "opc":
        bits = np.where(empty | (values < 0) | (values > 0xFFFF), 0, values).astype(np.int64) & OPC_MASK
        return Quality((bits != OPC_GOOD) & (bits != OPC_UNCERTAIN), bits == OPC_UNCERTAIN, "OPC codes")
    if kind == "phd":
        return Quality(~(values >= MIN_PHD_CONFIDENCE), none, "PHD confidence")
    if kind == "ip21":
        # 0 good, 1 suspect, 2 bad; 4, 5 and 6 the same of a modified value.
        return Quality(np.isin(values, (2.0, 6.0)) | empty, np.isin(values, (1.0, 5.0)), "IP.21 status")
    return Quality(~(values > 0), none, "flag, 1 good")


def _kind_of(values: Any, name: str) -> str:
    """Code of a number column, by its values: OPC has 192, confidence reaches 100, flags are 0 and 1."""
    highest = values.max(where=~np.isnan(values), initial=-np.inf)
    if name.strip().lower() in ("confidence", "conf") or 6 < highest <= 100:
        return "phd"
    if highest > 100:
        return "opc"
    return "flag" if -np.inf < highest <= 1 and "status" not in name.lower() else "ip21"


def _by_words(column: Any) -> Quality:
    import pyarrow.compute as pc

    text = pc.utf8_lower(pc.utf8_trim_whitespace(column.cast(pa.string())))
    words, index = coded(text)
    grade = [0 if _is(w, _GOOD) else 1 if _is(w, _UNCERTAIN) else 2 for w in map(str, words)] + [2]
    grades = np.array(grade, np.int8)[index]
    return Quality(grades == 2, grades == 1, "words")


def _is(word: str, group: frozenset[str]) -> bool:
    return word in group or word.split(",")[0].split(" ")[0].split(":")[0].rstrip(";") in group
