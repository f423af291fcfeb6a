"""One small file per export trap of docs/traps.md in the vendors' formats: all read to the same arrays."""

from __future__ import annotations

import gzip
import io
import zipfile
from datetime import timedelta

import numpy as np
import pytest
from historian_files import ROWS, comma, epoch, excel_serial, filetime, html, iso, long, paired, record, wide

from stictionid.historian import ReadOptions, read

R = record()
BIG = record(level=1250.0)


def _utf16(text: str) -> bytes:
    return text.encode("utf-16")


def _zip(text: str) -> bytes:
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("export.csv", text)
    return sink.getvalue()


def _quoted(text: str) -> str:
    return f'"{text}"'


def _am_pm(moment):
    return moment.strftime("%m/%d/%Y %I:%M:%S %p")


GERMAN = {5: "Mai"}
TAB = "\t"
UNITS = ",%,m3/h,%"

# name → (file content, options)
SAME = {
    "plain csv": (wide(R), {}),
    "tabs": (wide(R, sep=TAB), {}),
    "pipes": (wide(R, sep="|"), {}),
    "semicolons and decimal commas": (wide(R, sep=";", cell=comma), {}),
    "tabs and decimal commas": (wide(R, sep=TAB, cell=comma), {}),
    "quoted decimal commas": (wide(R, cell=lambda c: _quoted(comma(c))), {}),
    "blanks": (wide(R, sep="  ", names="date,clock,SP,PV,OP"), {}),
    "crlf": (wide(R, end="\r\n"), {}),
    "old mac line ends": (wide(R, end="\r"), {}),
    "byte-order mark": (b"\xef\xbb\xbf" + wide(R).encode(), {}),
    "utf-16 excel unicode text": (_utf16(wide(R, sep=TAB)), {}),
    "utf-16 without a mark": (wide(R, sep=TAB).encode("utf-16-le"), {}),
    "nul padding": (wide(R).encode() + b"\0" * 512, {}),
    "gzip": (gzip.compress(wide(R).encode()), {}),
    "zip": (_zip(wide(R)), {}),
    "html called xls": (html(R), {}),
    "units line": (wide(R, names=None, above=("timestamp,FIC101.SP,FIC101.PV,FIC101.OP", UNITS)), {}),
    "units and descriptions": (
        wide(R, names=None, above=("timestamp,FIC101.SP,FIC101.PV,FIC101.OP", UNITS, ",set,flow to tank,valve")),
        {},
    ),
    "descriptions above names": (wide(R, above=(",Setpoint flow,Flow,Valve",)), {}),
    "preamble": (wide(R, above=("Plant historian export", "Server: HIST01", "From 31.05.2024, to 31.05.2024", "")), {}),
    "footer": (wide(R, below=("", "(120 rows affected)")), {}),
    "trailing separators": (wide(R, names="timestamp,SP,PV,OP,", end=",\n").replace("OP,,", "OP,"), {}),
    "blank lines": (wide(R).replace("\n", "\n\n"), {}),
    "long": (long(R), {}),
    "long without quality": (long(R, header="TagName;DateTime;Value", sep=";"), {}),
    "long without header": (long(R, header=None), {"header": 0}),
    "long with opc codes": (long(R, good="192"), {}),
    "long with confidence": (
        long(R, header="Tag,Time,Value,Confidence").replace("\n", ",100\n").replace("Confidence,100", "Confidence"),
        {},
    ),
    "paired": (paired(R), {}),
    "no header, by number": (wide(R, names=None), {"time": "1", "sp": "2", "pv": "3", "op": "4"}),
    "per cent signs": (wide(R, cell=lambda c: f"{c} %"), {}),
    "units in cells": (wide(R, cell=lambda c: f"{c} m3/h"), {"span_op": (0.0, 100.0)}),
    "excel text cells": (wide(R, cell=lambda c: f'="{c}"'), {}),
    "plus signs and blanks": (wide(R, cell=lambda c: f" +{c} "), {}),
    "exponents": (wide(R, cell=lambda c: f"{float(c):.6E}"), {}),
    "exponents with comma": (wide(R, sep=";", cell=lambda c: f"{float(c):.6E}".replace(".", ",")), {}),
    "day first": (wide(R, stamp=lambda m: m.strftime("%d/%m/%Y %H:%M:%S")), {}),
    "month first, am and pm": (wide(R, stamp=_am_pm), {}),
    "day first with dots": (wide(R, stamp=lambda m: m.strftime("%d.%m.%Y %H:%M:%S")), {}),
    "two-digit year": (wide(R, stamp=lambda m: m.strftime("%d.%m.%y %H:%M:%S")), {}),
    "month by name": (wide(R, stamp=lambda m: m.strftime("%d-%b-%y %H:%M:%S")), {}),
    "month in german": (wide(R, stamp=lambda m: m.strftime("%d-Mai-%Y %H:%M:%S")), {}),
    "month in russian": (wide(R, stamp=lambda m: m.strftime("%d мая %Y %H:%M:%S")), {}),
    "month in french, cp1252": (
        wide(record(start=R.stamps[0].replace(month=12)), stamp=lambda m: m.strftime("%d déc. %Y %H:%M:%S")).encode(
            "cp1252"
        ),
        {},
    ),
    "month name first": (wide(R, sep=TAB, stamp=lambda m: m.strftime("May %d, %Y %H:%M:%S")), {}),
    "chinese date": (wide(R, stamp=lambda m: m.strftime("%Y年%m月%d日 %H:%M:%S")), {}),
    "seven digits and Z": (wide(R, stamp=lambda m: m.strftime("%Y-%m-%dT%H:%M:%S.0000000Z")), {}),
    "utc offset": (wide(R, stamp=lambda m: m.strftime("%Y-%m-%dT%H:%M:%S+02:00")), {}),
    "slashes year first": (wide(R, stamp=lambda m: m.strftime("%Y/%m/%d %H:%M:%S")), {}),
    "compact stamp": (wide(R, stamp=lambda m: m.strftime("%Y%m%dT%H%M%S")), {}),
    "compact digits": (wide(R, stamp=lambda m: m.strftime("%Y%m%d %H%M%S")), {}),
    "epoch seconds": (wide(R, stamp=epoch), {}),
    "epoch milliseconds": (wide(R, stamp=lambda m: epoch(m, 1000)), {}),
    "epoch microseconds": (wide(R, stamp=lambda m: epoch(m, 10**6)), {}),
    "epoch nanoseconds": (wide(R, stamp=lambda m: epoch(m, 10**9)), {}),
    "filetime": (wide(R, stamp=filetime), {}),
    "excel serial": (wide(R, stamp=excel_serial), {}),
    "excel serial 1904": (wide(R, stamp=excel_serial), {"time_format": "excel1904"}),
    "date and clock": (
        wide(R, names="date,clock,FIC101.SP,FIC101.PV,FIC101.OP", stamp=lambda m: m.strftime("%Y-%m-%d,%H:%M:%S")),
        {},
    ),
    "german date and clock": (
        wide(R, sep=";", names="Datum,Uhrzeit,SP,PV,OP", stamp=lambda m: m.strftime("%d.%m.%Y;%H:%M:%S"), cell=comma),
        {},
    ),
    "clock over midnight": (
        wide(record(start=R.stamps[0].replace(hour=23, minute=59)), stamp=lambda m: m.strftime("%H:%M:%S")),
        {},
    ),
    "seconds": (wide(R, names="time_s,SP,PV,OP", stamp=lambda m: str((m - R.stamps[0]).seconds)), {}),
    "minutes": (wide(R, names="t_min,SP,PV,OP", stamp=lambda m: f"{(m - R.stamps[0]).seconds / 60:.9f}"), {}),
    "minutes by unit line": (
        wide(
            R, names=None, above=("t,SP,PV,OP", "min,%,bar,%"), stamp=lambda m: f"{(m - R.stamps[0]).seconds / 60:.9f}"
        ),
        {},
    ),
    "no time, step said": (
        wide(R, names="n,SP,PV,OP", stamp=lambda m: str((m - R.stamps[0]).seconds)),
        {"step_s": 1.0},
    ),
    "newest first": ("\n".join([wide(R).splitlines()[0], *reversed(wide(R).splitlines()[1:])]) + "\n", {}),
    "zone said": (wide(R), {"zone": "Europe/Berlin"}),
}

