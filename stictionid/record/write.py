"""Writer of a loop as CSV, TSV or Parquet: columns time_s, SP, PV, OP, ZT and further tags; equal bytes each time."""

from __future__ import annotations

import io
import math
from pathlib import Path

from ..errors import UsageError
from ..system.csv_safety import cell
from ..system.files import write_whole
from ..typing import FloatArray
from .loop import Loop

_KINDS = {".csv": b"time_s", ".tsv": b"time_s", ".txt": b"time_s", ".parquet": b"PAR1", ".pq": b"PAR1"}


def check_kind(path: str | Path) -> bytes:
    """First bytes of a data file of this name; UsageError where none can be written, naming those that can."""
    suffix = Path(path).suffix.lower()
    if suffix not in _KINDS:
        raise UsageError(f"{path}: can't write '{suffix or 'no extension'}'",
                         "end -o in .csv, .tsv, .txt or .parquet")
    return _KINDS[suffix]


def write_loop(loop: Loop, path: str | Path, *, force: bool = False) -> None:
    """Write every signal of `loop`; an existing file is replaced only by the same kind of file or with `force`."""
    kind, columns = check_kind(path), _columns(loop)
    if kind == b"PAR1":
        import pyarrow as pa
        import pyarrow.parquet as pq

        sink = io.BytesIO()
        pq.write_table(pa.table(columns), sink, compression="zstd")
        content = sink.getvalue()
    else:
        separator = "," if Path(path).suffix.lower() == ".csv" else "\t"
        lines = [separator.join(cell(name, separator) for name in columns)]
        rows = zip(*(c.tolist() for c in columns.values()), strict=True)
        lines += [separator.join(map(_number, row)) for row in rows]
        content = ("\n".join(lines) + "\n").encode()
    write_whole(path, content, force=force, kind=kind)


def _columns(loop: Loop) -> dict[str, FloatArray]:
    columns = {"time_s": loop.time_s}
    if loop.setpoint is not None:
        columns["SP"] = loop.setpoint
    columns |= {"PV": loop.process_value, "OP": loop.output}
    if loop.position is not None:
        columns["ZT"] = loop.position
    return columns | loop.extras


def _number(value: float) -> str:
    """A number as a cell, without a point where it is whole; empty where it is no finite one."""
    if not math.isfinite(value):
        return ""
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)
