"""The shape of a table (wide, long, paired) and the series of one loop inside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, UsageError
from ..loop import FloatArray
from .arrow import booleans
from .assign import Assignment, assign
from .cells import brief, check_thousands, shown, to_numbers
from .clock import Order, put_in_order
from .datetext import looks_like_time
from .modes import Modes, read_modes
from .options import ReadOptions
from .quality import Quality, read_quality
from .roles import listing, pick, take_apart
from .rows import RowBook
from .stamps import Times, parse_times
from .table import Table
from .zones import apply_zone

IntArray = NDArray[np.int64]
MAX_TAGS = 5000
"""Different texts up to which a text column of a long table is taken for its tags."""
_PEEK = 50


@dataclass
class Series:
    """One signal: increasing stamps, values (NaN where bad), and the file row of each."""

    ns: IntArray
    values: FloatArray
    rows: IntArray


@dataclass
class Shaped:
    """The loop's series with everything learnt on the way; `shared` when all series have the same stamps."""

    shape: str
    assignment: Assignment
    columns: dict[str, str]
    units: dict[str, str]
    series: dict[str, Series]
    times: Times | None
    orders: list[Order] = field(default_factory=list)
    modes: Modes | None = None
    words: dict[str, dict[str, int]] = field(default_factory=dict)
    uncertain: int = 0
    quality: str = ""
    guesses: list[str] = field(default_factory=list)
    described: dict[str, str] = field(default_factory=dict)


def shape_table(table: Table, options: ReadOptions, book: RowBook) -> Shaped:
    """The series of the chosen loop. DataError and UsageError as in `assign`."""
    kinds = [_kind(table, i) for i in range(len(table.names))]
    tag_column, value_column = _long_columns(table, kinds)
    shape = options.shape
    times = [i for i, k in enumerate(kinds) if k in ("time", "date", "clock")]
    if shape == "long" or (shape is None and tag_column >= 0 and value_column >= 0):
        from .long_shape import shape_long

        if tag_column < 0 or value_column < 0:
            raise DataError(
                f"{table.file} has no column of tags and one of values", "leave --shape out, or export it again"
            )
        return shape_long(table, options, book, tag_column, value_column, _time_columns(table, kinds, options))
    if shape == "paired" or (shape is None and _is_paired(kinds, times)):
        from .long_shape import shape_paired

        if not any(kinds[i] != "clock" for i in times):
            raise DataError(f"{table.file} has no time columns to pair values with", "leave --shape out")
        return shape_paired(table, options, book, [i for i in times if kinds[i] != "clock"], kinds)
    return _shape_wide(table, kinds, options, book)


def _kind(table: Table, column: int) -> str:
    """What a column holds: time, date, clock (time of day), number, text or nothing."""
    import pyarrow as pa

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


def _long_columns(table: Table, kinds: list[str]) -> tuple[int, int]:
    """Columns of tags and of values in a long table, -1 where there is none."""
    import pyarrow as pa

    roles = [take_apart(n).role for n in table.names]
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


def _is_paired(kinds: list[str], times: list[int]) -> bool:
    stamps = [i for i in times if kinds[i] == "time" or kinds[i] == "date"]
    return len(stamps) >= 2 and all(
        any(kinds[j] in ("number", "text") for j in range(a + 1, b))
        for a, b in zip(stamps, [*stamps[1:], len(kinds)], strict=True)
    )


def _time_columns(table: Table, kinds: list[str], options: ReadOptions) -> list[int]:
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


def times_of(table: Table, columns: list[int], options: ReadOptions) -> Times:
    """The stamps of one or two columns, in the zone that was said."""
    times = parse_times(
        [table.columns[i] for i in columns],
        table.names[columns[0]],
        table.units[columns[0]],
        dayfirst=options.dayfirst,
        time_format=options.time_format,
        place=table.place(columns[0]),
    )
    if not times.valid.any():
        raise DataError(
            f"{table.where(0, columns[0])}: {shown(table.cell(0, columns[0]))} is no time",
            "name the time column with --time, or give --step SECONDS",
        )
    return times


def order_of(
    times: Times, options: ReadOptions, keep: IntArray, worth: Callable[[], FloatArray] | None = None
) -> tuple[Order, Times]:
    """Rows `keep` in time order, after the zone; `worth` gives how good each of them is, for those with one stamp."""
    times = apply_zone(times, options.zone, keep)
    zoned = options.zone is not None or times.zone is not None
    order = put_in_order(times.ns[keep], elapsed=times.elapsed, zoned=zoned, worth=worth)
    return order, times


