"""Columns of a table by their content: time, tags, values, names of loops, and those that one loop needs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa

from ..bytes.options import ReadOptions
from ..time.datetext import looks_like_time
from ..words.assign import assign, key_of
from ..words.cells import to_numbers
from ..words.roles import pick, take_all, take_apart
from .table import Table

_PEEK = 50


def kind_of(table: Table, column: int) -> str:
    """Content of a column: time, date, clock (time of day), number, text or nothing."""
    values = table.columns[column]
    kind = values.type.value_type if pa.types.is_dictionary(values.type) else values.type
    if pa.types.is_timestamp(kind):
        return "time"
    if pa.types.is_date(kind):
        return "date"
    if pa.types.is_time(kind):
        return "clock"
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return "number"
    if pa.types.is_null(kind):
        return "nothing"
    if pa.types.is_boolean(kind):
        return "text"
    cells = [str(c) for c in values.slice(0, 5000).drop_null().slice(0, _PEEK).to_pylist()]
    if looks_like_time(cells):
        return "date" if not any(":" in c or "." in c[11:] for c in cells) and len(cells[0].strip()) <= 11 else "time"
    if cells and sum(
        c.count(":") in (1, 2) and c.replace(":", "").replace(".", "").strip(" AaPpMm").isdigit() for c in cells
    ) > 0.8 * len(cells):
        return "clock"
    digits = to_numbers(values.slice(0, 5000), table.decimal)
    return "number" if np.count_nonzero(~np.isnan(digits.values)) > 0 else "text"


def long_columns(table: Table, kinds: list[str]) -> tuple[int, int]:
    """Columns of tags and of values in a long table, -1 where there is none."""
    roles = [tag.role for tag in take_all(table.names)]
    if {"process_value", "output"} <= set(roles):
        return -1, -1
    tag = -1
    for i, column in enumerate(table.columns):
        if kinds[i] != "text" or not (pa.types.is_string(column.type) or pa.types.is_dictionary(column.type)):
            continue
        words = {str(w) for w in column.slice(0, 20_000).unique().to_pylist() if w is not None}
        known = sum(take_apart(w).role in ("setpoint", "output", "process_value", "position") for w in words)
        if known >= 2 or (roles[i] == "tag" and len(words) >= 2):
            tag = i
            break
    numbers = [i for i, k in enumerate(kinds) if k in ("number", "text") and i != tag]
    value = next((i for i in numbers if roles[i] == "value"), -1)
    if value < 0:
        value = next(
            (i for i in numbers if kinds[i] == "number" and roles[i] not in ("time", "quality", "ignored", "loop")), -1
        )
    return tag, value


def is_paired(kinds: list[str], stamps: list[int]) -> bool:
    """True where columns of values stand behind each of several time columns."""
    return len(stamps) >= 2 and all(
        any(kinds[j] in ("number", "text") for j in range(a + 1, b))
        for a, b in zip(stamps, [*stamps[1:], len(kinds)], strict=True)
    )


def time_columns(table: Table, kinds: list[str], options: ReadOptions) -> list[int]:
    """The time column, or date and time of day; empty where there is none."""
    if options.time is not None:
        parts = [options.time] if options.time in table.names else options.time.split("+")
        return [pick(table.names, part.strip(), "--time", table.file) for part in parts]
    named = [
        i for i, n in enumerate(table.names) if take_apart(n).role == "time" and kinds[i] not in ("text", "nothing")
    ]
    stamps = [i for i, k in enumerate(kinds) if k == "time"]
    if stamps:
        return [next((i for i in stamps if i in named), stamps[0])]
    dates, clocks = ([i for i, k in enumerate(kinds) if k == kind] for kind in ("date", "clock"))
    if dates and clocks:
        return [dates[0], clocks[0]]
    if dates or clocks:
        return (dates or clocks)[:1]
    return named[:1]


def loop_column(table: Table, kinds: list[str]) -> int:
    return next(
        (
            i
            for i, n in enumerate(table.names)
            if take_apart(n).role == "loop" and kinds[i] == "text" and take_apart(n).loop == ""
        ),
        -1,
    )


def loop_names(table: Table, column: int) -> list[str]:
    """The loops named in a loop column, in the order they appear."""
    return [str(v) for v in table.columns[column].unique().to_pylist() if v is not None]


def without_loop_column(table: Table, kinds: list[str], options: ReadOptions) -> ReadOptions:
    """Options for `assign`: where a column names the loop, the names of columns need not."""
    return options if loop_column(table, kinds) < 0 else replace(options, loop=None)


def names_of(table: Table) -> tuple[str, ...]:
    """Names of the loops in a table, in the order of their columns or rows; one loop without a name gives ()."""
    kinds = [kind_of(table, i) for i in range(len(table.names))]
    column = loop_column(table, kinds)
    if column >= 0:
        return tuple(loop_names(table, column))
    tag, value = long_columns(table, kinds)
    names = list(table.names)
    if tag >= 0 and value >= 0:
        names = [str(w) for w in table.columns[tag].cast(pa.string()).unique().to_pylist() if w is not None]
    groups: dict[str, tuple[str, set[str]]] = {}
    for found in take_all(names):
        if found.role in ("process_value", "output") and found.loop:
            groups.setdefault(key_of(found.loop), (found.loop, set()))[1].add(found.role)
    return tuple(name for name, roles in groups.values() if len(roles) == 2)


def wanted_columns(head: Table, options: ReadOptions) -> tuple[set[int] | None, list[str]]:
    """Columns that the loop needs, judged by the first rows, and the kind of each; None for all of them.

    Long and paired tables need all. Errors as in `assign`: a role in no column, several loops.
    """
    kinds = [kind_of(head, i) for i in range(len(head.names))]
    stamps = [i for i, k in enumerate(kinds) if k in ("time", "date")]
    if options.shape in ("long", "paired") or min(long_columns(head, kinds)) >= 0 or is_paired(kinds, stamps):
        return None, kinds
    times = {i for i, k in enumerate(kinds) if k in ("time", "date", "clock")} | {*time_columns(head, kinds, options)}
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
