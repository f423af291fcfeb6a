"""Reader of large text files in pieces: only the wanted columns are kept, so that memory grows with the rows only."""

from __future__ import annotations

import codecs
from dataclasses import replace
from typing import Any

import pyarrow as pa

from ...errors import DataError
from ..bytes.encoding import to_utf8
from ..bytes.options import ReadOptions
from ..bytes.source import Limits, Source, pieces
from .columns import by_rows, kind_of, wanted_columns, without_others
from .layout import Layout, find_layout, offset_of
from .table import Table, as_table, parse, refuse_damage, text_table

HEAD_BYTES = 4 << 20
"""First bytes of a large file by which its layout and its wanted columns are found."""
_UTF8 = ("ascii", "utf-8")


def read_streamed(source: Source, options: ReadOptions, limits: Limits, *, loops: bool = False) -> Table:
    """The table in a large text file, with only the columns that the loop needs; with `loops` see `read_parquet`.

    DataError where its encoding or its separator can't be read in pieces and it is too large to be held whole.
    """
    assert source.path is not None
    with open(source.path, "rb") as stream:
        head = stream.read(HEAD_BYTES)
    head = head[: head.rfind(b"\n") + 1] or head
    text = to_utf8(head, source.name, options.encoding)
    layout = find_layout(
        text.data, source.name, separator=options.separator, header=options.header, decimal=options.decimal
    )
    if text.encoding not in _UTF8 or layout.separator == " " or b"<table" in head[:2000].lower() or b"\n" not in head:
        return _whole(source, options, limits)
    limits.check("columns", len(layout.names), source.name)
    first, _ = parse(text.data, layout, source.name)
    part = as_table(source.name, layout, tuple(first.columns), (), text)
    if loops and not by_rows(part):
        return part
    wanted: set[int] | None
    if loops:
        wanted, kinds = None, [kind_of(part, i) for i in range(len(part.names))]
    else:
        wanted, kinds = wanted_columns(part, options)
    columns = sorted(range(len(layout.names)) if wanted is None else wanted)
    return _pieces(source, limits, columns, kinds, part, layout, len(head) - len(text.data))


def _whole(source: Source, options: ReadOptions, limits: Limits) -> Table:
    """Table of a text that can't be read in pieces, read at once."""
    assert source.path is not None
    limits.check("unpacked", source.path.stat().st_size, source.name,
                 "convert it to UTF-8 text with commas, semicolons or tabs, which is read in pieces")
    parts = list(pieces(source, limits))
    data = b"".join(piece for piece, _ in parts)
    return replace(text_table(replace(source, data=data), options, limits), sha256=parts[-1][1])


def _pieces(
    source: Source, limits: Limits, columns: list[int], kinds: list[str], head: Table, layout: Layout, mark: int
) -> Table:
    """Table of all pieces, parsed alike and joined; `mark` is the length of a byte-order mark."""
    found: dict[int, list[Any]] = {i: [] for i in columns}
    types: dict[str, Any] | None = None
    dropped: list[tuple[int, str, str]] = []
    rows, lines, digest = 0, 0, ""
    for piece, so_far in pieces(source, limits):
        digest = so_far
        piece = piece if lines else piece[mark:]
        _check_text(piece, source.name, lines)
        header = 0 if lines else layout.header_lines
        here = replace(layout, offset=offset_of(piece, header), first_line=lines + 1 + header)
        table, bad = parse(piece, here, source.name, columns, types)
        dropped += bad
        rows += table.num_rows
        lines += piece.count(b"\n")
        limits.check("rows", rows, source.name, "cut it into pieces, or thin it")
        limits.check("unpacked", 8 * len(dropped) + 8 * rows * len(columns), source.name, "name fewer --extra columns")
        for i in columns:
            found[i].append(table.column(str(i)))
        types = {f.name: f.type for f in table.schema if str(f.type) != "null"}
    refuse_damage(rows, tuple(dropped), layout, source.name)
    joined = {i: _joined(parts, layout.decimal) for i, parts in found.items()}
    return without_others(replace(head, dropped=tuple(dropped), sha256=digest), joined, kinds, rows)


def _check_text(piece: bytes, name: str, lines: int) -> None:
    if piece.isascii():
        return
    try:
        codecs.utf_8_decode(piece, "strict", True)
    except UnicodeDecodeError as error:
        line = lines + piece.count(b"\n", 0, error.start) + 1
        raise DataError(f"{name}, line {line:,}: byte {piece[error.start : error.start + 1].hex()} is not UTF-8, "
                        "though the file begins so", "convert it to UTF-8, or name its --encoding") from None


def _joined(parts: list[Any], decimal: str) -> Any:
    """One column of all pieces; where their types differ it becomes floats, time stamps or text."""
    import pyarrow.compute as pc

    kinds = {part.type for part in parts if not pa.types.is_null(part.type)}
    if len(kinds) <= 1:
        kind = next(iter(kinds), pa.null())
    elif all(pa.types.is_integer(k) or pa.types.is_floating(k) for k in kinds):
        kind = pa.float64()
    elif all(pa.types.is_timestamp(k) and k.tz is None for k in kinds):
        kind = pa.timestamp("ns")
    else:
        kind = pa.string()
    flat = []
    for part in parts:
        if part.type != kind:
            number = pa.types.is_floating(part.type)
            part = part.cast(kind)
            if number and kind == pa.string() and decimal == ",":
                part = pc.replace_substring(part, ".", ",")
        flat += part.chunks
    return pa.chunked_array(flat, type=kind)
