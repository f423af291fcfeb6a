"""The bytes of an export: found, unpacked within limits, named for what they are, fingerprinted.

Everything that is not text or Parquet is refused here, by its first bytes and not by its extension.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import sys
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import DataError, UsageError

MAX_TEXT_BYTES = 4 << 30
"""Largest text read into memory, bytes: about 60 million rows of four tags; larger belongs in Parquet."""
MAX_UNPACKED_RATIO = 200
"""Unpacked over packed size; real exports pack 5 to 30 times, a bomb a thousand times."""
MIN_UNPACKED_BYTES = 64 << 20
"""Unpacked size below which the ratio is not looked at, bytes."""
MAX_LINE_BYTES = 1 << 20
"""Longest line, bytes: a row of 10,000 tags at 100 characters; longer is no table."""
_BLOCK = 1 << 20
_BLANK = b" \r\n\t\0"

_KINDS = (
    (b"PAR1", "parquet"),
    (b"\x1f\x8b", "gzip"),
    (b"PK\x03\x04", "zip"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook (.xls)"),
    (b"%PDF", "a PDF"),
    (b"\x89PNG", "a picture"),
    (b"\xff\xd8\xff", "a picture"),
    (b"7z\xbc\xaf", "a 7-Zip archive"),
    (b"Rar!", "a RAR archive"),
    (b"SQLite format 3", "an SQLite database"),
    (b"\x89HDF", "an HDF5 file"),
    (b"ARROW1", "an Arrow file"),
    (b"\x28\xb5\x2f\xfd", "a zstd file"),
    (b"BZh", "a bzip2 file"),
    (b"\xfd7zXZ", "an xz file"),
)


@dataclass(frozen=True, slots=True)
class Source:
    """One file's content: `kind` is "text" or "parquet"; Parquet keeps only its path or bytes."""

    name: str
    kind: str
    data: bytes
    sha256: str
    path: Path | None = None
    notes: tuple[str, ...] = ()


def open_source(file: Any) -> Source:
    """The content of a path, of '-' (standard input) or of an object with read().

    UsageError where it is absent or not readable; DataError where the content is no text and no Parquet.
    """
    if hasattr(file, "read"):
        content = file.read()
        data = content.encode() if isinstance(content, str) else bytes(content)
        return _from_bytes(data, str(getattr(file, "name", "data")))
    if str(file) == "-":
        return _from_bytes(_read_limited(sys.stdin.buffer, "standard input"), "standard input")
    path = Path(file)
    if not path.exists():
        raise UsageError(f"{path} does not exist", "check the spelling; ls shows what is there")
    try:
        with open(path, "rb") as stream:
            start = stream.read(_BLOCK)
            stream.seek(0)
            if _kind(start) == "parquet":
                return Source(path.name, "parquet", b"", _digest(stream), path)
            if _kind(start) == "text" and len(start) == _BLOCK:
                _check_lines(start, path.name)
            data = _read_limited(stream, path.name)
    except OSError as error:
        raise UsageError(f"{path} can't be read: {error.strerror or error}", "check its permissions") from None
    return _from_bytes(data, path.name, path)


def _read_limited(stream: BinaryIO, name: str) -> bytes:
    data = (
        stream.read()
        if stream.seekable() and os.fstat(stream.fileno()).st_size <= MAX_TEXT_BYTES
        else stream.read(MAX_TEXT_BYTES + 1)
    )
    if len(data) > MAX_TEXT_BYTES:
        raise DataError(
            f"{name} is larger than {MAX_TEXT_BYTES >> 30} GiB, the most text that is read at once",
            "cut it into pieces, or convert it to Parquet",
        )
    return data


def _digest(stream: Any) -> str:
    return hashlib.file_digest(stream, "sha256").hexdigest()


def in_short(error: Exception) -> str:
    """What a library says about damage, on one line."""
    return " ".join(str(error).split())[:160] or type(error).__name__


def _kind(start: bytes) -> str:
    return next((kind for magic, kind in _KINDS if start.startswith(magic)), "text")


def _from_bytes(data: bytes, name: str, path: Path | None = None) -> Source:
    digest = hashlib.sha256(data).hexdigest()
    notes: tuple[str, ...] = ()
    kind = _kind(data)
    if kind == "gzip":
        data, notes, kind = _gunzip(data, name), ("gzip",), ""
    elif kind == "zip":
        data, inner = _unzip(data, name)
        notes, kind = (f"zip, holding {inner}",), ""
    kind = kind or _kind(data)
    if not data[:_BLOCK].strip(_BLANK) and not data.strip(_BLANK):
        raise DataError(f"{name} is empty", "export it again, with a header line and one row per time")
    if kind not in ("text", "parquet"):
        raise DataError(
            f"{name} is {kind}, not CSV, TSV, text or Parquet", "save or export it as CSV (Excel: Save as, CSV UTF-8)"
        )
    if kind == "text":
        _check_lines(data, name)
    return Source(name, kind, data, digest, path, notes)


def _check_lines(data: bytes, name: str) -> None:
    """Refuse a line longer than the limit; hops from line end to line end, so it costs one look per megabyte."""
    position = 0
    while len(data) - position > MAX_LINE_BYTES:
        end = data.rfind(b"\n", position, position + MAX_LINE_BYTES)
        if end < 0:
            end = data.rfind(b"\r", position, position + MAX_LINE_BYTES)
        if end <= position:
            raise DataError(
                f"{name} has a line longer than {MAX_LINE_BYTES:,} bytes (from byte {position:,} on): "
                "no table of a loop looks like that",
                "check that it is the export you meant",
            )
        position = end + 1


def _gunzip(data: bytes, name: str) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            return _unpack(stream, len(data), name)
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(f"{name} is damaged gzip: {in_short(error)}", "copy or export it again") from None


def _unzip(data: bytes, name: str) -> tuple[bytes, str]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [m for m in archive.infolist() if not m.is_dir() and not m.filename.startswith("__MACOSX/")]
            names = {m.filename for m in members}
            if "[Content_Types].xml" in names or "mimetype" in names:
                raise DataError(
                    f"{name} is a workbook (.xlsx or .ods), whatever its name says, not CSV",
                    "save it from Excel as CSV UTF-8 and read that",
                )
            if len(members) != 1:
                raise DataError(
                    f"{name} is a zip of {len(members)} files; one is needed", "unpack it and give the file you mean"
                )
            with archive.open(members[0]) as stream:
                return _unpack(stream, len(data), name), members[0].filename
    except (zipfile.BadZipFile, OSError, EOFError, zlib.error, NotImplementedError, RuntimeError, ValueError,
            LookupError) as error:
        raise DataError(f"{name} can't be unpacked: {in_short(error)}", "unpack it by hand and give the file") from None


def _unpack(stream: Any, packed: int, name: str) -> bytes:
    """Everything in `stream`, stopped before it fills the memory."""
    limit = min(MAX_TEXT_BYTES, max(MIN_UNPACKED_BYTES, packed * MAX_UNPACKED_RATIO))
    data: bytes = stream.read(limit + 1)
    if len(data) > limit:
        raise DataError(
            f"{name} unpacks to more than {limit:,} bytes from {packed:,}", "unpack it by hand if you trust it"
        )
    return data
