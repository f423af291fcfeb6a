"""Parquet reader: the footer is checked against the limits first, then only the wanted columns are read.

No file is memory-mapped: one that its writer cuts short would kill the process. Read in the ordinary way it is refused.
"""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from ...errors import DataError
from ..bytes.options import ReadOptions
from ..bytes.source import Limits, Source, in_short
from .columns import by_rows, wanted_columns, without_others
from .table import Table, table_from_arrow

FEW_ROWS = 50_000
"""Rows up to which one thread reads faster than several."""
HEAD_ROWS = 5000
"""First rows by which the wanted columns are found."""
MANY_COLUMNS = 12
"""Columns from which on it pays to look first and read fewer."""


def read_parquet(source: Source, options: ReadOptions, limits: Limits, *, loops: bool = False) -> Table:
    """The table in a Parquet file with the columns that the loop needs. DataError where damaged or above a limit.

    With `loops` the first rows are enough where columns name the loops.
    """
    import pyarrow.parquet as pq

    try:
        place = pa.BufferReader(source.data) if source.data or source.path is None else str(source.path)
        probe = pq.ParquetFile(place)
        schema, footer = probe.schema_arrow, probe.metadata
        limits.check("columns", len(schema.names), source.name)
        limits.check("rows", footer.num_rows, source.name, "split it")
        words = [f.name for f in schema if pa.types.is_string(f.type) or pa.types.is_large_string(f.type)
                 or pa.types.is_binary(f.type)]
        # Text that is repeated a million times is held once.
        file = pq.ParquetFile(place, read_dictionary=words) if words else probe
        plain = [f.name for f in schema if not pa.types.is_nested(f.type)]
        wanted = None
        if len(plain) > MANY_COLUMNS and len(set(schema.names)) == len(schema.names) and footer.num_rows:
            head = pa.Table.from_batches([next(file.iter_batches(HEAD_ROWS, columns=plain))])
            part = table_from_arrow(head, source.name)
            if loops and not by_rows(part):
                return part
            wanted, kinds = (None, []) if loops else wanted_columns(part, options)
        names = plain if wanted is None else [plain[i] for i in sorted(wanted)]
        limits.check("unpacked", _unpacked(footer, schema, names), source.name, "give a file with fewer columns")
        several = len(set(schema.names)) < len(schema.names)
        table = file.read(columns=None if several else names, use_threads=footer.num_rows > FEW_ROWS)
        _check_words(table, source.name, limits)
    except StopIteration:
        raise DataError(f"{source.name} has no rows", "export it again") from None
    except (pa.ArrowException, OSError, ValueError, KeyError, IndexError) as error:
        raise DataError(f"{source.name} is damaged Parquet: {in_short(error)}", "write or copy it again") from None
    if wanted is None:
        return table_from_arrow(table, source.name)
    full = table_from_arrow(table, source.name)
    return without_others(part, dict(zip(sorted(wanted), full.columns, strict=True)), kinds, full.rows)


def _unpacked(footer: Any, schema: Any, names: list[str]) -> int:
    """Bytes that the columns take in memory, as far as the footer states.

    The footer's entries of single columns are not read: damaged ones end the process inside pyarrow (26.0).
    """
    kinds = [f.type for f in schema if f.name in set(names)]
    fixed = sum(k.bit_width // 8 for k in kinds if _has_width(k)) * int(footer.num_rows)
    if all(_has_width(k) or pa.types.is_null(k) for k in kinds):
        return fixed
    return max(fixed, sum(max(0, footer.row_group(g).total_byte_size) for g in range(footer.num_row_groups)))


def _has_width(kind: Any) -> bool:
    try:
        return bool(kind.bit_width)
    except ValueError:
        return False


def _check_words(table: Any, name: str, limits: Limits) -> None:
    """Refuse text that would fill the memory once every cell holds its own."""
    for field, column in zip(table.schema, table.columns, strict=True):
        if not pa.types.is_dictionary(field.type):
            continue
        import pyarrow.compute as pc  # takes as long as reading a table that has no such column

        total = 0
        for chunk in column.chunks:
            lengths = pc.binary_length(chunk.dictionary.cast(pa.binary()))
            total += pc.sum(pc.take(lengths, chunk.indices)).as_py() or 0
        limits.check("unpacked", total, f"{name}, column {field.name[:60]!r}")
