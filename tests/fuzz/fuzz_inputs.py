"""Inputs for fuzzing: small exports in many shapes, tables of random columns, and ways to damage bytes.

Everything is drawn from one `random.Random`, so that a seed gives the same inputs on every machine.
"""

from __future__ import annotations

import functools
import gzip
import io
import random
import sys
import zipfile
from datetime import datetime, timedelta
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from historian_files import comma, epoch, excel_serial, filetime, html, long, paired, record, wide

TOKENS = (
    "Bad Input", "#N/A", "", " ", "NaN", "inf", "-inf", "1e400", "-9999", "253", "1E+30", "1,5", "1.234,5", "1 234,5",
    "1'234.5", "−3", "+", "-", ".", ",", ";", "|", "\t", '"', '""', "'", "\n", "\r\n", "\r", "\0", "=1+1", "@SUM(A1)",
    "5e-324", "1e-300", "1e300", "99999999999999999999", "0x10", "1_000", "²", "٣", "½", "%", "45.2 %", "12 m3/h",
    "2024-02-30", "2024-05-31 25:61:61", "31/05/2024", "05/31/2024 2:00 PM", "03.04.24", "1900-01-01", "9999-12-31",
    "0001-01-01", "2024-10-27T02:30:00", "2024-05-31T14:00:00.1234567891Z", "2024-05-31T14:00:00+99:99", "45123.5",
    "1717164000", "1717164000000000000", "133616448000000000", "-1", "0", "00", "24:00:00", "12:00", "MAN", "AUTO",
    "Good", "192", "true", "PV", "OP", "SP", "time", "FIC101.PV", "\u202e", "\u00a0", "\ufeff", "é", "漢字", "\ud7ff",
    "🎛", "(3 rows affected)", "<table><tr><td>", "</table>", "PAR1", "[%]", "nan%", "1e", "e5", "--", "1.2.3", "1:2:3",
)
"""Texts that have meant trouble to readers of exports."""

NAMES = (
    "time", "timestamp", "date", "clock", "t_s", "SP", "PV", "OP", "MV", "SV", "FIC101.PV", "FIC101.OP", "FIC101.SP",
    "A.PV", "A.OP", "B.PV", "B.OP", "Tag", "Value", "Quality", "Status", "Confidence", "mode", "FIC101.MODE", "ZT",
    "used", "loop", "unit", "n", "", "PV", "TI7", "PV [mA]", "OP (%)", "r", "u", "y", "FT_1", "FV_1", '"', "=cmd",
    "время", "输出", "PV time", "OP time", "avg PV",
)
"""Column names with a role, without one, and with two."""

_START = datetime(2024, 5, 31, 14)


def missing(rng: random.Random, rows: int) -> list[bool]:
    """Which cells of a column are missing: every k-th, all but every k-th, blocks, an end, or at random."""
    kind, k = rng.randrange(6), rng.choice((2, 3, 5, 10, 20))
    phase, share = rng.randrange(k), rng.choice((0.1, 0.5, 0.9))
    block = rng.choice((3, 30)), rng.choice((40, 200))
    return [(i % k == phase, i % k != phase, i % block[1] < block[0], i < share * rows, i >= rows - share * rows,
             rng.random() < share)[kind] for i in range(rows)]


def masked(rng: random.Random) -> bytes:
    """An export of a loop whose PV, and now and then another column, is missing in a pattern of rows."""
    r = record(rows=rng.choice((30, 120, 120, 400)), seed=rng.randrange(5))
    word = rng.choice(("", "Bad", "NaN", "#N/A", "Bad Input", "-9999"))
    for name in ("pv", *(n for n in ("op", "sp") if rng.random() < 0.15)):
        cells = getattr(r, name)
        for i, gone in enumerate(missing(rng, len(cells))):
            cells[i] = word if gone else cells[i]
    return rng.choice((wide, wide, wide, long, paired))(r).encode()


