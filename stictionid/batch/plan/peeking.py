"""Loops of one file, from its first lines or its schema where that is enough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa

from ...errors import DataError, StictionidError, UsageError
from ...historian.bytes.options import ReadOptions
from ...historian.bytes.source import PARQUET, NoRecord, Source, open_source
from ...historian.dataset import SIGNALS, Opened, groups_of, open_dataset, tag_of, words_in
from ...historian.table.columns import names_of
from ...historian.table.formats import IN_PARTS, loops_of, read_table
from ...historian.table.layout import NoTable
from ...historian.table.table import Table
from ...historian.words.roles import take_all, take_apart
from .sources import NOTES, PARTS

_HEAD_BYTES = 64 << 10
# Columns of a file with one tag: date, clock, value, quality.
_MOST_OF_A_TAG = 4


@dataclass(frozen=True, slots=True)
class Peeked:
    """Loops of one file: `loops` by name with their selection; one entry without a name for a loop named by its file.

    `names` are its tags or columns, for a loop list; `tag` is the tag of a file with a single one. `foreign` says why
    the file holds no loop, `damaged` what is wrong with it; `hint` says what to do about either.
    """

    path: Path
    loops: dict[str, tuple[str, ...]]
    kind: str = "file"
    names: tuple[str, ...] = ()
    tag: str = ""
    foreign: str = ""
    damaged: str = ""
    hint: str = ""


def peek(path: Path, options: ReadOptions) -> Peeked:
    """The loops of one file. Its content never raises an error: it is then foreign or damaged."""
    try:
        if path.suffix.lower() in PARQUET:
            return from_dataset(open_dataset(path), options)
        return _in_parts(path, options) or _text(path, options)
    except StictionidError as error:
        if isinstance(error, NoRecord) or (isinstance(error, NoTable) and path.suffix.lower() in NOTES):
            return Peeked(path, {}, foreign=error.message, hint=error.hint)
        return Peeked(path, {}, damaged=error.message, hint=error.hint)


def from_dataset(opened: Opened, options: ReadOptions) -> Peeked:
    """The loops of an opened Parquet file or folder. DataError where it is damaged."""
    if opened.tag is not None:
        if options.pv and options.op:
            tags = tuple(t for t in (options.sp, options.pv, options.op, options.position, options.mode) if t)
            return Peeked(opened.path, {options.loop or take_apart(options.pv).loop or opened.path.stem: tags},
                          "dataset")
        tags = words_in(opened, opened.tag)
        groups = groups_of(tags)
        return Peeked(opened.path, groups, "dataset", tags, foreign="" if groups else "no tags of a PV and an OP")
    if opened.loop is not None:
        return Peeked(opened.path, {w: (w,) for w in words_in(opened, opened.loop)}, "dataset")
    return _columns(opened.path, opened.names, options)


def _columns(path: Path, names: tuple[str, ...], options: ReadOptions) -> Peeked:
    """Loops by the names of columns: several by their tags, or the one of the file."""
    groups = {} if options.pv and options.op else groups_of(names)
    if len(groups) > 1:
        return Peeked(path, groups, "wide", names)
    roles = {tag.role for tag in take_all(n for n in names if n)}
    missing = [r for r, said in (("process_value", options.pv), ("output", options.op))
               if said is None and r not in roles]
    if missing:
        words = " and ".join(r.replace("_", " ") for r in missing)
        return Peeked(path, {}, names=names, foreign=f"no column for the {words}", tag=_one_tag(path, names))
    return Peeked(path, {next(iter(groups), ""): ()}, names=names)


def _one_tag(path: Path, names: tuple[str, ...]) -> str:
    """The tag of a file that holds a single tag and is named by it; "" for any other file."""
    tag = tag_of(path)
    known = take_apart(tag)
    return tag if 2 <= len(names) <= _MOST_OF_A_TAG and known.role in SIGNALS and known.loop else ""


def _in_parts(path: Path, options: ReadOptions) -> Peeked | None:
    """The loops of a workbook or a MATLAB file; None for any other file."""
    if path.suffix.lower() not in PARTS:
        return None
    source = open_source(path)
    if source.kind not in IN_PARTS:
        return None
    names = loops_of(source, replace(options, loop=None))
    if names:
        return Peeked(path, {name: () for name in names}, "part", names)
    return replace(_columns(path, read_table(source, options).names, options), kind="part")


def _text(path: Path, options: ReadOptions) -> Peeked:
    table = _head(path, options)
    if options.sp is None and options.pv is None and options.op is None and _by_rows(table):
        table = read_table(open_source(path), options)
        loops: dict[str, tuple[str, ...]] = {name: () for name in names_of(table)}
        return Peeked(path, loops or {"": ()}, names=_tags(table))
    return _columns(path, table.names, options)


def _by_rows(table: Table) -> bool:
    """True where the rows of a table distinguish its loops, so that all rows must be read."""
    roles = [tag.role for tag in take_all(table.names)]
    if {"process_value", "output"} <= set(roles):
        return any(take_apart(n).role == "loop" and not take_apart(n).loop for n in table.names)
    return ("value" in roles and "tag" in roles) or bool(names_of(table))


def _tags(table: Table) -> tuple[str, ...]:
    column = next((i for i, n in enumerate(table.names) if take_apart(n).role == "tag"), -1)
    if column < 0:
        return table.names
    return tuple(str(w) for w in table.columns[column].cast(pa.string()).unique().to_pylist() if w is not None)


def _head(path: Path, options: ReadOptions) -> Table:
    """The table of a text file's first lines; of the whole file where it is compressed."""
    try:
        with open(path, "rb") as file:
            start = file.read(_HEAD_BYTES)
    except OSError as error:
        raise UsageError(f"{path} can't be read: {error.strerror or error}", "check its permissions") from None
    if len(start) < _HEAD_BYTES or start.startswith((b"\x1f\x8b", b"PK\x03\x04")) or b"\0" in start:
        return read_table(open_source(path), options)
    cut = start.rfind(b"\n") + 1
    if cut == 0:
        raise DataError(f"{path} has no line ends in its first {_HEAD_BYTES:,} bytes", "it is no table")
    return read_table(Source(path.name, "text", start[:cut], "", path), options)
