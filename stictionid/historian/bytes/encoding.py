"""Decoding of an export's bytes to UTF-8: byte-order marks, UTF-16 without one, NUL padding, legacy code pages."""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass

from ...errors import DataError, UsageError

_SAMPLE = 1 << 18
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
MAX_CONTROL_SHARE = 0.01
"""Share of control characters above which bytes are no text; exports have none, random bytes have 10 %."""
MIN_KANA_SHARE = 0.2
"""Share of full-width kana for which bytes are believed Japanese; half-width ones cover every byte."""
MIN_COMMON_SHARE = 0.6
"""Share of frequently used characters for which a Chinese or Japanese reading of bytes is believed."""


@dataclass(frozen=True, slots=True)
class Text:
    """A file's text as UTF-8 bytes with "\\n" or "\\r\\n" line ends; `guessed` where the file does not state it."""

    data: bytes
    encoding: str
    guessed: bool = False


def to_utf8(data: bytes, name: str, encoding: str | None = None) -> Text:
    """The text of a file; `encoding` overrides the guess. DataError for bytes that are no text."""
    if encoding:
        return Text(_newlines(_decode(data, encoding, name).encode()), encoding)
    for mark, code in (
        (codecs.BOM_UTF32_LE, "utf-32"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
    ):
        if data.startswith(mark):
            return Text(_newlines(_decode(data, code, name).encode()), f"{code} (byte-order mark)")
    data = data.removeprefix(codecs.BOM_UTF8)
    if b"\0" in data:
        data, code = _without_nul(data, name)
        if code:
            return Text(_newlines(data), code, True)
    _refuse_binary(data, name)
    if data.isascii():
        return Text(_newlines(data), "ascii")
    if _decodes(data, "utf-8"):
        return Text(_newlines(data), "utf-8")
    code = _code_page(data)
    return Text(_newlines(_decode(data, code, name).encode()), code, True)


def _decode(data: bytes, encoding: str, name: str) -> str:
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise DataError(
            f"{name}: byte {error.start:,} ({data[error.start : error.start + 1].hex()}) is not {encoding}",
            "name the right one with --encoding, for example cp1252, cp1251, gbk, shift_jis",
        ) from None
    except (LookupError, ValueError):
        raise UsageError(
            f"{encoding!r} is not a character encoding",
            "use for example utf-8, cp1252, cp1251, gbk, shift_jis or utf-16",
        ) from None


def _newlines(data: bytes) -> bytes:
    """Old line ends (a lone carriage return) become new ones; nothing else is touched."""
    if b"\r" in data[:_SAMPLE] and b"\n" not in data:
        return data.replace(b"\r", b"\n")
    return data


def _without_nul(data: bytes, name: str) -> tuple[bytes, str]:
    """Text of UTF-16 without a mark, or without NUL padding; any other NUL is refused as binary."""
    sample = data[:4096]
    for offset, code in ((1, "utf-16-le"), (0, "utf-16-be")):
        zeros = sample[offset::2].count(0)
        if zeros > 0.7 * len(sample[offset::2]) and zeros > 4 * sample[1 - offset :: 2].count(0):
            return _decode(data[: len(data) // 2 * 2], code, name).encode(), f"{code} without a mark"
    stripped = re.sub(rb"\0+(?=[\r\n]|\Z)", b"", data)
    if b"\0" in stripped:
        where = stripped.index(b"\0")
        raise DataError(f"{name} is not text: byte {where:,} is NUL", "check that it is the export you meant")
    return stripped, ""


def _refuse_binary(data: bytes, name: str) -> None:
    sample = data[:_SAMPLE]
    controls = len(_CONTROL.findall(sample))
    if controls > MAX_CONTROL_SHARE * len(sample):
        raise DataError(
            f"{name} is not text: {controls:,} control characters in its first {len(sample):,} bytes",
            "check that it is the export you meant",
        )


def _code_page(data: bytes) -> str:
    """The likeliest legacy encoding, from the shape of the non-ASCII runs in headers and state words."""
    runs = re.findall(rb"[\x80-\xff][\x80-\xff\x40-\x7e]*", data[:_SAMPLE]) or [data[-1:]]
    high = re.findall(rb"[\x80-\xff]+", data[:_SAMPLE])
    if _is_japanese(runs) and _decodes(data, "shift_jis"):
        return "shift_jis"
    if _decodes(data, "gbk") and all(len(r) % 2 == 0 for r in high):
        leads = [b for r in high for b in r[::2]]
        # Level 1 of GB 2312 (lead bytes B0 to D7) holds the frequent characters; Cyrillic letters read as
        # Chinese land mostly outside it.
        if sum(0xB0 <= b <= 0xD7 for b in leads) >= MIN_COMMON_SHARE * len(leads):
            return "gbk"
    if _decodes(data, "cp1251") and _is_cyrillic(data[:_SAMPLE]):
        return "cp1251"
    return "cp1252" if _decodes(data, "cp1252") else "latin-1"


def _is_cyrillic(sample: bytes) -> bool:
    """True where most words with letters beyond ASCII are wholly Cyrillic under cp1251.

    No word of a language mixes Latin and Cyrillic letters: "StellgrцЯe" is cp1252. A single letter tells nothing.
    """
    words = {w for w in re.findall(r"[^\W\d_]{2,}", sample.decode("cp1251", "replace")) if not w.isascii()}
    whole = sum(all("\u0400" <= c <= "\u04ff" for c in word) for word in words)
    return 2 * whole > len(words)


def _is_japanese(runs: list[bytes]) -> bool:
    """True where enough of the letters beyond ASCII are full-width kana under shift_jis."""
    text = b" ".join(runs).decode("shift_jis", "replace")
    letters = [c for c in text if not c.isascii()]
    kana = sum("\u3040" <= c <= "\u30ff" for c in letters)
    return bool(letters) and kana >= MIN_KANA_SHARE * len(letters) and "\ufffd" not in text


def _decodes(data: bytes, code: str) -> bool:
    try:
        data.decode(code)
    except UnicodeDecodeError:
        return False
    return True
