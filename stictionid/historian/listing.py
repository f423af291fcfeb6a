"""Names of the loops in a file, found without reading any of them."""

from __future__ import annotations

from .series.assign import key_of
from .series.columns import kind_of, long_columns, loop_column, loop_names
from .table.table import Table
from .words.roles import take_all


def names_of(table: Table) -> tuple[str, ...]:
    """Names of the loops in a table, in the order of their columns or rows; one loop without a name gives ()."""
    import pyarrow as pa

    kinds = [kind_of(table, i) for i in range(len(table.names))]
    column = loop_column(table, kinds)
    if column >= 0:
        return tuple(loop_names(table, column))
    tag, value = long_columns(table, kinds)
    names = list(table.names)
    if tag >= 0 and value >= 0:
        names = [str(w) for w in table.columns[tag].cast(pa.string()).unique().to_pylist() if w is not None]
    groups: dict[str, tuple[str, set[str]]] = {}
    for found in take_all(names):
        if found.role in ("process_value", "output") and found.loop:
            groups.setdefault(key_of(found.loop), (found.loop, set()))[1].add(found.role)
    return tuple(name for name, roles in groups.values() if len(roles) == 2)