@functools.cache
def seeds() -> tuple[bytes, ...]:
    """Small exports that read well: what mutation starts from."""
    r = record(rows=14)
    lines = wide(r).splitlines()
    texts = [
        wide(r), wide(r, sep="\t"), wide(r, sep="|"), wide(r, sep=";", cell=comma), wide(r, sep="\t", end="\r\n"),
        wide(r, stamp=lambda m: m.strftime("%d/%m/%Y %H:%M:%S")), wide(r, stamp=epoch), wide(r, stamp=filetime),
        wide(r, stamp=excel_serial), wide(r, stamp=lambda m: m.strftime("%d-%b-%y %I:%M:%S %p")),
        wide(r, names="date,clock,SP,PV,OP", stamp=lambda m: m.strftime("%Y-%m-%d,%H:%M:%S")),
        wide(r, names="time_s,SP,PV,OP", stamp=lambda m: str((m - r.stamps[0]).seconds)),
        wide(record(rows=40, step=10), stamp=lambda m: m.strftime("%Y-%m-%d %H:%M")),
        wide(r, sep="  ", names="date,clock,SP,PV,OP"),
        wide(r, names=None, above=("timestamp,FIC101.SP,FIC101.PV,FIC101.OP", ",%,m3/h,%", ",set,flow,valve")),
        wide(r, above=("Plant historian export", "Server: HIST01", ""), below=("", "(14 rows affected)")),
        long(r), long(r, header="TagName;DateTime;Value", sep=";"), paired(r), html(r),
        "time,SP,PV,OP,MODE\n" + "\n".join(f"{x},{'MAN' if i % 5 else 'AUTO'}" for i, x in enumerate(lines[1:])) + "\n",
        "time,SP,PV,OP,Quality\n" + "\n".join(f"{x},{192 if i % 5 else 0}" for i, x in enumerate(lines[1:])) + "\n",
        "loop," + lines[0] + "\n" + "\n".join(f"A{i % 2},{x}" for i, x in enumerate(lines[1:])) + "\n",
        "\n".join([lines[0], *reversed(lines[1:])]) + "\n",
        wide(record(rows=40)), wide(record(rows=70), stamp=lambda m: m.strftime("%H:%M:%S")),
    ]
    return tuple(t.encode() for t in texts)


def pack(rng: random.Random, data: bytes) -> bytes:
    """The bytes in one of the wrappings that exports come in, damaged now and then."""
    kind = rng.randrange(9)
    if kind == 0:
        return gzip.compress(data, 1)
    if kind == 1:
        sink = io.BytesIO()
        with zipfile.ZipFile(sink, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
            for i in range(rng.choice((1, 1, 1, 0, 2))):
                archive.writestr(rng.choice(("a.csv", "../a.csv", "d/a.csv", "b.txt")) + ("" if i == 0 else "2"), data)
        return sink.getvalue()
    text = data.decode("utf-8", "replace")
    if kind in (2, 3, 4):
        return text.encode(("utf-16", "utf-16-le", "utf-32")[kind - 2], "replace")
    if kind == 5:
        return b"\xef\xbb\xbf" + data
    if kind == 6:
        return text.encode(rng.choice(("cp1252", "cp1251", "gbk", "shift_jis")), "replace")
    return data + b"\0" * rng.randrange(600) if kind == 7 else text.replace("\n", "\r").encode()


def damage(rng: random.Random, data: bytes, most: int = 6) -> bytes:
    """Bytes flipped, cut, doubled, spliced, and tokens put in."""
    for _ in range(rng.randint(1, most)):
        n = len(data)
        if n == 0:
            return rng.randbytes(rng.randrange(40))
        kind, at = rng.randrange(12), rng.randrange(n)
        to = min(n, at + rng.choice((1, 2, 4, 16, 200)))
        if kind == 0:
            data = data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at] + bytes([rng.choice((0, 9, 10, 13, 32, 34, 44, 59, 127, 128, 255))]) + data[at + 1 :]
        elif kind == 2:
            data = data[:at] + data[to:]
        elif kind == 3:
            data = data[:to] + data[at:to] * rng.choice((1, 1, 2, 30)) + data[to:]
        elif kind in (4, 5):
            token = rng.choice(TOKENS).encode("utf-8", "replace")
            data = data[:at] + token + data[at if kind == 4 else to :]
        elif kind == 6:
            other = rng.choice(seeds())
            data = data[:at] + other[rng.randrange(len(other)) :]
        elif kind == 7:
            data = data[:at]
        elif kind == 8:
            lines = data.split(b"\n")
            i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
            lines[i], lines[j] = lines[j], lines[i]
            data = b"\n".join(lines)
        elif kind == 9:
            lines = data.split(b"\n")
            lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            data = b"\n".join(lines)
        elif kind == 10:
            lines = data.split(b"\n")
            place = rng.randrange(len(lines))
            mark = rng.choice((b",", b";", b"\t", b"|", b" "))
            cells = lines[place].split(mark)
            cells[rng.randrange(len(cells))] = rng.choice(TOKENS).encode("utf-8", "replace")
            lines[place] = mark.join(cells)
            data = b"\n".join(lines)
        else:
            data = data[:at] + rng.randbytes(rng.randrange(8)) + data[at:]
    return data[:20_000]


