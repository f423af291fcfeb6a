"""Dispatch of a source to its reader: Parquet, workbook, MATLAB file, text held whole, or text in pieces."""

from __future__ import annotations

from ..bytes.options import ReadOptions
from ..bytes.source import Source, limits_from
from .columns import names_of
from .matlab import parts_of_matlab
from .parquet import read_parquet
from .parts import Part, choose, names_of_parts
from .streamed import read_streamed
from .table import Table, text_table
from .workbook import parts_of_workbook

IN_PARTS = {"workbook": "sheet", "matlab": "struct"}
"""Kinds of files with several tables, and the word for one of them."""


def read_table(source: Source, options: ReadOptions, *, loops: bool = False) -> Table:
    """The one table in a source; with `loops` only the part needed to name the loops in it.

    DataError where it can't be read as a table, or is above a limit; UsageError where `--loop` must choose a part.
    """
    limits = limits_from(options.limit)
    if source.kind in IN_PARTS:
        return choose(_parts(source, options), options, source.name, IN_PARTS[source.kind])
    if source.kind == "parquet":
        return read_parquet(source, options, limits, loops=loops)
    if not source.data and source.path is not None:
        return read_streamed(source, options, limits, loops=loops)
    return text_table(source, options, limits)


def loops_of(source: Source, options: ReadOptions) -> tuple[str, ...]:
    """Names of the loops in a source, as `--loop` takes them; one loop without a name gives ()."""
    if source.kind in IN_PARTS:
        return names_of_parts(_parts(source, options), options)
    return names_of(read_table(source, options, loops=True))


def _parts(source: Source, options: ReadOptions) -> list[Part]:
    limits = limits_from(options.limit)
    if source.kind == "workbook":
        return parts_of_workbook(source, options, limits)
    return parts_of_matlab(source, limits)
