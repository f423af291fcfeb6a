"""Folders and Parquet datasets with many loops: names of the loops, and one loop without reading the others.

A long dataset (tag, time, value; hive folders allowed), or one with a loop column, is read by its rows. The filter is
pushed down to the files and their row groups. A wide one is read by its columns. Slow where rows are not sorted or
partitioned by tag: then every loop costs one pass over the tag column. Source: pyarrow.dataset.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ..errors import DataError, UsageError
from .bytes.arrow import coded, floats, integers, texts, whole
from .bytes.options import ALL_TAGS, ReadOptions
from .bytes.source import PARQUET, TEXT, Source, in_short, limits_from, open_source
from .table.formats import read_table
from .table.table import Table, table_from_arrow
from .words.assign import key_of
from .words.roles import Tag, take_all, take_apart

RESULTS_MARK = "batch.json"
"""A folder that holds this file was written by `batch` and contains no data."""
MAX_FILES = 20_000
"""Files of one folder that are read as one export."""
SIGNALS = ("setpoint", "process_value", "output", "position", "mode")
# One row group at a time and no read-ahead: a loop has few rows, and many workers share the memory.
_SCAN = {"use_threads": False, "batch_readahead": 1, "fragment_readahead": 1}


@dataclass(frozen=True, slots=True)
class Opened:
    """A dataset and its columns: `tag` names the column of tags, `loop` that of loops; both None where it is wide."""

    path: Path
    data: Any
    names: tuple[str, ...]
    tag: str | None
    loop: str | None

    @property
    def many(self) -> bool:
        """True where loops are told apart by rows, not by columns."""
        return self.tag is not None or self.loop is not None


def parquet_in(folder: Path) -> list[Path]:
    """Parquet files of a folder and its subfolders in order, without hidden ones and results of `batch`."""
    if (folder / RESULTS_MARK).is_file():
        return []
    found: list[Path] = []
    for entry in sorted(folder.iterdir(), key=lambda p: p.name):
        if entry.name.startswith((".", "_")):
            continue
        if entry.is_dir():
            found += parquet_in(entry)
        elif entry.suffix.lower() in PARQUET:
            found.append(entry)
    return found


def open_dataset(path: Path) -> Opened:
    """The dataset in a folder or file, without its rows. DataError where it can't be read or is empty."""
    import pyarrow.dataset as ds

    chosen = [str(p) for p in parquet_in(path)] if path.is_dir() else [str(path)]
    if not chosen:
        raise DataError(f"{path} has no Parquet files", "give the folder that holds them")
    try:
        data = ds.dataset(chosen, format="parquet",
                          partitioning=ds.HivePartitioning.discover(), partition_base_dir=str(path))
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(f"{path} is no readable Parquet dataset: {_first(error)}", "write or copy it again") from None
    names = tuple(f.name for f in data.schema if not pa.types.is_nested(f.type))
    roles = dict(zip(names, take_all(names), strict=True))
    texts = {n for n in names if _is_text(data.schema.field(n).type)}
    wide = {"process_value", "output"} <= {t.role for t in roles.values()}
    value = any(t.role == "value" for t in roles.values())
    tag = next((n for n, t in roles.items() if t.role == "tag" and n in texts), None) if value and not wide else None
    loop = next((n for n, t in roles.items() if t.role == "loop" and not t.loop and n in texts), None)
    return Opened(path, data, names, tag, loop)


def _is_text(kind: Any) -> bool:
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def words_in(opened: Opened, column: str) -> tuple[str, ...]:
    """The different texts of a column, sorted; from the names of hive folders alone where it is one of their keys."""
    import pyarrow.compute as pc
    import pyarrow.dataset as ds

    found: set[str] = set()
    rest = []
    for fragment in opened.data.get_fragments():
        keys = ds.get_partition_keys(fragment.partition_expression)
        if column in keys:
            found.add(str(keys[column]))
        else:
            rest.append(fragment)
    try:
        for fragment in rest:
            for batch in fragment.to_batches(schema=opened.data.schema, columns=[column], **_SCAN):
                found |= {str(w) for w in pc.unique(batch.column(0).cast(pa.string())).to_pylist() if w is not None}
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(f"{opened.path} is damaged Parquet: {_first(error)}", "write or copy it again") from None
    return tuple(sorted(found))


