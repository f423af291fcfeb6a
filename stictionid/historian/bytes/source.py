"""Content of an export: opened, unpacked within limits, its kind recognised, with its SHA-256.

Content of no known kind is refused here, by its first bytes and not by its extension.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import re
import struct
import sys
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO

from ...errors import DataError, UsageError

MAX_UNPACKED_RATIO = 200
"""Unpacked over packed size; real exports pack 5 to 30 times, a bomb a thousand times."""
MIN_UNPACKED_BYTES = 64 << 20
"""Unpacked size below which the ratio is not checked, bytes."""
PIECE_BYTES = 32 << 20
"""Piece of a large text file that is parsed at once."""
MIN_STREAMED_BYTES = 256 << 20
"""Size of a text file from which on it is read in pieces and only in the columns that are wanted."""
_BLOCK = 1 << 20
_BLANK = b" \r\n\t\0"

_KINDS = (
    (b"PAR1", "parquet"),
    (b"\x1f\x8b", "gzip"),
    (b"PK\x03\x04", "zip"),
    (b"\xd0\xcf\x11\xe0", "workbook"),
    (b"MATLAB 5.0 MAT", "matlab"),
    (b"MATLAB 7.3 MAT", "matlab"),
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


READ = ("text", "parquet", "workbook", "matlab")
"""Kinds that are read."""
TEXT, PARQUET = (".csv", ".tsv", ".txt", ".gz", ".zip"), (".parquet", ".pq")
"""Endings of files of text, packed or not, and of Parquet."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of `rows` and `columns` of a table; of bytes of a `line`, of a `file`, and of content held `unpacked`.

    30 million rows are one second over a year and take about 4 GB. 10,000 columns of 100 characters are a line of
    1 MiB. UTF-8 text is read in pieces up to the file limit. Content that must be held whole (gzip, zip, standard
    input, other encodings, the wanted columns of Parquet) stays below `unpacked`.
    """

    rows: int = 30_000_000
    columns: int = 10_000
    line: int = 1 << 20
    file: int = 64 << 30
    unpacked: int = 2 << 30

    def check(self, what: str, value: int, name: str, advice: str = "") -> None:
        """DataError where `value` is above the limit `what`, with the option that raises it."""
        limit = getattr(self, what)
        if value > limit:
            hint = f"raise it with --limit {what}={_suggest(what, value)}" + (f", or {advice}" if advice else "")
            raise DataError(f"{name} has {_words(what, value)}, more than the limit of {_words(what, limit)}", hint)


_LIMIT_NAMES = tuple(f.name for f in fields(Limits))
_SIZES = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 1 << 10, "mi": 1 << 20, "gi": 1 << 30,
          "ti": 1 << 40}
_SIZE = re.compile(r"(\d+(?:\.\d+)?(?:e\d{1,2})?)\s*([kmgt]i?)?b?", re.IGNORECASE | re.ASCII)


def limits_from(said: tuple[str, ...]) -> Limits:
    """Limits from the values of --limit, for example ("rows=1e8", "file=100GB"). UsageError for anything else."""
    changes = {}
    for pair in said:
        what, _, size = pair.partition("=")
        match = _SIZE.fullmatch(size.strip())
        if what.strip() not in _LIMIT_NAMES or match is None:
            raise UsageError(f"--limit {pair!r} is not WHAT=SIZE",
                             f"WHAT is one of {', '.join(_LIMIT_NAMES)}; for example --limit rows=1e8 or "
                             "--limit file=100GB")
        value = float(match.group(1)) * _SIZES[(match.group(2) or "").lower()]
        if not 1 <= value < 1e18:
            raise UsageError(f"--limit {pair!r} is out of range", "give 1 to 1e18")
        changes[what.strip()] = round(value)
    return Limits(**changes)


def _words(what: str, value: int) -> str:
    if what in ("rows", "columns"):
        return f"{value:,} {what}"
    size = next((f"{value / 10**p:.3g} {u}" for p, u in ((9, "GB"), (6, "MB")) if value >= 10**p), f"{value:,} bytes")
    return {"line": f"a line of {size}", "file": size, "unpacked": f"{size} unpacked"}[what]


def _suggest(what: str, value: int) -> str:
    if what in ("rows", "columns"):
        return f"{value}"
    return f"{-(-value // 10**9)}GB" if value >= 10**9 else f"{-(-value // 10**6)}MB"


class NoRecord(DataError):
    """Content of a kind that holds no record: a picture, a PDF, an archive."""


@dataclass(frozen=True, slots=True)
class Source:
    """One file's content: `kind` is one of `READ`; Parquet keeps only its path or bytes."""

    name: str
    kind: str
    data: bytes
    sha256: str
    path: Path | None = None


