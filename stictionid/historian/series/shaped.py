"""Series of one loop as taken from a table, with their stamps and the information gathered with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...errors import DataError
from ...record.loop import Finding
from ...typing import FloatArray, IntArray
from ..bytes.options import ReadOptions
from ..table.table import Table
from ..time.clock import Order, Times, apply_zone, put_in_order
from ..time.stamps import parse_times
from ..words.assign import Assignment
from ..words.cells import shown
from ..words.modes import Modes
from ..words.quality import Quality, read_quality


@dataclass
class Series:
    """One signal: increasing stamps, values (NaN where bad), and the file row of each."""

    ns: IntArray
    values: FloatArray
    rows: IntArray


@dataclass
class Shaped:
    """The loop's series with roles, units, stamps, modes, guesses and findings.

    `times` are the stamps of the table's rows; without a time column they are the steps of the loop's samples.
    """

    shape: str
    assignment: Assignment
    times: Times = field(init=False)
    columns: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    series: dict[str, Series] = field(default_factory=dict)
    orders: list[Order] = field(default_factory=list)
    modes: Modes | None = None
    words: dict[str, dict[str, int]] = field(default_factory=dict)
    uncertain: int = 0
    quality: str = ""
    described: dict[str, str] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    @property
    def guesses(self) -> list[str]:
        """Assumptions made on the way, from the assignment of columns on."""
        return self.assignment.guesses


def times_of(table: Table, columns: list[int], options: ReadOptions) -> Times:
    """The stamps of one or two columns, in the zone that the options give."""
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
    """Rows `keep` in time order, after the zone; `worth` ranks rows that have the same stamp."""
    times = apply_zone(times, options.zone, keep)
    zoned = options.zone is not None or times.zone is not None
    return put_in_order(times.ns[keep], elapsed=times.elapsed, zoned=zoned, worth=worth), times


def read_quality_column(column: int, table: Table, options: ReadOptions) -> Quality:
    return read_quality(table.columns[column], table.names[column], options.quality_kind)


def apply_quality(values: FloatArray, quality: Quality, shaped: Shaped, role: str) -> FloatArray:
    shaped.quality = quality.kind
    shaped.uncertain += int(np.count_nonzero(quality.uncertain)) if role == "process_value" else 0
    shaped.columns.setdefault("quality", "")
    return np.where(quality.bad, np.nan, values) if quality.bad.any() else values
