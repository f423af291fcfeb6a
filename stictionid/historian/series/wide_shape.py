"""Series per role from wide tables (one column per signal)."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ...errors import DataError, UsageError
from ...typing import FloatArray, IntArray
from ..bytes.arrow import booleans
from ..bytes.options import ReadOptions
from ..table.columns import loop_column, loop_names, time_columns, without_loop_column
from ..table.rows import RowBook
from ..table.table import Table
from ..time.clock import Times
from ..words.assign import Assignment, assign
from ..words.cells import brief, check_thousands, shown, to_numbers
from ..words.modes import read_modes
from ..words.quality import Quality
from ..words.roles import listing, pick, take_apart
from .shaped import Series, Shaped, apply_quality, order_of, read_quality_column, times_of


def shape_wide(table: Table, kinds: list[str], options: ReadOptions, book: RowBook) -> Shaped:
    """Series of the loop's columns, which share their stamps."""
    stamps = time_columns(table, kinds, options)
    if not stamps and options.step_s is None:
        raise DataError(
            f"{table.file} has no time column",
            f"give --step SECONDS, or name it with --time; columns: {listing(table.names)}",
        )
    mask = next((i for i, n in enumerate(table.names) if n.strip().lower() == "used"), -1)
    quality_columns = {
        i for i, n in enumerate(table.names) if take_apart(n).role == "quality" and i not in stamps
    }
    numeric = {i for i, k in enumerate(kinds) if k == "number" or k == "nothing"} - quality_columns
    rows = _loop_rows(table, kinds, options, book)
    assignment = assign(
        table.names, without_loop_column(table, kinds, options), table.file, skip=set(stamps), numeric=numeric,
        encoding=table.encoding,
    )
    if assignment.loop == "" and options.loop:
        assignment.loop = options.loop
    shaped = Shaped("wide", assignment)
    quality_columns.discard(mask)
    if stamps:
        times = times_of(table, stamps, options)
        shaped.columns["time"] = "+".join(table.names[i] or f"column {i + 1}" for i in stamps)
        book.mark(~times.valid, "no time")
        keep = rows[times.valid[rows]]
        order, shaped.times = order_of(
            times, options, keep, lambda: _worth(table, assignment, quality_columns, options)[keep]
        )
        shaped.orders.append(order)
        shaped.guesses.extend(times.assumptions)
        book.mark(keep[order.duplicates], "duplicate")
        rows, ns = keep[order.index], order.ns
    else:
        ns = np.rint(np.arange(rows.size) * (options.step_s or 1.0) * 1e9).astype(np.int64)
        text = f"no time column, {options.step_s:g} s per row as said"
        shaped.times = Times(ns, np.ones(ns.size, np.bool_), True, text)
    _fill_wide(shaped, table, options, quality_columns, rows, ns)
    if mask >= 0:
        # Written by `read -o`: samples that stay in the record but do not count.
        shaped.series["mask"] = Series(ns, to_numbers(table.columns[mask]).values[rows], rows)
    return shaped


def _worth(table: Table, assignment: Assignment, quality_columns: set[int], options: ReadOptions) -> FloatArray:
    """Number of usable values among PV and OP in each row (n,); values of bad quality do not count."""
    found = np.zeros(table.rows)
    for role in ("process_value", "output"):
        column = assignment.index[role]
        quality = _quality_for(column, table, quality_columns, options)
        there = ~np.isnan(to_numbers(table.columns[column], table.decimal).values)
        found += there if quality is None else there & ~quality.bad
    return found


def _fill_wide(
    shaped: Shaped,
    table: Table,
    options: ReadOptions,
    quality_columns: set[int],
    rows: IntArray,
    ns: IntArray,
) -> None:
    """Values of every role in the rows of the shared stamps."""
    whole = rows.size == table.rows and bool((rows == np.arange(table.rows)).all())
    for role, column in shaped.assignment.columns:
        name = table.names[column] or str(column + 1)
        shaped.columns[role] = name
        shaped.units[role] = table.units[column]
        shaped.described[role] = table.descriptions[column] if table.descriptions else ""
        if role == "mode":
            shaped.modes = read_modes(table.columns[column], options.mode_map, name)
            values = shaped.modes.codes
        else:
            if options.decimal is None:
                check_thousands(table.columns[column], table.decimal, table.place(column))
            numbers = to_numbers(table.columns[column], table.decimal)
            values = numbers.values
            # A header that is repeated within the data is booked as such.
            shaped.words[role] = {w: c for w, c in numbers.words.items() if w != name.strip()}
            quality = _quality_for(column, table, quality_columns, options)
            if quality is not None:
                values = apply_quality(values, quality, shaped, role)
        shaped.series[role] = Series(ns, values if whole else values[rows], rows)


def _quality_for(column: int, table: Table, columns: set[int], options: ReadOptions) -> Quality | None:
    """Quality column of a value column: by its name, else the only one, else the column right of it."""
    if options.quality is not None:
        return read_quality_column(pick(table.names, options.quality, "--quality", table.file), table, options)
    name = table.names[column].lower()
    named = [i for i in columns if table.names[i].lower().startswith(name) and name]
    mine = [*named, *(columns if len(columns) == 1 else columns & {column + 1})]
    return read_quality_column(mine[0], table, options) if mine else None


def _loop_rows(table: Table, kinds: list[str], options: ReadOptions, book: RowBook) -> IntArray:
    """Rows of the wanted loop where a column names loops, else all rows."""
    column = loop_column(table, kinds)
    loops = loop_names(table, column) if column >= 0 else []
    if not loops or (len(loops) == 1 and options.loop in (None, loops[0])):
        return np.arange(table.rows)
    if options.loop is None:
        raise UsageError(
            f"{table.file} holds {len(loops)} loops: {listing(loops)}", f"choose one with --loop {brief(loops[0])}"
        )
    if options.loop not in loops:
        raise UsageError(f"{table.file} has no loop {shown(options.loop)}", f"loops found: {listing(loops)}")
    import pyarrow.compute as pc

    mask = booleans(pc.equal(table.columns[column].cast(pa.string()), options.loop))
    book.mark(~mask, "other loop")
    return np.flatnonzero(mask)