def _shape_wide(table: Table, kinds: list[str], options: ReadOptions, book: RowBook) -> Shaped:
    time_columns = _time_columns(table, kinds, options)
    if not time_columns and options.step_s is None:
        raise DataError(
            f"{table.file} has no time column",
            f"give --step SECONDS, or name it with --time; columns: {listing(table.names)}",
        )
    mask = next((i for i, n in enumerate(table.names) if n.strip().lower() == "used"), -1)
    quality_columns = {
        i for i, n in enumerate(table.names) if take_apart(n).role == "quality" and i not in time_columns
    }
    numeric = {i for i, k in enumerate(kinds) if k == "number" or k == "nothing"} - quality_columns
    rows = _loop_rows(table, kinds, options, book)
    assignment = assign(
        table.names, _without_loop_column(table, kinds, options), table.file, skip=set(time_columns), numeric=numeric
    )
    if assignment.loop == "" and options.loop:
        assignment.loop = options.loop
    shaped = Shaped("wide", assignment, {}, {}, {}, None, guesses=list(assignment.guesses))
    if time_columns:
        times = times_of(table, time_columns, options)
        shaped.columns["time"] = "+".join(table.names[i] or f"column {i + 1}" for i in time_columns)
        book.mark(~times.valid, "no time")
        keep = np.flatnonzero(times.valid) if rows is None else rows[times.valid[rows]]
        order, times = order_of(
            times, options, keep, lambda: _worth(table, assignment, quality_columns - {mask}, options)[keep]
        )
        shaped.times, shaped.orders = times, [order]
        shaped.guesses += times.assumptions
        book.mark(keep[order.duplicates], "duplicate")
        index, ns = keep[order.index], order.ns
    else:
        index = np.arange(table.rows) if rows is None else rows
        ns = np.rint(np.arange(index.size) * (options.step_s or 1.0) * 1e9).astype(np.int64)
    _fill_wide(shaped, table, options, book, quality_columns - {mask}, index, ns)
    if mask >= 0:
        # Written by `read -o`: samples that stay in the record but do not count.
        shaped.series["mask"] = Series(ns, to_numbers(table.columns[mask]).values[index], index)
    return shaped


def _worth(table: Table, assignment: Assignment, quality_columns: set[int], options: ReadOptions) -> FloatArray:
    """How many of PV and OP each row has (n,), bad quality counted as nothing."""
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
    book: RowBook,
    quality_columns: set[int],
    index: IntArray,
    ns: IntArray,
) -> None:
    """Values of every role on the shared stamps."""
    whole = (
        index.size == table.rows and bool((index == np.arange(table.rows)).all()) if index.size == table.rows else False
    )
    for role, column in [
        *shaped.assignment.index.items(),
        *((f"extra:{n}", i) for n, i in shaped.assignment.extras.items()),
    ]:
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
                values = _apply_quality(values, quality, shaped, book, role)
        shaped.series[role] = Series(ns, values if whole else values[index], index)


def _quality_for(column: int, table: Table, columns: set[int], options: ReadOptions) -> Quality | None:
    """The quality column that belongs to a value column: by its name, by standing right behind it, or the only one."""
    if options.quality is not None:
        return _read_quality(pick(table.names, options.quality, "--quality", table.file), table, options)
    if not columns:
        return None
    name = table.names[column].lower()
    mine = [i for i in columns if table.names[i].lower().startswith(name) and name]
    if not mine and len(columns) == 1:
        mine = list(columns)
    if not mine and column + 1 in columns:
        mine = [column + 1]
    return _read_quality(mine[0], table, options) if mine else None


def _read_quality(column: int, table: Table, options: ReadOptions) -> Quality:
    return read_quality(table.columns[column], table.names[column], options.quality_kind)


def _apply_quality(values: FloatArray, quality: Quality, shaped: Shaped, book: RowBook, role: str) -> FloatArray:
    shaped.quality = quality.kind
    shaped.uncertain += int(np.count_nonzero(quality.uncertain)) if role == "process_value" else 0
    shaped.columns.setdefault("quality", "")
    if quality.bad.any():
        values = np.where(quality.bad, np.nan, values)
    return values


def _loop_column(table: Table, kinds: list[str]) -> int:
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


def _loop_rows(table: Table, kinds: list[str], options: ReadOptions, book: RowBook) -> IntArray | None:
    """Rows of the wanted loop where a column names loops; None for all rows."""
    import pyarrow as pa
    import pyarrow.compute as pc

    column = _loop_column(table, kinds)
    if column < 0:
        return None
    loops = loop_names(table, column)
    if not loops or (len(loops) == 1 and options.loop in (None, loops[0])):
        return None
    if options.loop is None:
        raise UsageError(
            f"{table.file} holds {len(loops)} loops: {listing(loops)}", f"choose one with --loop {brief(loops[0])}"
        )
    if options.loop not in loops:
        raise UsageError(f"{table.file} has no loop {shown(options.loop)}", f"loops found: {listing(loops)}")
    wanted = pc.fill_null(pc.equal(table.columns[column].cast(pa.string()), options.loop), False)
    mask = booleans(wanted)
    book.mark(~mask, "other loop")
    return np.flatnonzero(mask)


def _without_loop_column(table: Table, kinds: list[str], options: ReadOptions) -> ReadOptions:
    """Options for `assign`: where a column names the loop, its columns don't."""
    from dataclasses import replace

    return options if _loop_column(table, kinds) < 0 else replace(options, loop=None)
