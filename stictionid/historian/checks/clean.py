"""Writer of the cleaned loop: time, signals under their plain names, and a column that marks samples that count."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pyarrow as pa

from ...system.csv_safety import cell
from ...system.files import write_whole
from ...typing import FloatArray
from ..bytes.arrow import numbers, timestamps

_NOTHING = b"\xff\xfe no file of ours begins like this"
_NAMES = {"setpoint": "SP", "process_value": "PV", "output": "OP", "position": "ZT"}


def write_clean(result: Any, path: str, *, force: bool = False) -> None:
    """Write a reading's loop as Parquet or CSV by extension, so that reading it again gives the same loop.

    `time` is a time stamp, or `time_s` seconds where the export has no calendar; `used` is 1 for samples that count.
    UsageError where the place can't be written.
    """
    loop = result.loop
    elapsed = loop.origin.start is not None and loop.origin.start.endswith(" s")
    ns = np.concatenate(
        [
            _start_ns(s["start"], elapsed) + np.rint(np.arange(s["samples"]) * loop.step_s * 1e9).astype(np.int64)
            for s in result.segments
        ]
    )
    columns: dict[str, Any] = {"time_s": numbers(ns / 1e9)} if elapsed else {"time": timestamps(ns)}
    signals = {name: getattr(loop, role) for role, name in _NAMES.items()}
    columns |= {name: _nullable(values) for name, values in signals.items() if values is not None}
    columns |= {tag: _nullable(values) for tag, values in loop.extras.items()}
    columns["used"] = numbers(loop.used.astype(np.int64)).cast(pa.int8())
    fields = [
        pa.field(n, c.type, metadata={"unit": loop.units.get(next((r for r, m in _NAMES.items() if m == n), ""), "")})
        for n, c in columns.items()
    ]
    table = pa.table(
        columns,
        schema=pa.schema(fields, metadata={"loop": loop.name, "source": result.file, "source_sha256": result.sha256}),
    )
    sink = io.BytesIO()
    if path.lower().endswith(".parquet"):
        import pyarrow.parquet as pq

        pq.write_table(table, sink)
    else:
        from pyarrow import csv

        # The header is written here: tags are foreign text, and pyarrow neither quotes them nor makes formulas safe.
        sink.write((",".join(map(cell, columns)) + "\n").encode())
        csv.write_csv(table, sink, csv.WriteOptions(include_header=False, quoting_style="none"))
    write_whole(path, sink.getvalue(), force=force, kind=own_kind(path))


def own_kind(path: str) -> bytes:
    """First bytes of a file that this module wrote; such a file may be replaced without --force."""
    if path.lower().endswith(".parquet"):
        return b"PAR1"
    try:
        with open(path, "rb") as file:
            header = file.readline(10_000)
    except OSError:
        header = b""
    return header if header.startswith(b"time") and header.rstrip().endswith(b",used") else _NOTHING


def _nullable(values: FloatArray) -> Any:
    """Values with empty cells in place of NaN."""
    import pyarrow.compute as pc

    column = numbers(np.array(values))
    return pc.if_else(pc.is_nan(column), None, column)


def _start_ns(text: str, elapsed: bool) -> int:
    if elapsed:
        return round(float(text.removesuffix(" s")) * 1e9)
    return int(np.datetime64(text.removesuffix("Z"), "ns").astype(np.int64))
