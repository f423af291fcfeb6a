"""Reading of an export from its first byte to a loop; this module runs the other parts of the package in order."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ..errors import DataError
from ..record.loop import Finding, Loop, Origin
from ..system.plurals import counted
from ..typing import IntArray
from .assemble import Assembled, assemble
from .bytes.arrow import booleans
from .bytes.options import ReadOptions
from .bytes.source import Source, limits_from, open_source
from .checks.notes import bad_findings
from .grid.align import align
from .grid.grid import Frame
from .series.shaped import Shaped
from .series.shapes import shape_table
from .settled import settled
from .table.formats import loops_of, read_table
from .table.rows import RowBook
from .table.table import Table
from .time.clock import Times
from .words.cells import shown
from .words.findings import finding

EXCEL_ROWS = (1_048_576, 65_536)
"""Rows of a sheet in Excel since 2007, and before."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Result of reading a file: the loop, and every choice made on the way.

    `rows` holds rows in, used, and by reason (they add up). `segments` (first, last sample) pairs with start times.
    `assumptions` are the guesses, each with the option that settles it. `behind` holds for every source the row of the
    table behind each sample (samples,), -1 for none; `stamps` are the times of the table's rows.
    """

    loop: Loop
    file: str
    sha256: str
    shape: str
    columns: dict[str, str]
    why: dict[str, str]
    unused: tuple[str, ...]
    time: str
    zone: str | None
    decimal: str
    separator: str
    encoding: str
    header_lines: int
    step_s: float
    mode_map: dict[str, str]
    quality: str
    units: dict[str, str]
    rows: dict[str, int]
    samples: dict[str, int]
    segments: tuple[dict[str, Any], ...]
    assumptions: tuple[str, ...]
    findings: tuple[Finding, ...]
    descriptions: dict[str, str] = field(default_factory=dict)
    behind: tuple[IntArray, ...] = field(default=(), repr=False)
    stamps: Times | None = field(default=None, repr=False)


def read_loop(file: Any, *, options: ReadOptions | None = None) -> Loop:
    """The loop in a file: path, '-' for standard input, or an object with read().

    UsageError (exit 2) for absent files, unknown loops and options out of range; DataError (exit 3) for content
    that can't be used.
    """
    return read(file, options=options).loop


def read(file: Any, *, options: ReadOptions | None = None) -> Reading:
    """The loop in a file, with columns, assumptions and rows left out. Errors as in `read_loop`."""
    options = settled(options)
    if not hasattr(file, "read") and str(file) != "-" and Path(file).is_dir():
        from .dataset import read_folder

        source, table = read_folder(Path(file), options)
    else:
        source = open_source(file, limits_from(options.limit))
        table = read_table(source, options)
        if not source.sha256:
            source = replace(source, sha256=table.sha256)
        source = replace(source, data=b"")  # only the columns are needed from here on; large files take much memory
    return reading_of(source, table, options)


def read_frame(frame: Any, *, options: ReadOptions | None = None, name: str = "data frame") -> Reading:
    """The loop in a pandas data frame, read as a file with the same columns would be."""
    from .table.frame import frame_table

    options = settled(options)
    return reading_of(Source(name, "parquet", b"", ""), frame_table(frame, name, options.decimal), options)


def reading_of(source: Source, table: Table, options: ReadOptions) -> Reading:
    dropped = {
        reason: sum(r == reason for _, r, _ in table.dropped)
        for reason in ("repeated header", "footer", "damaged", "blank")
    }
    book = RowBook(table.rows, dropped)
    if not any(table.names):
        raise DataError(
            f"{table.file} has no column names", "name columns by number, for example --time 1 --pv 2 --op 3"
        )
    _book_headers(table, book)
    _book_blank(table, book)
    # `--loop` has chosen the part; only a loop inside it is left to be found.
    within = replace(options, loop=table.attributes.get("inner")) if table.part else options
    shaped = shape_table(table, within, book)
    frame = align(shaped.series)
    _book_unaligned(shaped, frame, book)
    made = assemble(shaped, frame, options, book, table)
    guesses = (*table.assumptions, *shaped.guesses)
    if options.no_guess and guesses:
        raise DataError(
            f"{table.file}: {counted(len(guesses), 'assumption')} would be needed, the first: "
            f"{guesses[0]}",
            "say it with the option named there, or leave --no-guess out",
        )
    return _reading(source, table, shaped, made, options, book, guesses)


def _book_unaligned(shaped: Shaped, frame: Frame, book: RowBook) -> None:
    """Book rows of tags that no sample represents: they were recorded more often than the step of the loop."""
    if shaped.shape == "wide":
        return
    if shaped.shape == "paired" and len(frame.rows) > 1:
        # A row holds a sample of every tag, at different times: it is booked by its PV alone.
        frame.rows = [frame.rows[list(shaped.series).index("process_value")]]
    taken = np.concatenate(frame.rows)
    for role in shaped.series if shaped.shape == "long" else ("process_value",):
        rows = shaped.series[role].rows
        book.mark(rows[~np.isin(rows, taken)], "resampled")


def _book_blank(table: Table, book: RowBook) -> None:
    """Book lines without any content."""
    if min(column.null_count for column in table.columns) == 0:
        return
    import pyarrow.compute as pc

    book.mark(booleans(reduce(pc.and_, map(pc.is_null, table.columns))), "blank")


def _book_headers(table: Table, book: RowBook) -> None:
    """Book rows that repeat the header (pasted pages); their cells become empty without further work."""
    texts = [(name, column) for name, column in zip(table.names, table.columns, strict=True)
             if name and (pa.types.is_string(column.type) or pa.types.is_large_string(column.type))]
    if texts:
        import pyarrow.compute as pc  # a table of numbers goes without: this import takes as long as reading it

        hits = (pc.fill_null(pc.equal(pc.utf8_trim_whitespace(column), name), False) for name, column in texts)
        book.mark(booleans(reduce(pc.or_, hits)), "repeated header")


def _reading(
    source: Source,
    table: Table,
    shaped: Shaped,
    made: Assembled,
    options: ReadOptions,
    book: RowBook,
    guesses: tuple[str, ...],
) -> Reading:
    counts = book.counts()
    findings = (*shaped.findings, *bad_findings(counts), *_row_findings(table, counts),
                *_unreadable_stamps(table, shaped, book, counts))
    file = str(source.path or source.name)
    times = shaped.times
    name = shaped.assignment.loop or table.attributes.get("loop", "") or Path(source.name).name.split(".")[0] or "loop"
    columns = {k.removeprefix("extra:"): v for k, v in shaped.columns.items() if v}
    origin = Origin(
        file=None if file == "standard input" and source.path is None else file,
        sha256=source.sha256 or None,
        columns=columns,
        units=made.parts["units"],
        rows=counts["in"],
        start=made.start,
        end=made.end,
        findings=findings,
        options=options.said(),
        segment_starts=tuple(s["start"] for s in made.segments),
    )
    loop = Loop(**made.parts, name=name, origin=origin)
    modes = shaped.modes
    return Reading(
        loop=loop,
        file=file,
        sha256=source.sha256,
        shape=shaped.shape,
        columns=columns,
        why=dict(shaped.assignment.why),
        unused=tuple(shaped.assignment.unused),
        time=times.text if times.elapsed else f"{times.text}, {times.zone or 'naive local time (no zone known)'}",
        zone=times.zone,
        decimal=table.decimal,
        separator=table.separator,
        encoding=table.encoding,
        header_lines=table.header_lines,
        step_s=loop.step_s,
        mode_map=dict(zip(modes.words, modes.meaning, strict=True)) if modes else {},
        quality=shaped.quality,
        units=loop.units,
        rows=counts,
        samples=made.samples,
        segments=made.segments,
        assumptions=guesses,
        findings=findings,
        descriptions={k: v for k, v in shaped.described.items() if v},
        behind=made.rows,
        stamps=None if shaped.shape == "paired" or "time" not in shaped.columns else times,
    )


def _unreadable_stamps(table: Table, shaped: Shaped, book: RowBook, counts: dict[str, int]) -> list[Finding]:
    """Finding on rows left out because their time can't be read: their number, and the first one as written."""
    row = book.first("no time")
    if row is None:
        return []
    name = shaped.columns.get("time", "").split("+")[0]
    column = table.names.index(name) if name in table.names else None
    cell = "" if column is None else table.cell(row, column)
    count, share = counts["no time"], counts["no time"] / counts["in"]
    at = f"row {row + 1:,}" if column is None else table.where(row, column)
    what = f"holds {shown(cell)}" if cell.strip() else "is empty or says that there is none"
    return [finding("unreadable-stamps", {"rows": count, "share": share, "row": row + 1, "cell": cell}, rows=count,
                    have="rows have" if count > 1 else "row has", be="are" if count > 1 else "is", share=100 * share,
                    at=at, what=what)]


def _row_findings(table: Table, counts: dict[str, int]) -> list[Finding]:
    """Findings on the number and the form of rows."""
    found = []
    if counts.get("damaged"):
        line, _, text = next(d for d in table.dropped if d[1] == "damaged")
        found.append(finding("damaged-rows", {"rows": counts["damaged"], "line": line}, line=line, text=shown(text),
                             rows=counted(counts["damaged"], "row"), have="has" if counts["damaged"] == 1 else "have"))
    if counts["in"] + table.header_lines in EXCEL_ROWS:
        found.append(finding("excel-cut", {"rows": counts["in"]}, rows=counts["in"]))
    return found


def loops_in(file: Any, *, options: ReadOptions | None = None) -> tuple[str, ...]:
    """Names of the loops in a file, in order; empty where it holds one loop without a name."""
    options = settled(options)
    return loops_of(open_source(file, limits_from(options.limit)), options)
