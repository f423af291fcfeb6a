"""Recognition of the shape of a table, and the series of one loop in it, one for each role.

A wide table has one column per signal, a long one rows of tag, time, value and quality, and a paired one a time column
before each value column.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pyarrow as pa

from ...errors import DataError, UsageError
from ...typing import FloatArray, IntArray
from ..bytes.arrow import booleans, coded, numbers
from ..bytes.options import ReadOptions
from ..table.columns import (
    is_paired,
    kind_of,
    long_columns,
    loop_column,
    loop_names,
    time_columns,
    without_loop_column,
)
from ..table.rows import RowBook
from ..table.table import Table
from ..time.clock import Times
from ..words.assign import Assignment, assign
from ..words.cells import brief, check_thousands, shown, to_numbers
from ..words.modes import read_modes
from ..words.quality import Quality
from ..words.roles import listing, pick, take_apart, tidy
from .shaped import Series, Shaped, apply_quality, order_of, read_quality_column, times_of


def shape_table(table: Table, options: ReadOptions, book: RowBook) -> Shaped:
    """The series of the chosen loop. DataError and UsageError as in `assign`."""
    kinds = [kind_of(table, i) for i in range(len(table.names))]
    tag_column, value_column = long_columns(table, kinds)
    shape = options.shape
    stamps = [i for i, k in enumerate(kinds) if k in ("time", "date")]
    if shape == "long" or (shape is None and tag_column >= 0 and value_column >= 0):
        if tag_column < 0 or value_column < 0:
            raise DataError(
                f"{table.file} has no column of tags and one of values", "leave --shape out, or export it again"
            )
        return _long(table, options, book, tag_column, value_column, time_columns(table, kinds, options))
    if shape == "paired" or (shape is None and is_paired(kinds, stamps)):
        if not stamps:
            raise DataError(f"{table.file} has no time columns to pair values with", "leave --shape out")
        return _paired(table, options, book, stamps, kinds)
    return _wide(table, kinds, options, book)


def _wide(table: Table, kinds: list[str], options: ReadOptions, book: RowBook) -> Shaped:
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
            found = to_numbers(table.columns[column], table.decimal)
            values = found.values
            # A header that is repeated within the data is booked as such.
            shaped.words[role] = {w: c for w, c in found.words.items() if w != name.strip()}
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


def _long(
    table: Table, options: ReadOptions, book: RowBook, tag_column: int, value_column: int, time_columns: list[int]
) -> Shaped:
    """Series of the loop's tags in a long table."""
    if not time_columns:
        raise DataError(f"{table.file} is a long table (tag, value) without a time column", "name it with --time")
    found, code = coded(table.columns[tag_column].cast(pa.string()), missing=-1)
    words = tuple(str(w).strip() for w in found)
    headers = [i for i, w in enumerate(words) if tidy(w) == tidy(table.names[tag_column])]
    book.mark(np.isin(code, headers), "repeated header")
    assignment = assign(words, options, table.file, skip=set(), numeric=set(range(len(words))) - set(headers),
                        encoding=table.encoding)
    assignment.unused = [w for w in assignment.unused if w not in {words[h] for h in headers}]
    shaped = Shaped("long", assignment, columns={"time": "+".join(table.names[i] for i in time_columns)})
    shaped.times = times_of(table, time_columns, options)
    shaped.guesses.extend(shaped.times.assumptions)
    if options.decimal is None:
        check_thousands(table.columns[value_column], table.decimal, table.place(value_column))
    values = to_numbers(table.columns[value_column], table.decimal).values
    quality = [i for i, n in enumerate(table.names)
               if take_apart(n).role == "quality" and i not in (tag_column, value_column)]
    if quality:
        values = apply_quality(values, read_quality_column(quality[0], table, options), shaped, "process_value")
        shaped.columns["quality"] = table.names[quality[0]]
    unit_column = next(
        (i for i, n in enumerate(table.names) if tidy(n) in ("unit", "units", "uom", "eu", "einheit", "eng unit")), None
    )
    book.mark(~np.isin(code, [i for _, i in assignment.columns]), "other tag")
    for role, place in assignment.columns:
        mine = np.flatnonzero(code == place)
        shaped.columns[role] = words[place]
        shaped.units[role] = (
            str(table.columns[unit_column][int(mine[0])].as_py() or "") if unit_column is not None and mine.size else ""
        )
        column = table.columns[value_column].take(numbers(mine)) if role == "mode" else None
        _add(shaped, role, mine, values, column, options, book, table)
    return shaped


