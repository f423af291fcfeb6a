"""Dispatch of a source to its reader: Parquet, text held whole, or text in pieces."""

from __future__ import annotations

from ..bytes.limits import limits_from
from ..bytes.options import ReadOptions
from ..bytes.source import Source
from .parquet import read_parquet
from .streamed import read_streamed
from .table import Table, text_table


def read_table(source: Source, options: ReadOptions, *, loops: bool = False) -> Table:
    """The one table in a source; with `loops` only the part needed to name the loops in it.

    DataError where it can't be read as a table, or is above a limit.
    """
    limits = limits_from(options.limit)
    if source.kind == "parquet":
        return read_parquet(source, options, limits, loops=loops)
    if not source.data and source.path is not None:
        return read_streamed(source, options, limits, loops=loops)
    return text_table(source, options, limits)
