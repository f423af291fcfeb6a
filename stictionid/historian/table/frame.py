"""Pandas data frame as a table: its text is read as the cells of a file are, and columns may share a name."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pyarrow as pa

from ..bytes.arrow import texts
from ..words.cells import NULLS, decimal_evidence
from .table import Table, table_from_arrow

_SAMPLE = 300
"""Cells of a text column by which its decimal mark is told, as in the first lines of a file."""


def frame_table(frame: Any, name: str, decimal: str | None = None) -> Table:
    """The columns of a data frame, and after them the levels of its index that have a name.

    `decimal` is the mark of numbers in text; without it the first cells tell.
    """
    levels = [frame.index.get_level_values(i).to_series() for i, n in enumerate(frame.index.names) if n is not None]
    names = [str(n) for n in (*frame.columns, *(level.name for level in levels))]
    columns = [_column(c) for c in (*(frame.iloc[:, i] for i in range(frame.shape[1])), *levels)]
    mark = decimal or _decimal(columns)
    columns = [_numbers(c, mark) if pa.types.is_string(c.type) else c for c in columns]
    return replace(table_from_arrow(pa.Table.from_arrays(columns, names=names), name), decimal=mark)


def _column(values: Any) -> Any:
    """A series as an Arrow column; cells of several kinds become text."""
    try:
        column = pa.array(values, from_pandas=True)
    except (pa.ArrowException, TypeError, ValueError, OverflowError):
        cells = [None if empty else str(cell) for cell, empty in zip(values, values.isna(), strict=True)]
        column = pa.array(cells, pa.string())
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if pa.types.is_large_string(column.type) or pa.types.is_string_view(column.type):
        column = column.cast(pa.string())
    return column


def _numbers(column: Any, decimal: str) -> Any:
    """A text column as whole or real numbers where every cell is one, as the reader of CSV does."""
    import pyarrow.compute as pc

    text = pc.utf8_trim_whitespace(column)
    text = pc.if_else(pc.is_in(text, texts(NULLS)), pa.scalar(None, pa.string()), text)
    if decimal == ",":  # a point then marks thousands: such cells stay text, which is read cell by cell
        text = pc.replace_substring(pc.replace_substring(text, ".", "'"), ",", ".")
    for kind in (pa.int64(), pa.float64()):
        try:
            return text.cast(kind)
        except pa.ArrowInvalid:
            continue
    return column


def _decimal(columns: list[Any]) -> str:
    cells = [str(c) for column in columns if pa.types.is_string(column.type)
             for c in column.slice(0, _SAMPLE).to_pylist() if c and "," in c]
    point, comma, _ = decimal_evidence(cells)
    return "," if comma and not point else "."
