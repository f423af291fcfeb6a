"""Limits and large files: refused before memory fills, raised on request, read in pieces to the same arrays."""

from __future__ import annotations

import gzip
import io

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from historian_files import Record, comma, record, wide

from stictionid.errors import DataError, UsageError
from stictionid.historian import ReadOptions, read
from stictionid.historian.bytes import source
from stictionid.historian.bytes.source import Limits, limits_from

R = record(rows=3000)


def _read(content, **options):
    return read(io.BytesIO(content.encode() if isinstance(content, str) else content), options=ReadOptions(**options))


def test_sizes_are_understood_and_nonsense_is_not():
    said = limits_from(("rows=1e8", "file=100GB", "line=2MiB", "unpacked=3.5g"))
    assert said == Limits(rows=10**8, file=10**11, line=2 << 20, unpacked=3_500_000_000)
    for wrong in ("rows", "rows=", "rows=-1", "rows=0", "words=5", "rows=1e99", "rows=1x"):
        with pytest.raises(UsageError, match="--limit"):
            limits_from((wrong,))


@pytest.mark.parametrize("limit, words", [("rows=100", "3,001 rows"), ("columns=3", "4 columns"),
                                          ("line=20", "line longer than 20")])
def test_text_above_a_limit_names_the_option(limit, words):
    with pytest.raises(DataError) as caught:
        _read(wide(R), limit=(limit,))
    assert words in caught.value.message and f"--limit {limit.partition('=')[0]}=" in caught.value.hint


def test_bombs_are_refused_and_a_limit_that_was_said_lets_them_in():
    # (Lines of blanks: as many empty ones would be 70 million lines to look at.)
    bomb = gzip.compress(wide(R).encode() + (b" " * 1023 + b"\n") * (70 << 10))
    with pytest.raises(DataError, match="unpacks to more") as caught:
        _read(bomb)
    assert "--limit unpacked=" in caught.value.hint
    assert _read(bomb, limit=("unpacked=100MB", "rows=1e8")).loop.samples == 3000


def _parquet(columns):
    sink = io.BytesIO()
    pq.write_table(pa.table(columns), sink, compression="zstd")
    return sink.getvalue()


def test_parquet_bombs_of_rows_and_of_words():
    zeros = np.zeros(200_000)
    rows = _parquet({"time": np.arange(200_000), "PV": zeros, "OP": zeros})
    assert len(rows) < 1_000_000
    with pytest.raises(DataError, match="200,000 rows, more than the limit"):
        _read(rows, limit=("rows=1e5",))
    with pytest.raises(DataError, match="unpacked, more than the limit"):
        _read(rows, limit=("unpacked=1MB",))
    word = pa.DictionaryArray.from_arrays(np.zeros(5000, np.int32), pa.array(["x" * 1_000_000]))
    words = _parquet({"time": np.arange(5000), "PV": zeros[:5000], "OP": zeros[:5000], "MODE": word})
    assert len(words) < 200_000
    with pytest.raises(DataError, match="5 GB unpacked"):
        _read(words)


def test_only_the_wanted_columns_of_wide_parquet_are_read():
    rng = np.random.default_rng(1)
    columns = {"time": pa.array(R.stamps), "SP": R.numbers("sp"), "PV": R.numbers("pv"), "OP": R.numbers("op")}
    columns |= {f"TI{i}": rng.standard_normal(3000) for i in range(30)} | {"remark": ["words"] * 3000}
    reading = _read(_parquet(columns))
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv"))
    assert len(reading.unused) == 31 and reading.rows == {"in": 3000, "used": 3000}
    kept = _read(_parquet(columns), extra=("TI7",))
    np.testing.assert_array_equal(kept.loop.extras["TI7"], columns["TI7"])


@pytest.fixture
def small_pieces(monkeypatch):
    """Files of a few thousand bytes are read in pieces."""
    from stictionid.historian.table import streamed

    monkeypatch.setattr(source, "MIN_STREAMED_BYTES", 10_000)
    monkeypatch.setattr(source, "PIECE_BYTES", 7_001)
    monkeypatch.setattr(streamed, "HEAD_BYTES", 5_000)


