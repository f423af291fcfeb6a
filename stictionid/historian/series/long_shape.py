"""Series per role from long tables (tag, time, value, quality) and paired columns (time1, value1, time2, value2)."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pyarrow as pa

from ...errors import DataError
from ...typing import FloatArray, IntArray
from ..bytes.arrow import coded, numbers
from ..bytes.options import ReadOptions
from ..table.rows import RowBook
from ..table.table import Table
from ..words.assign import assign
from ..words.cells import check_thousands, shown, to_numbers
from ..words.modes import read_modes
from ..words.roles import take_apart, tidy
from .shaped import Series, Shaped, apply_quality, order_of, read_quality_column, times_of


def shape_long(
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


def shape_paired(table: Table, options: ReadOptions, book: RowBook, stamps: list[int], kinds: list[str]) -> Shaped:
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
