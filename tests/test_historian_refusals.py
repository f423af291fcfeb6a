"""Files that cannot be read are refused in one sentence that names the place and the option that would settle it."""

from __future__ import annotations

import gzip
import io
import random
import zipfile

import pytest
from historian_files import R_STAMP, comma, iso, long, record, wide

from stictionid.errors import DataError, StictionidError, UsageError
from stictionid.historian import ReadOptions, read

R = record()


def _xlsx() -> bytes:
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w") as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("xl/workbook.xml", "<workbook/>")
    return sink.getvalue()


def _zip_of_two() -> bytes:
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w") as archive:
        archive.writestr("a.csv", wide(R))
        archive.writestr("b.csv", wide(R))
    return sink.getvalue()


def _with_cell(text: str, line: int, column: int, cell: str) -> str:
    lines = text.split("\n")
    cells = lines[line].split(",")
    cells[column] = cell
    lines[line] = ",".join(cells)
    return "\n".join(lines)


BOTH_DAYS = wide(record(start=R_STAMP.replace(month=3, day=4)), stamp=lambda m: m.strftime("%d/%m/%Y %H:%M:%S"))
EITHER = "time\tPV\tOP\n" + "".join(f"{iso(m)}\t1,25{i % 7}\t41,0{i % 9}0\n" for i, m in enumerate(R.stamps))
TWO_PV = "time,SP,PV,PV,OP\n" + "".join(f"{iso(m)},50,1{i % 7},2{i % 7},4{i % 9}\n" for i, m in enumerate(R.stamps))
PV_FIRST = "FIC1.PV,t1,FIC1.OP,t2,FIC1.SP\n" + "".join(f"1{i % 7},{iso(m)},4{i % 9},{iso(m)},50\n"
                                                          for i, m in enumerate(R.stamps))
