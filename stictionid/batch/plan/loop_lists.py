"""A loop list: CSV with one row per loop, and as columns those reading options that differ from loop to loop."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from ...errors import DataError, UsageError
from ...historian.bytes.options import ReadOptions, span_of
from ...historian.words.cells import shown
from ...system.files import text_of

TAGS, _SPANS = ("sp", "pv", "op", "position"), ("span_op", "span_pv")
COLUMNS = ("loop", *TAGS, *_SPANS)
_NEEDED = ("loop", "pv", "op")


def read_list(path: Path) -> tuple[ReadOptions, ...]:
    """The loops of a list, each as the options to read it.

    UsageError where the file is absent, DataError where a row cannot be used.
    """
    text = text_of(path, "the loop list", hint="give --loops LIST.csv, saved as CSV UTF-8", encoding="utf-8-sig")
    separator = ";" if text.partition("\n")[0].count(";") > text.partition("\n")[0].count(",") else ","
    try:
        rows = list(csv.reader(io.StringIO(text), delimiter=separator, strict=True))
    except csv.Error as error:
        raise DataError(f"the loop list {path} is no CSV: {error}", "quote cells that hold the separator") from None
    head = [c.strip().lower() for c in rows[0]] if rows else []
    unknown = [c for c in head if c and c not in COLUMNS]
    absent = [c for c in _NEEDED if c not in head]
    if absent or unknown:
        what = f"has no column {absent[0]!r}" if absent else f"has an unknown column {shown(unknown[0])}"
        raise DataError(f"the loop list {path} {what}", "its first line is " + ",".join(COLUMNS))
    found: dict[str, int] = {}
    listed = []
    for number, row in enumerate(rows[1:], 2):
        cells = {name: cell.strip() for name, cell in zip(head, row, strict=False)}
        if not any(cells.values()):
            continue
        loop = cells.get("loop", "")
        for name in _NEEDED:
            if not cells.get(name):
                whose = f" for {shown(loop)}" if loop else ""
                raise DataError(f"the loop list {path}, line {number}: no {name}{whose}",
                                "every row needs loop, pv and op")
        if loop in found:
            raise UsageError(f"the loop list {path} has two loops {shown(loop)}, in lines {found[loop]} and {number}",
                             "give each loop a name of its own")
        found[loop] = number
        own: dict[str, Any] = {n: cells.get(n) or None for n in TAGS}
        own |= {n: _span(cells.get(n, ""), f"{path}, line {number}, {n}") for n in _SPANS}
        listed.append(ReadOptions(loop=loop, **own))
    if not listed:
        raise DataError(f"the loop list {path} has no loops", "its first line is " + ",".join(COLUMNS))
    return tuple(listed)


def _span(text: str, where: str) -> tuple[float, float] | None:
    if not text:
        return None
    try:
        low, high = span_of(text.replace(":", ","))
    except ValueError:
        low, high = 1.0, 0.0
    if not low < high < float("inf"):
        raise DataError(f"the loop list {where}: {shown(text)} is no range", 'two numbers, for example "0,100"')
    return low, high