def stamps_of(rng: random.Random, rows: int) -> list[str]:
    step = rng.choice((0.1, 1, 1, 1, 10, 60, 3600))
    style = rng.choice(("%Y-%m-%d %H:%M:%S", "epoch", "count")) if rng.random() < 0.4 else rng.choice((
        "%Y-%m-%d %H:%M:%S", "%Y-%m-%dT%H:%M:%SZ", "%d/%m/%Y %H:%M:%S", "%m/%d/%y %I:%M %p", "%d.%m.%Y %H:%M",
        "%d %B %Y %H:%M:%S", "%Y%m%d %H%M%S", "%H:%M:%S", "%Y-%m-%d", "epoch", "ms", "filetime", "serial", "count"))
    found = []
    for i in range(rows):
        moment = _START + timedelta(seconds=step * i)
        if style == "count":
            found.append(f"{i * step:g}")
        elif style in ("epoch", "ms"):
            found.append(epoch(moment, 1 if style == "epoch" else 1000))
        elif style == "filetime":
            found.append(filetime(moment))
        else:
            found.append(excel_serial(moment) if style == "serial" else moment.strftime(style))
    order = rng.randrange(8)
    if order == 0:
        found.reverse()
    elif order == 1:
        rng.shuffle(found)
    elif order == 2:
        found = [rng.choice(found) for _ in found] if found else found
    return found


def signal(rng: random.Random, rows: int, sane: bool = False) -> list[str]:
    """Cells of one column: measurements, or anything else a column may hold."""
    kind = rng.randrange(8, 12) if sane else rng.randrange(12)
    if kind == 0:
        return ["50"] * rows
    if kind == 1:
        return [rng.choice(("0", "1")) for _ in range(rows)]
    if kind == 2:
        return [rng.choice(TOKENS) for _ in range(rows)]
    if kind == 3:
        size = rng.choice((1e-320, 1e-300, 1e-44, 1e300, 1e308, 1e18))
        return [repr(size * rng.uniform(-1, 1)) for _ in range(rows)]
    if kind == 4:
        return [str(rng.choice((0, 192, 216, 100, 2, 253, -9999, 8388672))) for _ in range(rows)]
    if kind == 5:
        return [rng.choice(("MAN", "AUTO", "CAS", "3", "手动", "")) for _ in range(rows)]
    if kind == 6:
        return [f"{rng.uniform(0, 9999):,.2f}" for _ in range(rows)]
    digits = rng.choice((1, 3) if sane else (0, 1, 3, 6, 17))
    level, size = rng.choice((0, 50, 1250, -5)), rng.choice((0.1, 3, 100))
    cells = [f"{level + size * rng.uniform(-1, 1):.{digits}f}" for _ in range(rows)]
    return [comma(c) for c in cells] if kind == 7 else cells


def table(rng: random.Random) -> tuple[list[str], list[list[str]]]:
    """Names and columns of a random table, some of it sensible."""
    rows, width = rng.choice((0, 2, 5, 12, 12, 12, 25, 25, 70)), rng.choice((1, 3, 3, 4, 4, 4, 5, 7))
    if rng.random() < 0.8:
        names = ["time", "SP", "PV", "OP", *(rng.choice(NAMES) for _ in range(3))][: max(width, 3)]
    else:
        names = [rng.choice(NAMES) for _ in range(width)]
    sane = rng.random() < 0.6
    columns = [stamps_of(rng, rows) if ("t" in n.lower() and (sane or rng.random() < 0.8)) or rng.random() < 0.05
               else signal(rng, rows, sane and rng.random() < 0.9) for n in names]
    if rng.random() < 0.2:
        place, word = rng.randrange(len(names)), rng.choice(("", "Bad", "NaN"))
        columns[place] = [word if gone else c for c, gone in zip(columns[place], missing(rng, rows), strict=True)]
    for _ in range(rng.choice((0, 0, 1, 3, 8)) if rows else 0):
        rng.choice(columns)[rng.randrange(rows)] = rng.choice(TOKENS)
    return names, columns