# name → (content, options, kind, words the sentence or its hint must hold)
CASES = {
    "empty": (b"", {}, DataError, ["empty"]),
    "only blanks": (b" \n\r\n\0", {}, DataError, ["empty"]),
    "header only": ("time,SP,PV,OP\n", {}, DataError, ["no rows of numbers", "time SP PV OP"]),
    "one column": ("PV\n1\n2\n3\n", {}, DataError, ["one column", "--separator"]),
    "two columns of one name": (TWO_PV, {}, DataError, ["export.csv", "column 3", "column 4", "--pv 3", "--pv 4"]),
    "paired, PV before the first time": (
        PV_FIRST, {"pv": "1", "shape": "paired"}, DataError, ["column 'FIC1.PV' has no time column before it"]),
    "two columns of the name that was said": (
        TWO_PV, {"pv": "PV"}, DataError, ["export.csv", "2 columns named 'PV'", "number 3 and 4", "--pv 3", "--pv 4"]),
    "prose": ("Dear colleague,\nplease find attached the trend.\nRegards\n", {}, DataError, ["one column"]),
    "binary": (random.Random(1).randbytes(5000), {}, DataError, ["not text"]),
    "nul inside": (b"time,PV,OP\n1,\x002,3\n" * 40, {}, DataError, ["NUL"]),
    "endless line": (b"1," * (1 << 20), {}, DataError, ["line longer"]),
    "xlsx called csv": (_xlsx(), {}, DataError, ["workbook", "CSV"]),
    "old xls": (b"\xd0\xcf\x11\xe0" + b"\0" * 600, {}, DataError, ["workbook", "CSV"]),
    "pdf": (b"%PDF-1.7 ...", {}, DataError, ["PDF"]),
    "damaged gzip": (gzip.compress(wide(R).encode())[:200], {}, DataError, ["damaged gzip"]),
    "gzip bomb": (gzip.compress(b"0" * (80 << 20)), {}, DataError, ["unpacks to more"]),
    "zip of two": (_zip_of_two(), {}, DataError, ["zip of 2 files"]),
    "damaged parquet": (b"PAR1" + b"\0" * 100, {}, DataError, ["Parquet"]),
    "ambiguous dates": (
        BOTH_DAYS,
        {},
        DataError,
        ["04/03/2024 14:00:00", "line 2", "column 'timestamp'", "--dayfirst or --monthfirst"],
    ),
    "contradicting dates": (
        _with_cell(wide(R, stamp=lambda m: m.strftime("%d/%m/%Y %H:%M:%S")), 60, 0, "05/31/2024 14:00:59"),
        {},
        DataError,
        ["day first", "month first", "line 2,", "line 61", "column 'timestamp'", "31/05/2024", "05/31/2024"],
    ),
    "wrong date order said": (
        wide(R, stamp=lambda m: m.strftime("%d/%m/%Y %H:%M:%S")),
        {"dayfirst": False},
        DataError,
        ["--dayfirst"],
    ),
    "thousands or decimals": (EITHER, {}, DataError, ["1,250", "line 2", "column 'PV'", "--decimal"]),
    "commas between commas": (wide(R, cell=comma), {}, DataError, ["decimal commas"]),
    "no header": (wide(R, names=None), {}, DataError, ["no column for the process value", "--pv"]),
    "no time": (
        wide(R, names="n,SP,PV,OP", stamp=lambda m: str(m.second)),
        {},
        DataError,
        ["no time column", "--step"],
    ),
    "no op": (wide(R, names="time,SP,PV,TI7"), {}, DataError, ["controller output", "--op", "TI7"]),
    "two pv of one loop": (wide(R, names="time,F1.OP,F1.PV,F1.PV"), {}, DataError, ["F1.PV", "--pv"]),
    "one column for two roles": (wide(R), {"pv": "FIC101.OP", "op": "FIC101.OP"}, DataError, ["FIC101.OP", "both"]),
    "unknown column": (wide(R), {"pv": "FIC101.PF"}, DataError, ["FIC101.PF", "FIC101.PV"]),
    "several loops": (
        wide(R, names="time,A1.PV,A1.OP,A2.PV").replace("\n2024", ",1\n2024").replace("A2.PV,1", "A2.PV,A2.OP"),
        {},
        UsageError,
        ["A1", "A2", "--loop"],
    ),
    "unknown loop": (long(R), {"loop": "XIC9"}, UsageError, ["XIC9", "FIC101"]),
    "text in pv": (wide(R, cell=lambda c: "n.v."), {}, DataError, ["number"]),
    "states only": (wide(R, cell=lambda c: "Bad Input"), {}, DataError, ["PV"]),
    "three rows": (wide(record(3)), {}, DataError, ["3 usable rows"]),
    "window outside": (wide(R), {"start": "2030-01-01"}, StictionidError, ["2024-05-31"]),
    "window no time": (wide(R), {"start": "soon"}, UsageError, ["soon"]),
    "window upside down": (wide(R), {"start": "50", "end": "20"}, UsageError, ["not before"]),
    "unknown zone": (wide(R), {"zone": "Europe/Nowhere"}, UsageError, ["Europe/Nowhere"]),
    "unknown encoding": (wide(R), {"encoding": "utf-9"}, UsageError, ["utf-9"]),
    "wrong encoding": (
        "Zeit,Größe,PV,OP\n".encode("cp1252") + b"1,2,3,4\n" * 9,
        {"encoding": "utf-8"},
        DataError,
        ["--encoding"],
    ),
    "unknown time format": (wide(R), {"time_format": "stardate"}, UsageError, ["stardate"]),
    "unknown shape": (wide(R), {"shape": "tall"}, UsageError, ["tall"]),
    "empty span": (wide(R), {"span_op": (5.0, 5.0)}, UsageError, ["--span-op"]),
    "unknown mode meaning": (wide(R), {"mode_map": {"1": "SOMETIMES"}}, UsageError, ["SOMETIMES", "AUTO"]),
    "step no multiple": (wide(record(step=2.0)), {"step_s": 3.0}, UsageError, ["multiple"]),
    "step below": (wide(record(step=2.0)), {"step_s": 1.0}, UsageError, ["multiple"]),
    "days as time": (wide(R, stamp=lambda m: m.strftime("%Y%m%d")), {}, DataError, ["time of day"]),
    "time is text": (wide(R, stamp=lambda m: "soon"), {}, DataError, ["time"]),
    "no-guess: instrument letters": (wide(R, names="time,SP,FT_1,FV_1"), {"no_guess": True}, DataError, ["--pv"]),
    "no-guess: MV": (wide(R, names="time,A.SV,A.PV,A.MV"), {"no_guess": True}, DataError, ["--op"]),
    "no-guess: dots": (
        wide(record(start=R_STAMP.replace(day=3)), stamp=lambda m: m.strftime("%d.%m.%Y %H:%M:%S")),
        {"no_guess": True},
        DataError,
        ["day first"],
    ),
    "mostly damaged": (
        wide(record(400)) + "\n".join("1,2" for _ in range(900)) + "\n",
        {},
        DataError,
        ["cells", "line"],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_refuses_in_one_sentence(tmp_path, name):
    content, options, kind, words = CASES[name]
    path = tmp_path / "export.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(kind) as caught:
        read(path, options=ReadOptions(**options))
    text = f"{caught.value.message} | {caught.value.hint}"
    assert all(word in text for word in words), text
    assert "\n" not in caught.value.message
    assert len(caught.value.message) < 400
    assert caught.value.hint


def test_an_endless_line_below_a_header_is_seen_in_a_file_that_is_read_in_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr("stictionid.historian.bytes.source.MIN_STREAMED_BYTES", 1 << 20)
    path = tmp_path / "export.csv"
    path.write_bytes(b"time,PV,OP\n" + b"7" * (3 << 20))
    with pytest.raises(DataError, match=r"line longer than .*from byte 11 on"):
        read(path)


def test_no_guess_accepts_what_needs_no_guess(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(wide(R))
    assert read(path, options=ReadOptions(no_guess=True)).assumptions == ()


def test_absent_file_is_a_usage_error(tmp_path):
    with pytest.raises(UsageError, match="does not exist"):
        read(tmp_path / "nothing.csv")
    with pytest.raises(UsageError, match="0 exports"):
        read(tmp_path)


def test_said_dates_and_decimals_settle_what_was_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(BOTH_DAYS)
    for dayfirst, month in ((True, "03-04"), (False, "04-03")):
        assert month in read(path, options=ReadOptions(dayfirst=dayfirst)).loop.origin.start
    path.write_text(EITHER)
    assert read(path, options=ReadOptions(decimal=",")).loop.process_value[0] == 1.25
    assert read(path, options=ReadOptions(decimal=".")).loop.process_value[0] == 1250.0