def open_source(file: Any, limits: Limits | None = None) -> Source:
    """The content of a path, of '-' (standard input) or of an object with read().

    A large text file is not loaded (`data` empty, `kind` "text"): `pieces` reads it. UsageError where the file
    is absent or not readable; DataError where the content is of no kind that is read, or above a limit.
    """
    limits = limits or Limits()
    if hasattr(file, "read"):
        content = file.read()
        data = content.encode() if isinstance(content, str) else bytes(content)
        return _from_bytes(data, str(getattr(file, "name", "data")), limits)
    if str(file) == "-":
        name = "standard input"
        start = sys.stdin.buffer.read(limits.line + 1)
        if _kind(start) == "text":
            _check_lines(start, name, limits)  # before all of it is taken: it may have no end
        return _from_bytes(start + _read_limited(sys.stdin.buffer, name, limits, len(start)), name, limits)
    path = Path(file)
    try:
        if not path.exists():
            raise UsageError(f"{path} does not exist", "check the spelling; ls shows what is there")
        if path.is_char_device() or path.is_block_device():
            raise UsageError(f"{path} is a device, which may have no end", "give a file, or - for standard input")
        with open(path, "rb") as stream:
            # Enough to find a line without an end, even below some header lines.
            start = stream.read(_BLOCK + min(limits.line, _BLOCK) + 1)
            size = os.fstat(stream.fileno()).st_size
            limits.check("file", size, path.name, "cut it into pieces")
            kind = _kind(start)
            if kind == "parquet":
                stream.seek(0)
                return Source(path.name, "parquet", b"", hashlib.file_digest(stream, "sha256").hexdigest(), path)
            if kind == "text":
                _check_lines(start, path.name, limits)
                if size >= MIN_STREAMED_BYTES:
                    return Source(path.name, "text", b"", "", path)
            if stream.seekable():
                stream.seek(0)
                start = b""
            data = start + _read_limited(stream, path.name, limits, len(start))
    except OSError as error:
        raise UsageError(f"{path} can't be read: {error.strerror or error}", "check its permissions") from None
    return _from_bytes(data, path.name, limits, path)


def _read_limited(stream: BinaryIO, name: str, limits: Limits, before: int = 0) -> bytes:
    data = stream.read(limits.unpacked + 1 - before) if before <= limits.unpacked else b""
    limits.check("unpacked", before + len(data), name, "save it as a file of UTF-8 text, which is read in pieces")
    return data


def in_short(error: Exception) -> str:
    """Message of a library's error, on one line."""
    return " ".join(str(error).split())[:160] or type(error).__name__


def _kind(start: bytes) -> str:
    if _is_matlab_4(start):
        return "matlab"
    return next((kind for magic, kind in _KINDS if start.startswith(magic)), "text")


def _is_matlab_4(start: bytes) -> bool:
    """True for the header of a MATLAB file of version 4: a type of at most 4 digits, sizes, and a name."""
    for order in ("<", ">"):
        if len(start) < 21:
            return False
        kind, rows, columns, imaginary, length = struct.unpack(f"{order}5i", start[:20])
        if (0 <= kind <= 4052 and kind // 100 % 10 == 0 and kind // 10 % 10 <= 5 and kind % 10 <= 2 and rows > 0
                and columns > 0 and imaginary in (0, 1) and 1 < length <= 64 and start[20:21].isalpha()
                and start[19 + length:20 + length] == b"\0"):
            return True
    return False


