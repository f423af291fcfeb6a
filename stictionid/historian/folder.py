"""Folder read as one export: one file per tag, or a partitioned Parquet dataset."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from ..errors import DataError, UsageError
from .bytes.arrow import texts, whole
from .bytes.limits import limits_from
from .bytes.options import ALL_TAGS, ReadOptions
from .bytes.source import TEXT, Source, in_short, open_source
from .dataset import SIGNALS, groups_of, open_dataset, parquet_in, rows_of, selection
from .table.formats import read_table
from .table.table import Table, table_from_arrow
from .words.assign import key_of
from .words.roles import take_apart

MAX_FILES = 20_000
"""Files of one folder that are read as one export."""


def read_folder(folder: Path, options: ReadOptions) -> tuple[Source, Table]:
    """The one table of a folder's files. UsageError for an empty folder, DataError for files of several tags."""
    folder = folder if folder.name else folder.resolve()  # "." has no name for messages and for the loop
    parquet = parquet_in(folder)
    if parquet:
        return _dataset(folder, parquet, options)
    files = sorted(p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in TEXT)
    if not files or len(files) > MAX_FILES:
        raise UsageError(
            f"the folder {folder} has {len(files)} exports", "give a file, or a folder with one file per tag"
        )
    return table_per_tag(folder, _of_loop(files, options), options)


def tag_of(path: Path) -> str:
    """Tag in the name of a file with one tag: the name without the extensions of its format."""
    return re.sub(r"(\.(csv|tsv|txt|gz|zip))+\Z", "", path.name, flags=re.IGNORECASE)


def _of_loop(files: list[Path], options: ReadOptions) -> list[Path]:
    """Files of the loop that the options name, where files are named after tags; else all files."""
    if ALL_TAGS in options.extra:
        return files
    named = {t for t in (options.sp, options.pv, options.op, options.position, options.mode, *options.extra) if t}
    by_tag = {tag_of(path): path for path in files}
    if options.loop is not None:
        groups = groups_of(by_tag)
        named.update(*(tags for loop, tags in groups.items() if key_of(loop) == key_of(options.loop)))
    mine = [path for tag, path in by_tag.items() if tag in named]
    return mine if len(mine) >= 2 else files


def _dataset(folder: Path, files: list[Path], options: ReadOptions) -> tuple[Source, Table]:
    """The rows of one loop where the options name a loop or its tags, else all rows."""
    opened = open_dataset(folder)
    select = selection(opened, options) if opened.many else ()
    if select:
        return rows_of(opened, select)
    try:
        limits = limits_from(options.limit)
        limits.check("columns", len(opened.data.schema.names), folder.name)
        limits.check("rows", opened.data.count_rows(), folder.name, "name the loop with --loop")
        table = opened.data.to_table()
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(
            f"{folder} is no readable Parquet dataset: {in_short(error)}", "read one of its files"
        ) from None
    source = Source(folder.name, "parquet", b"", _digest(files), folder)
    return source, table_from_arrow(table, folder.name)


def _digest(files: list[Path]) -> str:
    """SHA-256 of several files: of their names and SHA-256 in order."""
    lines = "".join(f"{path.name} {open_source(path).sha256}\n" for path in files)
    return hashlib.sha256(lines.encode()).hexdigest()


def table_per_tag(folder: Path, files: list[Path], options: ReadOptions) -> tuple[Source, Table]:
    """Files with one tag each as one long table of tag, time and value."""
    tags, times, values = [], [], []
    assumptions: list[str] = []
    limits, total = limits_from(options.limit), 0
    for path in files:
        table = read_table(open_source(path, limits), replace(options, time=None))
        if len(table.names) < 2:
            raise DataError(f"{path} has one column", "each file of the folder needs time and value")
        tag = next((n for n in table.names[1:] if take_apart(n).role in SIGNALS), path.stem)
        if take_apart(tag).loop == "" and take_apart(path.stem).role is not None:
            tag = path.stem
        total += table.rows
        limits.check("rows", total, folder.name, "give fewer files")
        tags.append(texts([tag] * table.rows))
        times.append(table.columns[0].cast(pa.string()))
        values.append(_pointed(table.columns[1], table.decimal))
        assumptions += [a for a in table.assumptions if a not in assumptions]
    columns = (tags, map(whole, times), map(whole, values))
    source = Source(folder.name, "text", b"", _digest(files), folder)
    return source, Table(
        file=folder.name,
        names=("tag", "time", "value"),
        columns=tuple(pa.chunked_array(list(parts)) for parts in columns),
        units=("", "", ""),
        assumptions=tuple(assumptions),
    )


def _pointed(column: Any, decimal: str) -> Any:
    """Values as text with decimal points: files of one folder may differ, but their joint table has one mark."""
    import pyarrow.compute as pc

    text = column.cast(pa.string())
    if decimal == "," and pa.types.is_string(column.type):
        text = pc.replace_substring_regex(text, r"^([+\-−]?[\d.]*),(\d.*)$", r"\1.\2")
    return text
