"""Table of an export as columns, parsed from text by pyarrow.csv or taken from Arrow, with a list of dropped lines."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import pyarrow as pa

from ...errors import DataError
from ..bytes.encoding import Text, to_utf8
from ..bytes.options import ReadOptions
from ..bytes.source import Limits, Source, in_short
from ..words.cells import NULLS, shown
from ..words.roles import unit_in
from .layout import Layout, find_layout, split_line

MIN_THREADED_BYTES = 1 << 20
"""Text from which on it is parsed by several threads."""
MAX_DAMAGED_SHARE = 0.5
"""Share of lines with a wrong number of cells above which the separator is wrong or the file is no table."""
_FOOTER = re.compile(
    r"\(?\s*\d*\s*(rows?|records?|lines?|Zeilen|lignes)\b|end of|total|summary|ende\b|---|===|#", re.IGNORECASE
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Table(Layout):
    """Columns of an export with their layout. `columns` are pyarrow arrays (rows,).

    `dropped` lists lines that are no rows: (line, reason, text) with reason "damaged" or "footer". `part` is True for
    one of several tables of a file: `--loop` has named it, and the attribute "inner" the loop to be found in it.
    """

    file: str
    columns: tuple[Any, ...]
    dropped: tuple[tuple[int, str, str], ...] = ()
    encoding: str = ""
    attributes: dict[str, str] = field(default_factory=dict)
    sha256: str = ""
    part: bool = False

    @property
    def rows(self) -> int:
        """Number of rows of the columns."""
        return len(self.columns[0]) if self.columns else 0

    def line(self, row: int) -> int:
        """1-based line of the file that holds row `row` (0-based); lines that are no rows are counted."""
        line = self.first_line + row
        for dropped, _, _ in self.dropped:
            if dropped <= line:
                line += 1
        return line

    def cell(self, row: int, column: int) -> str:
        """Text of one cell, "" where it is empty; of a stamp beyond the calendar the bare number."""
        scalar = self.columns[column][row]
        if not scalar.is_valid:
            return ""
        try:
            return str(scalar.as_py())
        except (OverflowError, ValueError):
            return str(getattr(scalar, "value", ""))

    def where(self, row: int, column: int) -> str:
        """File, line (of text; row of Parquet) and column of a cell, for an error message."""
        name = self.names[column] or str(column + 1)
        at = f"line {self.line(row):,}" if self.separator else f"row {row + 1:,}"
        return f"{self.file}, {at}, column {shown(name)}"

    def place(self, column: int) -> Callable[[int], str]:
        """`where` of one column: a function of the row."""
        return lambda row: self.where(row, column)


def text_table(source: Source, options: ReadOptions, limits: Limits) -> Table:
    """The table in a text that is held whole."""
    text = to_utf8(source.data, source.name, options.encoding)
    data = _html_rows(text.data)
    layout = find_layout(data, source.name, separator=options.separator, header=options.header, decimal=options.decimal)
    if layout.separator == " ":
        data = re.sub(rb"[ \t]+", b"\t", re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", data))
        layout = find_layout(data, source.name, separator="\t", header=layout.header_lines, decimal=layout.decimal)
    limits.check("columns", len(layout.names), source.name)
    limits.check("rows", data.count(b"\n"), source.name, "cut it into pieces")
    piece, dropped = parse(data, layout, source.name)
    refuse_damage(piece.num_rows, dropped, layout, source.name)
    return as_table(source.name, layout, tuple(piece.columns), dropped, text)


def as_table(
    name: str, layout: Layout, columns: tuple[Any, ...], dropped: tuple[tuple[int, str, str], ...], text: Text
) -> Table:
    """Table of parsed columns, with layout, encoding and dropped lines."""
    found = {f.name: getattr(layout, f.name) for f in fields(layout)}
    if text.guessed:
        found["assumptions"] += (f"encoding {text.encoding} (--encoding NAME)",)
    return Table(**found, file=name, columns=columns, dropped=dropped, encoding=text.encoding)


def _html_rows(data: bytes) -> bytes:
    """Rows of an HTML table (saved by some systems as .xls) as tab-separated text; other text unchanged."""
    head = data[:2000].lower()
    if b"<table" not in head and b"<html" not in head:
        return data
    from .html_table import rows_of

    return rows_of(data.decode("utf-8", "replace")).encode()


def parse(
    data: bytes, layout: Layout, name: str, wanted: list[int] | None = None, types: dict[str, Any] | None = None
) -> tuple[Any, tuple[tuple[int, str, str], ...]]:
    """An Arrow table of the columns (named by number; only the wanted ones) and the lines that are no rows.

    `types` are those of earlier pieces of the file; where a cell does not fit them they are found anew.
    """
    from pyarrow import csv

    width = len(layout.names)
    bad: list[tuple[int | None, str]] = []

    def note(row: Any) -> str:
        bad.append((row.number, row.text))
        return "skip"

    body = pa.py_buffer(data).slice(layout.offset)
    block = min(1 << 23, len(data) + 64)  # the whole block is allocated, whatever the file needs

    def read(exact: bool, types: dict[str, Any] | None) -> Any:
        """Read the text; `exact` notes blank lines as rows of one cell and numbers every row, at half the speed."""
        bad.clear()
        return csv.read_csv(
            pa.BufferReader(body),
            read_options=csv.ReadOptions(
                use_threads=not exact, block_size=block, column_names=[str(i) for i in range(width)]
            ),
            parse_options=csv.ParseOptions(
                delimiter=layout.separator, invalid_row_handler=note, ignore_empty_lines=not exact
            ),
            convert_options=csv.ConvertOptions(
                null_values=list(NULLS),
                strings_can_be_null=True,
                true_values=[],
                false_values=[],
                decimal_point=layout.decimal,
                check_utf8=False,
                include_columns=None if wanted is None else [str(i) for i in wanted],
                column_types=types,
            ),
        )

    try:
        # Small files are read exactly at once: threads would cost them more than a second reading.
        small = len(data) < MIN_THREADED_BYTES
        try:
            table = read(small, types)
        except pa.ArrowInvalid:
            if types is None:
                raise
            types = None
            table = read(small, types)
        lines = data.count(b"\n", layout.offset) + (not data.endswith(b"\n"))
        if not small and (bad or table.num_rows != lines):
            table = read(True, types)
    except (pa.ArrowInvalid, pa.ArrowException) as error:
        raise DataError(f"{name} can't be parsed: {in_short(error)}", "check --separator and --header") from None
    return table, tuple(_dropped(bad, layout))


def refuse_damage(rows: int, dropped: tuple[tuple[int, str, str], ...], layout: Layout, name: str) -> None:
    """DataError where most lines do not have the right number of cells."""
    damaged = sum(reason == "damaged" for _, reason, _ in dropped)
    if rows == 0 or damaged > MAX_DAMAGED_SHARE * (rows + damaged):
        line, _, text = next((d for d in dropped if d[1] == "damaged"), (layout.first_line, "", ""))
        raise DataError(
            f"{name}: {damaged:,} of {rows + damaged:,} rows do not have {len(layout.names)} cells, "
            f"the first is line {line}: {shown(text)}",
            "check --separator and --header",
        )


def _dropped(bad: list[tuple[int | None, str]], layout: Layout) -> Iterator[tuple[int, str, str]]:
    """Lines without the right number of cells, sorted into footers, repeated headers and damaged rows."""
    headers = {tuple(c for c in row if c) for row in layout.header_cells}
    for number, text in bad:
        line = layout.first_line + (number or 1) - 1
        stripped = text.strip().strip(layout.separator)
        if not stripped:
            yield line, "blank", ""
        elif tuple(c for c in split_line(stripped, layout.separator) if c) in headers:
            yield line, "repeated header", stripped
        elif _FOOTER.match(stripped):
            yield line, "footer", stripped
        else:
            yield line, "damaged", stripped


def table_from_arrow(table: Any, name: str) -> Table:
    """An Arrow table (of Parquet or of a data frame) as a Table."""
    if table.num_rows == 0:
        raise DataError(f"{name} has no rows", "export it again")
    try:
        [(f.name, f.type.tz if pa.types.is_timestamp(f.type) else "") for f in table.schema]
    except UnicodeDecodeError:
        raise DataError(f"{name} is damaged Parquet: its schema is not text", "write or copy it again") from None
    keep = [i for i, f in enumerate(table.schema) if not pa.types.is_nested(f.type)]
    columns = [table.schema.field(i) for i in keep]
    for i, one in zip(keep, columns, strict=True):
        if pa.types.is_string(one.type) or pa.types.is_large_string(one.type) or pa.types.is_dictionary(one.type):
            try:
                table.column(i).validate(full=True)
            except pa.ArrowException:
                raise DataError(
                    f"{name}, column {shown(one.name)}: its text is damaged", "write or copy it again"
                ) from None
    units = [(f.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") for f in columns]
    meta = {
        k.decode("utf-8", "replace"): v.decode("utf-8", "replace") for k, v in (table.schema.metadata or {}).items()
    }
    return Table(
        file=name,
        names=tuple(f.name for f in columns),
        columns=tuple(table.column(i) for i in keep),
        units=tuple(u or unit_in(f.name) for u, f in zip(units, columns, strict=True)),
        attributes=meta,
    )