def text_table(rng: random.Random) -> bytes:
    """A random table as text, in a random dialect."""
    names, columns = table(rng)
    sep, end = rng.choice((",", ",", ";", "\t", "|", " ")), rng.choice(("\n", "\n", "\r\n", "\r"))
    quote = rng.random() < 0.15
    lines = [names] * rng.choice((1, 1, 1, 1, 0, 2)) + [list(row) for row in zip(*columns, strict=True)]
    for extra in range(rng.choice((0, 0, 0, 0, 0, 1, 3))):
        lines.insert(extra, [rng.choice(TOKENS) for _ in range(rng.choice((1, 2, len(names))))])
    text = end.join(sep.join(f'"{c}"' if quote else c for c in row) for row in lines) + rng.choice((end, ""))
    return text.encode("utf-8", "replace")


def arrow_table(rng: random.Random) -> bytes:
    """A random table as Parquet: odd types, nulls, dictionaries, nested and extension columns."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    names, columns = table(rng)
    draw = np.random.default_rng(rng.getrandbits(32))
    rows = len(columns[0]) if columns else 0
    arrays = []
    for name, cells in zip(names, columns, strict=True):
        if name in ("SP", "PV", "OP") and rng.random() < 0.7:
            kind = rng.choice((15, 12, 0, 5))
        else:
            kind = rng.randrange(16) if "t" not in name.lower() else rng.choice((0, 1, 1, 1, 2, 3))
        if kind in (0, 4):
            array = pa.array(cells, pa.string())
        elif kind in (1, 2):
            base = rng.choice((0, 1_717_164_000, -(10**9), 9 * 10**9))
            unit, tz = rng.choice(("s", "ms", "us", "ns")), rng.choice((None, None, "UTC", "Europe/Berlin"))
            per = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
            array = pa.array([max(-(2**62), min(2**62, (base + i) * per)) for i in range(rows)], pa.timestamp(unit, tz))
        elif kind == 3:
            array = pa.array(np.arange(rows) * rng.choice((1, 0, -1, 10**15)), pa.int64())
        elif kind == 5:
            array = pa.array(draw.integers(0, 3, rows), pa.int8())
        elif kind == 6:
            array = pa.array(cells, pa.string()).dictionary_encode()
        elif kind == 7:
            array = pa.array([None] * rows, pa.null())
        elif kind == 8:
            array = pa.array(draw.integers(0, 2, rows).astype(bool))
        elif kind == 9:
            array = pa.array([[1.0]] * rows, pa.list_(pa.float64()))
        elif kind == 10:
            array = pa.array([c.encode() for c in cells], pa.binary())
        elif kind == 11:
            array = pa.array(draw.integers(-(2**62), 2**62, rows), pa.int64()).cast(pa.decimal128(30, 0))
        elif kind == 12:
            array = pa.array(draw.standard_normal(rows) * rng.choice((1e-320, 1, 1e300)),
                             rng.choice((pa.float64(), pa.float32())))
        elif kind == 13:
            array = pa.array(draw.integers(0, 2**63, rows, dtype=np.uint64), pa.uint64())
        elif kind == 14:
            array = rng.choice((pa.array(draw.integers(0, 20_000, rows), pa.int32()).cast(pa.date32()),
                                pa.array(draw.integers(0, 86_400, rows), pa.int32()).cast(pa.time32("s"))))
        else:
            array = pa.array(50 + np.round(draw.standard_normal(rows), 3))
        if rows and rng.random() < 0.2 and (pa.types.is_string(array.type) or pa.types.is_floating(array.type)):
            mask = missing(rng, rows)
            array = pa.array([None if m else v for v, m in zip(array.to_pylist(), mask, strict=True)], array.type)
        arrays.append(array)
    sink = io.BytesIO()
    schema = pa.schema([pa.field(n, a.type) for n, a in zip(names, arrays, strict=True)])
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), sink,
                   compression=rng.choice(("none", "snappy", "zstd", "gzip")))
    return sink.getvalue()
