"""Selection of the columns that one loop needs, so that large files are read without the others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pyarrow as pa

from ..bytes.options import ReadOptions
from ..words.assign import assign
from ..words.roles import pick, take_apart
from .columns import is_paired, kind_of, long_columns, loop_column, time_columns, without_loop_column
from .table import Table


def wanted_columns(head: Table, options: ReadOptions) -> tuple[set[int] | None, list[str]]:
    """Columns that the loop needs, judged by the first rows, and the kind of each; None for all of them.

    Long and paired tables need all. Errors as in `assign`: a role in no column, several loops.
    """
    kinds = [kind_of(head, i) for i in range(len(head.names))]
    times = {i for i, k in enumerate(kinds) if k in ("time", "date", "clock")}
    tag, value = long_columns(head, kinds)
    if options.shape in ("long", "paired") or (tag >= 0 and value >= 0) or is_paired(kinds, sorted(times)):
        return None, kinds
    times |= set(time_columns(head, kinds, options))
    quality = {i for i, n in enumerate(head.names) if take_apart(n).role == "quality"}
    numeric = {i for i, k in enumerate(kinds) if k in ("number", "nothing")} - quality
    found = assign(head.names, without_loop_column(head, kinds, options), head.file, skip=times, numeric=numeric,
                   encoding=head.encoding)
    if options.quality is not None:
        quality.add(pick(head.names, options.quality, "--quality", head.file))
    named = {i for i, n in enumerate(head.names) if n.strip().lower() == "used"} | {loop_column(head, kinds)}
    return (times | quality | named | set(found.index.values()) | set(found.extras.values())) - {-1}, kinds


def by_rows(head: Table) -> bool:
    """True where the loop of a value is named by its row, not by its column."""
    kinds = [kind_of(head, i) for i in range(len(head.names))]
    return loop_column(head, kinds) >= 0 or min(long_columns(head, kinds)) >= 0


def without_others(table: Table, columns: dict[int, Any], kinds: list[str], rows: int) -> Table:
    """The table with the given columns; the others keep their names and kinds but hold nothing."""
    empty = {True: pa.nulls(rows, pa.null()), False: pa.nulls(rows, pa.bool_())}
    return replace(table, columns=tuple(
        columns[i] if i in columns else empty[kind in ("number", "nothing")] for i, kind in enumerate(kinds)))