def _is_workbook(data: bytes) -> bool:
    """True for a zip archive that is an .xlsx or .ods workbook."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return not {"[Content_Types].xml", "mimetype"}.isdisjoint(archive.namelist())
    except (zipfile.BadZipFile, OSError, ValueError, LookupError, NotImplementedError):
        return False


def _from_bytes(data: bytes, name: str, limits: Limits, path: Path | None = None) -> Source:
    digest = hashlib.sha256(data).hexdigest()
    kind = _kind(data)
    if kind == "gzip":
        data = _gunzip(data, name, limits)
    elif kind == "zip" and not _is_workbook(data):
        data = _unzip(data, name, limits)
    kind = _kind(data)
    if kind == "zip" and _is_workbook(data):
        kind = "workbook"
    if not data[:_BLOCK].strip(_BLANK) and not data.strip(_BLANK):
        raise DataError(f"{name} is empty", "export it again, with a header line and one row per time")
    if kind not in READ:
        raise NoRecord(f"{name} is {kind}, not text, Parquet, a workbook or a MATLAB file",
                       "save or export it as CSV (Excel: Save as, CSV UTF-8)")
    if kind == "text":
        _check_lines(data, name, limits)
    return Source(name, kind, data, digest, path)


def _check_lines(data: bytes, name: str, limits: Limits, before: int = 0) -> None:
    """Refuse a line longer than the limit; it jumps from line end to line end, one search per megabyte.

    `before` is the number of bytes of the file before `data`.
    """
    position = 0
    while len(data) - position > limits.line:
        end = data.rfind(b"\n", position, position + limits.line)
        if end < 0:
            end = data.rfind(b"\r", position, position + limits.line)
        if end < position:
            raise DataError(
                f"{name} has a line longer than {limits.line:,} bytes (from byte {before + position:,} on): "
                "no table of a loop looks like that",
                f"check that it is the export you meant; --limit line={2 * limits.line} reads it",
            )
        position = end + 1


def _gunzip(data: bytes, name: str, limits: Limits) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            return _unpack(stream, len(data), name, limits)
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(f"{name} is damaged gzip: {in_short(error)}", "copy or export it again") from None


def _unzip(data: bytes, name: str, limits: Limits) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [m for m in archive.infolist() if not m.is_dir() and not m.filename.startswith("__MACOSX/")]
            if len(members) != 1:
                raise DataError(
                    f"{name} is a zip of {len(members)} files; one is needed", "unpack it and give the file you mean"
                )
            with archive.open(members[0]) as stream:
                return _unpack(stream, len(data), name, limits)
    except (zipfile.BadZipFile, OSError, EOFError, zlib.error, NotImplementedError, RuntimeError, ValueError,
            LookupError) as error:
        raise DataError(f"{name} can't be unpacked: {in_short(error)}", "unpack it by hand and give the file") from None


def _unpack(stream: Any, packed: int, name: str, limits: Limits) -> bytes:
    """Everything in `stream`, stopped before it fills the memory; a limit given by the user lifts the ratio as well."""
    most = limits.unpacked
    if most == Limits().unpacked:
        most = min(most, max(MIN_UNPACKED_BYTES, packed * MAX_UNPACKED_RATIO))
    parts: list[bytes] = []
    size = 0
    while block := stream.read(_BLOCK):
        size += len(block)
        if size > most:
            raise DataError(
                f"{name} unpacks to more than {most:,} bytes from {packed:,}",
                "if you trust it, unpack it by hand or give --limit unpacked=SIZE",
            )
        parts.append(block)
    return b"".join(parts)


def pieces(source: Source, limits: Limits) -> Iterator[tuple[bytes, str]]:
    """A large text file in pieces of whole lines, each with the SHA-256 of all bytes so far.

    DataError where a line is too long or the file changes while it is read.
    """
    assert source.path is not None
    digest, left, before = hashlib.sha256(), b"", 0
    try:
        with open(source.path, "rb") as stream:
            at_start = os.fstat(stream.fileno())
            # Never beyond the size at the start: a file that grows as fast as it is read would have no end.
            while before + len(left) <= at_start.st_size and (block := stream.read(PIECE_BYTES)):
                digest.update(block)
                block = left + block
                _check_lines(block, source.name, limits, before)
                end = block.rfind(b"\n") + 1
                left = block[end:]
                before += end
                if end:
                    yield block[:end], digest.hexdigest()
            if left:
                yield left, digest.hexdigest()
            at_end = os.fstat(stream.fileno())
    except OSError as error:
        raise UsageError(f"{source.path} can't be read: {error.strerror or error}", "check its permissions") from None
    if (at_start.st_size, at_start.st_mtime_ns) != (at_end.st_size, at_end.st_mtime_ns):
        raise DataError(f"{source.name} changed while it was read", "read it again when its writer is done")