def _spoilt() -> str:
    """A file whose first piece is clean and whose later ones hold texts, damage, decimals and a footer."""
    lines = wide(R).splitlines()
    lines[1500] = lines[1500].rsplit(",", 1)[0] + ",Bad Input"
    lines[2000] = "torn"
    lines[2200] = ""
    return "\n".join([lines[0], *lines[1:2500], lines[0], *lines[2500:], "(3000 rows affected)"]) + "\n"


@pytest.mark.parametrize("text", [
    wide(R), _spoilt(), wide(R, sep=";", cell=comma, end="\r\n"), "\ufeff" + wide(R),
    wide(R, stamp=lambda m: m.strftime("%d.%m.%Y %H:%M:%S")), wide(R)[:-1],
    wide(R).replace("FIC101.OP", "FIC101.OP [°]"), wide(R, sep="  ", names="date,clock,SP,PV,OP"),
    wide(Record(R.stamps, R.sp, [str(int(float(v))) for v in R.pv[:1500]] + R.pv[1500:], R.op)),
    wide(R, above=("Server: HIST01", "")), "\n".join([wide(R).splitlines()[0], *wide(R).splitlines()[:0:-1]]) + "\n",
], ids=["plain", "spoilt", "commas", "mark", "dots", "no last line end", "unicode", "blanks", "integers first",
        "preamble", "newest first"])
def test_pieces_give_what_the_whole_gives(tmp_path, small_pieces, text):
    path = tmp_path / "large.csv"
    path.write_bytes(text.encode())
    whole, pieces = _read(text), read(path)
    for role in ("process_value", "output", "setpoint", "used"):
        np.testing.assert_array_equal(getattr(pieces.loop, role), getattr(whole.loop, role))
    assert pieces.rows == whole.rows and pieces.sha256 == whole.sha256 and pieces.columns == whole.columns
    assert [f.statement for f in pieces.findings] == [f.statement for f in whole.findings]


def test_pieces_keep_to_the_limits_and_notice_a_change(tmp_path, small_pieces, monkeypatch):
    path = tmp_path / "large.csv"
    path.write_text(wide(R))
    with pytest.raises(DataError, match=r"more than the limit of 1,000 rows"):
        read(path, options=ReadOptions(limit=("rows=1000",)))
    path.write_text(wide(R) + "1" * 5000 + "\n")
    with pytest.raises(DataError, match="line longer"):
        read(path, options=ReadOptions(limit=("line=3000",)))
    path.write_bytes(wide(R).encode() + b"2024-05-31 15:00:00,5,\xff,5\n")
    with pytest.raises(DataError, match="is not UTF-8"):
        read(path)
    path.write_text(wide(R))
    for piece, _ in source.pieces(source.open_source(path), Limits()):
        assert piece
        break
    with pytest.raises(DataError, match="changed while"):
        for _ in source.pieces(source.open_source(path), Limits()):
            with open(path, "a") as more:
                more.write("2024-05-31 16:00:00,5,5,5\n")
                if more.tell() > 1_000_000:
                    break


def test_loops_are_listed_without_reading_all(tmp_path, small_pieces):
    from stictionid.historian import loops_in

    wide_columns = {"time": pa.array(R.stamps)}
    wide_columns |= {f"F{i}.{t}": R.numbers(t.lower()) for i in range(6) for t in ("SP", "PV", "OP")}
    pq.write_table(pa.table(wide_columns), tmp_path / "a.parquet")
    six = tuple(f"F{i}" for i in range(6))
    assert loops_in(tmp_path / "a.parquet") == six
    path = tmp_path / "a.csv"
    path.write_text(",".join(wide_columns) + "\n" + "".join(
        f"{m}," + ",".join([f"{R.sp[i]},{R.pv[i]},{R.op[i]}"] * 6) + "\n" for i, m in enumerate(R.stamps)))
    assert loops_in(path) == six
    rows = [f"{loop},{m},{R.pv[i]},{R.op[i]}" for loop in ("A", "B") for i, m in enumerate(R.stamps)]
    path.write_text("loop,time,PV,OP\n" + "\n".join(rows) + "\n")
    assert loops_in(path) == ("A", "B")
    np.testing.assert_array_equal(read(path, options=ReadOptions(loop="B")).loop.process_value, R.numbers("pv"))
