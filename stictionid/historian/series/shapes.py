"""Recognition of the shape of a table (wide, long, paired), and the series of one loop in it."""

from __future__ import annotations

from ...errors import DataError
from ..bytes.options import ReadOptions
from ..table.columns import is_paired, kind_of, long_columns, time_columns
from ..table.rows import RowBook
from ..table.table import Table
from .long_shape import shape_long, shape_paired
from .shaped import Shaped
from .wide_shape import shape_wide


def shape_table(table: Table, options: ReadOptions, book: RowBook) -> Shaped:
    """The series of the chosen loop. DataError and UsageError as in `assign`."""
    kinds = [kind_of(table, i) for i in range(len(table.names))]
    tag_column, value_column = long_columns(table, kinds)
    shape = options.shape
    stamps = [i for i, k in enumerate(kinds) if k in ("time", "date")]
    if shape == "long" or (shape is None and tag_column >= 0 and value_column >= 0):
        if tag_column < 0 or value_column < 0:
            raise DataError(
                f"{table.file} has no column of tags and one of values", "leave --shape out, or export it again"
            )
        return shape_long(table, options, book, tag_column, value_column, time_columns(table, kinds, options))
    if shape == "paired" or (shape is None and is_paired(kinds, stamps)):
        if not stamps:
            raise DataError(f"{table.file} has no time columns to pair values with", "leave --shape out")
        return shape_paired(table, options, book, stamps, kinds)
    return shape_wide(table, kinds, options, book)
