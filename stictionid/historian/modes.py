"""Controller modes: words of several languages and vendors, and integers whose meaning is a site's own."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import UsageError
from ..loop import FloatArray
from .arrow import floats
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
"""What a mode means for the loop: AUTO and CAS control the valve by the error, MAN does not, OFF is neither."""
_KNOWN = {word: kind for kind, words in WORDS.items() for word in words.split()}
CONTROLLING = ("AUTO", "CAS")
UNKNOWN = "UNKNOWN"


@dataclass(frozen=True, slots=True)
class Modes:
    """Mode codes per row (n,), NaN where empty; `meaning` of each code: AUTO, CAS, MAN, OFF or UNKNOWN."""

    codes: FloatArray
    words: tuple[str, ...]
    meaning: tuple[str, ...]


def meaning_of(word: str, mode_map: dict[str, str]) -> str:
    """What a mode word or number means; the site's own map comes first."""
    for key, value in mode_map.items():
        if key.strip().lower() == word.strip().lower() or (_number(key) is not None and _number(key) == _number(word)):
            return value.upper()
    text = word.strip().lower().rstrip(".")
    if text in _KNOWN:
        return _KNOWN[text]
    parts = [p for p in re.split(r"[\s/_:,()\-]+", text) if p]
    kinds = {_KNOWN[p] for p in parts if p in _KNOWN}
    return kinds.pop() if len(kinds) == 1 else UNKNOWN


def check_map(mode_map: dict[str, str]) -> None:
    """Refuse a map to anything but the four meanings."""
    for key, value in mode_map.items():
        if value.upper() not in WORDS:
            raise UsageError(f"mode {shown(key)} is mapped to {shown(value)}", f"use one of {', '.join(WORDS)}")


def read_modes(column: Any, mode_map: dict[str, str]) -> Modes:
    """A mode column (words or numbers) as codes with meanings."""
    import pyarrow as pa

    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks() if column.num_chunks != 1 else column.chunk(0)
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    encoded = column.dictionary_encode()
    words = tuple(_word(w) for w in encoded.dictionary.to_pylist())
    codes = floats(encoded.indices.cast(pa.float64()))
    empty = [i for i, w in enumerate(words) if w in NULLS or (is_state(w) and meaning_of(w, mode_map) == UNKNOWN)]
    if empty:
        codes = np.where(np.isin(codes, empty), np.nan, codes)
    return Modes(codes, words, tuple(meaning_of(w, mode_map) for w in words))


def fractions(modes: Modes | None) -> float:
    """Share of rows whose mode is a number but no whole one: means of codes, which no controller writes."""
    if modes is None:
        return 0.0
    odd = [i for i, w in enumerate(modes.words) if (n := _number(w)) is not None and abs(n) < 1e9 and n != int(n)]
    return float(np.isin(modes.codes, odd).mean()) if odd else 0.0


def _word(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