NAMES = {
    "honeywell": "Time,FIC-101.PIDA.SP,FIC-101.PIDA.PV,FIC-101.PIDA.OP",
    "yokogawa": "Time,FIC101.SV,FIC101.PV,FIC101.MV",
    "deltav": "Time,FIC-101/PID1/SP.CV,FIC-101/PID1/PV.CV,FIC-101/PID1/OUT.CV",
    "foxboro": "Time,FIC101.SPT,FIC101.MEAS,FIC101.OUT",
    "siemens": "Time,FIC101.SP,FIC101.PV_IN,FIC101.LMN",
    "rockwell": "Time,FIC101.SPEU,FIC101.PVEU,FIC101.CVEU",
    "server": r"Time,\\SRV\FIC101.SP,\\SRV\FIC101.PV,\\SRV\FIC101.OP",
    "units in names": "Time,FIC-101.SP (m3/h),FIC-101.PV (m3/h),FIC-101.OP [%]",
    "letters": "t,r,y,u",
    "words": "Date Time,Set Point,Process Value,Controller Output",
    "german": "Zeit,Sollwert,Istwert,Stellgröße",
    "chinese": "时间,设定值,测量值,输出",
    "case and blanks": " TIME , sp , Pv , oP ",
    "quotes": '"Time","FIC101.SP","FIC101.PV","FIC101.OP"',
    "underscores": "Time,FIC_101_SP,FIC_101_PV,FIC_101_OP",
    "transmitter and valve": "Time,FIC211.SP,FT_211,FV_211",
}