def _add(
    shaped: Shaped,
    role: str,
    mine: IntArray,
    values: FloatArray,
    modes: Any,
    options: ReadOptions,
    book: RowBook,
    table: Table,
) -> None:
    """One tag's rows, in time order, as a series."""
    times = shaped.times
    book.mark(mine[~times.valid[mine]], "no time")
    keep = mine[times.valid[mine]]
    if not keep.size:
        raise DataError(f"{table.file}: tag {shown(shaped.columns[role])} has no rows with a time", "export it again")
    own = values[keep]
    if modes is not None:
        shaped.modes = read_modes(modes, options.mode_map, shaped.columns[role])
        own = shaped.modes.codes[times.valid[mine]]
    order, _ = order_of(times, options, keep, lambda: (~np.isnan(own)).astype(np.float64))
    shaped.orders.append(order)
    book.mark(keep[order.duplicates], "duplicate")
    shaped.series[role] = Series(order.ns, own[order.index], keep[order.index])


def _paired(table: Table, options: ReadOptions, book: RowBook, stamps: list[int], kinds: list[str]) -> Shaped:
    """Series of paired columns: every value column belongs to the time column before it."""
    names = list(table.names)
    owner: dict[int, int] = {}
    for first, end in zip(stamps, [*stamps[1:], len(names)], strict=True):
        for column in range(first + 1, end):
            if kinds[column] in ("number", "text", "nothing"):
                owner[column] = first
                names[column] = _paired_name(table, first, column)
    assignment = assign(
        tuple(names),
        options,
        table.file,
        skip=set(stamps),
        numeric={c for c in owner if kinds[c] in ("number", "nothing")},
        encoding=table.encoding,
    )
    for _, column in assignment.columns:
        if column not in owner:
            raise DataError(
                f"{table.file}: column {shown(names[column])} has no time column before it", "leave --shape out"
            )
    time = table.names[owner[assignment.index["process_value"]]] or "time"
    shaped = Shaped("paired", assignment, columns={"time": time})
    for role, column in assignment.columns:
        shaped.columns[role], shaped.units[role] = names[column], table.units[column]
        shaped.times = times_of(table, [owner[column]], options)
        if role == "process_value":
            shaped.guesses.extend([g for g in shaped.times.assumptions if g not in shaped.guesses])
        found = to_numbers(table.columns[column], table.decimal)
        shaped.words[role] = found.words
        rows = np.flatnonzero(shaped.times.valid)
        # A row holds one sample of every tag; it is booked by its PV.
        own_book = book if role == "process_value" else RowBook(table.rows, {})
        own_book.mark(~shaped.times.valid, "no time")
        mode = table.columns[column].take(numbers(rows)) if role == "mode" else None
        _add(shaped, role, rows, found.values, mode, options, own_book, table)
    return shaped


def _paired_name(table: Table, time: int, column: int) -> str:
    """The tag of a pair: the name of its value column, else of its time column, else the cell above in the header."""
    above = [row[i] for row in table.header_cells for i in (column, time) if i < len(row)]
    for name in (table.names[column], table.names[time], *above):
        bare = re.sub(
            r"[\s_\-.]*(?:value|val|wert)\s*\d*\Z|[\s_\-.]*(?:time ?stamp|time|date)\s*\d*\Z",
            "",
            name,
            flags=re.IGNORECASE,
        ).strip()
        if bare and take_apart(bare).role in ("setpoint", "process_value", "output", "position", "mode"):
            return bare
    return table.names[column] or f"column {column + 1}"
