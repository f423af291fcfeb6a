"""Reader of historian exports: from the bytes of a file to one loop, with every guess and every row left out listed.

A file passes through these subpackages: `bytes` (content, unpacking, limits, encoding) → `table` (separator, header,
decimal mark, columns) → `series` (wide, long or paired table) with `words` (names, roles, cells, states, modes,
quality) and `time` (stamps, dates, zones, order) → `grid` (alignment, window, even grid, masks) with `checks` (codes,
spoilt data) → Loop. `dataset` reads one file per tag and partitioned Parquet. In `table/rows.py` every
row of the file is either used or listed under one reason. `reading` runs the whole.

Imports between the subpackages run one way: bytes, words, time, table, series, grid, checks; each may use those before
it. `words/findings.py` lists what can be noticed about an export, each with its severity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .bytes.options import ReadOptions, options_from
    from .reading import Reading, loops_in, read, read_frame, read_loop

_HOME = {
    "ReadOptions": "bytes.options",
    "options_from": "bytes.options",
    "Reading": "reading",
    "loops_in": "reading",
    "read": "reading",
    "read_frame": "reading",
    "read_loop": "reading",
}

__all__ = ["ReadOptions", "Reading", "loops_in", "options_from", "read", "read_frame", "read_loop"]

if not TYPE_CHECKING:  # or an import of a name that is not there would pass
    def __getattr__(name: str) -> Any:
        """Load public names on first use, so that importing the package is fast."""
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        return getattr(import_module(f".{_HOME[name]}", __name__), name)