def _read(tmp_path, content, options=None, name="export.csv"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read(path, options=ReadOptions(**(options or {})))


def _same(reading, r=R):
    loop = reading.loop
    np.testing.assert_array_equal(loop.process_value, r.numbers("pv"))
    np.testing.assert_array_equal(loop.output, r.numbers("op"))
    np.testing.assert_array_equal(loop.setpoint, r.numbers("sp"))
    assert loop.step_s == pytest.approx(1.0, abs=1e-9)
    assert loop.used.all()
    assert loop.starts == (0,)
    assert reading.rows["in"] == sum(v for k, v in reading.rows.items() if k != "in")


@pytest.mark.parametrize("name", SAME)
def test_reads_the_same_arrays(tmp_path, name):
    content, options = SAME[name]
    r = {"month in french, cp1252": record(start=R.stamps[0].replace(month=12))}.get(name, R)
    _same(_read(tmp_path, content, options), r)


TWELVE = (
    "plain csv", "semicolons and decimal commas", "tabs and decimal commas", "quoted decimal commas", "pipes",
    "utf-16 excel unicode text", "long", "paired", "html called xls", "month in russian", "excel text cells",
    "epoch milliseconds", "newest first",
)


def test_twelve_shapes_and_locales_give_the_same_bits(tmp_path):
    """Bytes of the arrays, not values: a parser that rounds differently in one shape would show here."""
    seen = set()
    for name in TWELVE:
        content, options = SAME[name]
        loop = _read(tmp_path, content, options).loop
        seen.add((loop.process_value.tobytes(), loop.output.tobytes(), loop.setpoint.tobytes(), loop.used.tobytes(),
                  loop.starts))
    assert len(TWELVE) >= 12 and len(seen) == 1


def test_the_gallery_holds_sixty_files():
    """Refusals have a gallery of their own."""
    assert len({content if isinstance(content, bytes) else content.encode() for content, _ in SAME.values()}) >= 60


@pytest.mark.parametrize("name", NAMES)
def test_finds_the_roles_by_the_vendors_names(tmp_path, name):
    _same(_read(tmp_path, wide(R, names=NAMES[name])))


@pytest.mark.parametrize(
    "mark, decimal", [(".", ","), ("'", "."), ("\u00a0", ","), ("\u202f", ","), (" ", ","), (",", ".")]
)
def test_thousands_marks(tmp_path, mark, decimal):
    def cell(text):
        whole, _, fraction = text.partition(".")
        return f"{int(whole):,}".replace(",", mark) + decimal + fraction

    loop = _read(tmp_path, wide(BIG, sep=";", cell=cell), {"span_op": (0.0, 100.0)}).loop
    np.testing.assert_array_equal(loop.process_value, BIG.numbers("pv"))
    np.testing.assert_array_equal(loop.setpoint, BIG.numbers("sp"))


def test_unicode_minus(tmp_path):
    r = record(level=0.0)
    loop = _read(tmp_path, wide(r, cell=lambda c: c.replace("-", "−"))).loop
    np.testing.assert_array_equal(loop.process_value, r.numbers("pv"))


def test_parquet_file_and_partitioned_folder(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({"time": R.stamps, "SP": R.numbers("sp"), "PV": R.numbers("pv"), "OP": R.numbers("op")})
    pq.write_table(table, tmp_path / "a.parquet")
    _same(read(tmp_path / "a.parquet"))
    day = pa.array(["a" if i < ROWS // 2 else "b" for i in range(ROWS)])
    pq.write_to_dataset(table.append_column("part", day), tmp_path / "set", partition_cols=["part"])
    _same(read(tmp_path / "set"))


def test_one_file_per_tag(tmp_path):
    for tag in ("sp", "pv", "op"):
        rows = [f"{iso(m)};{comma(getattr(R, tag)[i])}" for i, m in enumerate(R.stamps)]
        (tmp_path / f"FIC101.{tag.upper()}.csv").write_text("\n".join(["Time;Value", *rows]) + "\n")
    _same(read(tmp_path))
    rows[50] = rows[50].split(";")[0] + ";Bad Input"
    (tmp_path / "FIC101.OP.csv").write_text("\n".join(["Time;Value", *rows]) + "\n")
    damaged = read(tmp_path)
    assert damaged.rows["filled"] == 3  # the rows of all three tags at that time
    assert damaged.loop.output[51] == R.numbers("op")[51]


def test_file_object_and_data_frame():
    import pandas as pd

    from stictionid.historian import read_frame

    _same(read(io.BytesIO(wide(R).encode())))
    frame = pd.DataFrame(
        {"SP": R.numbers("sp"), "PV": R.numbers("pv"), "OP": R.numbers("op")}, index=pd.Index(R.stamps, name="time")
    )
    _same(read_frame(frame))


def test_stamps_with_seconds_dropped_are_spread_and_said(tmp_path):
    r = record(rows=240, step=10.0)
    reading = _read(tmp_path, wide(r, stamp=lambda m: m.strftime("%Y-%m-%d %H:%M")))
    assert reading.loop.step_s == 10.0
    assert "seconds-dropped" in {f.code for f in reading.findings}
    assert any("spread" in a for a in reading.assumptions)


def test_year_end_two_loops_in_one_long_file(tmp_path):
    other = record(seed=9)
    text = long(R) + "\n".join(long(other, loop="PIC202").splitlines()[1:]) + "\n"
    loop = _read(tmp_path, text, {"loop": "pic202"}).loop
    np.testing.assert_array_equal(loop.process_value, other.numbers("pv"))
    assert loop.name == "PIC202"


def test_loop_column(tmp_path):
    other = record(seed=9)
    lines = [
        f"{name},{iso(m)},{q.sp[i]},{q.pv[i]},{q.op[i]}"
        for name, q in (("A1", R), ("B2", other))
        for i, m in enumerate(q.stamps)
    ]
    reading = _read(tmp_path, "loop,time,SP,PV,OP\n" + "\n".join(lines) + "\n", {"loop": "B2"})
    np.testing.assert_array_equal(reading.loop.process_value, other.numbers("pv"))
    assert reading.rows["other loop"] == ROWS


def test_naive_time_stays_naive_and_window_cuts(tmp_path):
    reading = _read(tmp_path, wide(R), {"start": "14:00:30", "end": "60"})
    assert reading.loop.samples == 31
    assert reading.rows["outside window"] == ROWS - 31
    assert "naive" in reading.time
    assert reading.loop.origin.start == iso(R.stamps[0] + timedelta(seconds=30)).replace(" ", "T")
