"""Controller modes: words of several languages and vendors, and integers whose meaning differs between sites."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from ...errors import UsageError
from ...typing import FloatArray
from ..bytes.arrow import coded, whole
from .cells import NULLS, shown
from .states import is_state

WORDS = {
    "AUTO": """
        auto automatic aut a automatik automatisch automatique automático automatico 自动 自動 авто авт
    автомат run on closed local auto lauto
    """,
    "CAS": """
        cas cascade casc rcas bcas ccas cascada kaskade каскад кас 串级 串級 remote rsp rem supervisory
    spc dmc prd
    """,
    "MAN": """
        man manual m hand manuel manuell manuale ручн ручной руч р 手动 手動 iman rout lo lman initman
    forced hnd open tune
    """,
    "OFF": """
        oos o/s out-of-service off init track trk tracking prog local override lockout shutdown start
    startup hold standby aus arrêt выкл 停止 o.s.
    """,
}
"""Meanings of a mode for the loop: AUTO and CAS control the valve by the error, MAN does not, OFF is neither."""
_KNOWN = {word: kind for kind, words in WORDS.items() for word in words.split()}
_TRUE_WORDS = """
    true, yes, on, ein, ja, oui, si, sí, vrai, wahr, verdadero, вкл, да, истина, 是, 开, 真, オン, 1, 1.0, t, y
"""
_FALSE_WORDS = """
    false, no, off, aus, nein, non, faux, falsch, falso, выкл, нет, ложь, 否, 关, 假, オフ, 0, 0.0, f, n
"""
_TRUE, _FALSE = (frozenset(w.strip() for w in words.split(",")) for words in (_TRUE_WORDS, _FALSE_WORDS))
"""Words of a flag that says whether the loop is in automatic, or in manual."""
FLAG_NAMES = {
    "AUTO": ("auto", "automatic", "automatik", "авто", "自动"),
    "MAN": ("man", "manual", "manuell", "hand", "ручн", "手动"),
}
CONTROLLING = ("AUTO", "CAS")
UNKNOWN = "UNKNOWN"


@dataclass(frozen=True, slots=True)
class Modes:
    """Mode codes per row (n,), NaN where empty; `meaning` of each code: AUTO, CAS, MAN, OFF or UNKNOWN."""

    codes: FloatArray
    words: tuple[str, ...]
    meaning: tuple[str, ...]


def meaning_of(word: str, mode_map: dict[str, str]) -> str:
    """Meaning of a mode word or number; the site's own map comes first."""
    for key, value in mode_map.items():
        if key.strip().lower() == word.strip().lower() or (_number(key) is not None and _number(key) == _number(word)):
            return value.upper()
    text = word.strip().lower().rstrip(".")
    if text in _KNOWN:
        return _KNOWN[text]
    kinds = {_KNOWN[part] for part in re.split(r"[\s/_:,()\-]+", text) if part in _KNOWN}
    return kinds.pop() if len(kinds) == 1 else UNKNOWN


def check_map(mode_map: dict[str, str]) -> None:
    """Refuse a map to anything except the four meanings."""
    for key, value in mode_map.items():
        if value.upper() not in WORDS:
            raise UsageError(f"mode {shown(key)} is mapped to {shown(value)}", f"use one of {', '.join(WORDS)}")


def _flag(words: tuple[str, ...], name: str, mode_map: dict[str, str]) -> dict[str, str]:
    """Meanings of a flag (true, false, ein, aus, …) by its column's name: AUTO true is automatic, MAN true manual."""
    last = name.strip().lower().replace("_", " ").replace(".", " ").replace("/", " ").split(" ")[-1]
    kind = next((kind for kind, names in FLAG_NAMES.items() if last in names), None)
    low = {w: w.strip().lower() for w in words if w not in NULLS}
    if kind is None or not all(w in _TRUE | _FALSE for w in low.values()):
        return {}
    other = "MAN" if kind == "AUTO" else "AUTO"
    return {w: kind if lower in _TRUE else other for w, lower in low.items() if w not in mode_map}


def read_modes(column: Any, mode_map: dict[str, str], name: str = "") -> Modes:
    """A mode column (words or numbers) as codes with meanings; `name` gives the meaning of a flag."""
    column = whole(column)
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    found, index = coded(column)
    words = tuple(f"{w:g}" if isinstance(w, float) else str(w) for w in found)
    mode_map = {**_flag(words, name, mode_map), **mode_map}
    empty = [i for i, w in enumerate(words) if w in NULLS or (is_state(w) and meaning_of(w, mode_map) == UNKNOWN)]
    codes = np.where(np.isin(index, [*empty, len(words)]), np.nan, index)
    return Modes(codes, words, tuple(meaning_of(w, mode_map) for w in words))


def fractions(modes: Modes | None) -> float:
    """Share of rows whose mode is a fractional number: an average of codes, which no controller writes."""
    if modes is None:
        return 0.0
    odd = [i for i, w in enumerate(modes.words) if (n := _number(w)) is not None and abs(n) < 1e9 and n != int(n)]
    return float(np.isin(modes.codes, odd).mean()) if odd else 0.0


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