def groups_of(names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Loops with at least PV and OP among tags or columns: name to its tags (and those that share its number)."""
    groups: dict[str, list[Tag]] = {}
    numbered: dict[str, list[str]] = {}
    for tag in take_all(names):
        if tag.role in SIGNALS and tag.loop:
            groups.setdefault(key_of(tag.loop), []).append(tag)
            numbered.setdefault(_digits(tag.loop), []).append(tag.name)
    found: dict[str, tuple[str, ...]] = {}
    for key, mine in groups.items():
        roles = {tag.role for tag in mine}
        if roles >= {"process_value", "output"}:
            near = numbered[_digits(key)] if _digits(key) and not roles >= {"setpoint", "position", "mode"} else []
            found[mine[0].loop] = tuple(dict.fromkeys((*(tag.name for tag in mine), *near)))
    return found


def _digits(text: str) -> str:
    return "".join(c for c in text if c.isdigit())


def rows_of(opened: Opened, select: Iterable[str]) -> tuple[Source, Table]:
    """The rows (or, in a wide dataset, the columns) of one loop; `select` are its tags, its name, or its columns.

    The SHA-256 is of the rows read, so a loop is recognised when other loops' rows change. DataError where there
    is no row, or the file is damaged.
    """
    import pyarrow.dataset as ds

    wanted = list(dict.fromkeys(select))
    column = opened.tag or opened.loop
    try:
        if column is not None:
            keep = ds.field(column).cast(pa.string()).isin(wanted) if pa.types.is_dictionary(
                opened.data.schema.field(column).type) else ds.field(column).isin(wanted)
            table = opened.data.to_table(columns=list(opened.names), filter=keep, **_SCAN)
        else:
            table = opened.data.to_table(columns=[n for n in opened.names if _belongs(n, wanted)], **_SCAN)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(f"{opened.path} is damaged Parquet: {_first(error)}", "write or copy it again") from None
    if table.num_rows == 0:
        raise DataError(f"{opened.path} has no rows of {', '.join(wanted[:4])}", "check the tags, or export it again")
    source = Source(opened.path.name, "parquet", b"", digest(table), opened.path)
    return source, table_from_arrow(table, opened.path.name)


def _belongs(name: str, wanted: Sequence[str]) -> bool:
    """True for a column of the loop, its quality, or a column of no loop at all (time)."""
    return name in wanted or any(name.startswith(w) for w in wanted) or not (
        take_apart(name).role in SIGNALS or take_apart(name).loop)


def digest(table: Any) -> str:
    """SHA-256 of a table's names and values, independent of the chunks that hold its rows."""
    found = hashlib.sha256()
    for name in table.column_names:
        column = table.column(name)
        found.update(f"{name}\0{column.type}\0".encode())
        if pa.types.is_floating(column.type):
            found.update(np.ascontiguousarray(floats(column)).data)
        elif pa.types.is_integer(column.type) or pa.types.is_timestamp(column.type):
            values, there = integers(column.cast(pa.int64(), safe=False))
            found.update(np.ascontiguousarray(values).data)
            found.update(np.ascontiguousarray(there).data)
        else:
            words, codes = coded(column.cast(pa.string()), missing=-1)
            found.update("\0".join(map(str, words)).encode("utf-8", "replace"))
            found.update(np.ascontiguousarray(codes).data)
    return found.hexdigest()


def narrowed(table: Table, select: Sequence[str]) -> Table:
    """A wide table reduced to the columns of one loop and those of no loop."""
    keep = [i for i, name in enumerate(table.names) if _belongs(name, select)]
    if len(keep) == len(table.names):
        return table
    return replace(
        table, names=tuple(table.names[i] for i in keep), columns=tuple(table.columns[i] for i in keep),
        units=tuple(table.units[i] for i in keep),
        descriptions=tuple(table.descriptions[i] for i in keep) if table.descriptions else (),
        header_cells=tuple(tuple(row[i] for i in keep if i < len(row)) for row in table.header_cells))


def selection(opened: Opened, options: ReadOptions) -> tuple[str, ...]:
    """Tags or columns of a dataset that the options name, or those of the loop they name; empty for all."""
    if opened.tag is None and opened.loop is not None:
        return (options.loop,) if options.loop else ()
    if ALL_TAGS in options.extra:
        return ()
    named = tuple(w for w in (options.sp, options.pv, options.op, options.position, options.mode, *options.extra) if w)
    if options.loop is None:
        return named if options.pv and options.op else ()
    groups = groups_of(words_in(opened, opened.tag) if opened.tag else opened.names)
    return next((tuple(dict.fromkeys((*tags, *named))) for loop, tags in groups.items()
                 if key_of(loop) == key_of(options.loop)), named if options.pv and options.op else ())


def _first(error: BaseException) -> str:
    return str(error).splitlines()[0][:160] if str(error) else type(error).__name__


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
    source = Source(folder.name, "parquet", b"", _digest_of(files), folder)
    return source, table_from_arrow(table, folder.name)


def _digest_of(files: list[Path]) -> str:
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
    source = Source(folder.name, "text", b"", _digest_of(files), folder)
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
