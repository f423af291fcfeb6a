"""Workbook reader (.xlsx, .xlsm, .xlsb, .xls, .ods): a sheet becomes tab-separated text, read as any other text.

python-calamine (the extra `excel`) reads the cells as stored: formulas by their saved values, errors as empty cells.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
from dataclasses import replace
from datetime import date, datetime, time, timedelta
from functools import partial
from typing import Any

from ...errors import DataError
from ..bytes.options import ReadOptions
from ..bytes.source import Limits, Source, in_short
from ..words.assign import key_of
from ..words.cells import decimal_evidence, shown
from ..words.roles import role_of, take_apart
from .columns import names_of
from .parts import Part
from .table import Table, text_table

HEAD_ROWS = 400
"""First rows of a sheet, by which its table and the loops in it are recognised."""
MAX_HEADER_ROWS = 30
"""Rows from the top among which merged cells are taken for headings of groups of columns."""
_ENCRYPTED = "EncryptedPackage".encode("utf-16-le")
# First bytes of the stream of an old Excel workbook, its record of a password, and how many records may precede it.
_BEGIN, _FILEPASS, _FIRST_RECORDS = b"\x09\x08\x10\x00\x00\x06\x05\x00", 0x2F, 8

Row = list[Any]


def parts_of_workbook(source: Source, options: ReadOptions, limits: Limits) -> list[Part]:
    """The sheets that hold a table. DataError for an empty or locked workbook and for formulas without values."""
    book = _opened(source, limits)
    parts: list[Part] = []
    reasons: list[str] = []
    sheets = [n for n in book.sheet_names if options.loop is not None and key_of(n) == key_of(options.loop)]
    for name in sheets or book.sheet_names:
        rows = _rows_of(book, name, source, limits)
        if not rows:
            continue
        part = replace(source, name=f"{source.name}, sheet {name}", kind="text", path=None)
        try:
            head = text_table(replace(part, data=_text(rows[:HEAD_ROWS])), options, limits)
        except DataError as error:
            reasons.append(error.message)
            continue
        parts.append(Part(name, head, names_of(head), partial(_whole, part, rows, options, limits)))
    if not parts:
        _refuse_formulas(source)
        if not reasons:
            raise DataError(f"{source.name} is an empty workbook: none of its {len(book.sheet_names)} sheets has cells",
                            "export it again, with a header line and one row per time")
        raise DataError(f"{source.name} has no sheet with a table; {reasons[0]}",
                        "check that it is the export you meant; --header says where the data begin")
    if any(_hollow(part.head) for part in parts):
        _refuse_formulas(source)
    return parts


def _whole(part: Source, rows: list[Row], options: ReadOptions, limits: Limits) -> Table:
    """The table of all rows of a sheet; its text was made here and has no encoding of its own."""
    return replace(text_table(replace(part, data=_text(rows)), options, limits), encoding="")


def _opened(source: Source, limits: Limits) -> Any:
    """The workbook in a source. DataError where it is locked, damaged, or the reader is not installed."""
    try:
        import python_calamine as calamine
    except ImportError:
        raise DataError(f"{source.name} is a workbook, and python-calamine, which reads workbooks, is not installed",
                        "pip install python-calamine, or save the sheet as CSV UTF-8") from None
    locked = DataError(f"{source.name} is protected by a password",
                       "open it, take the password off (File, Info, Protect Workbook) and save it again")
    if source.data.startswith(b"\xd0\xcf\x11\xe0") and (_ENCRYPTED in source.data or _has_password(source.data)):
        raise locked
    if source.data.startswith(b"PK"):
        try:
            with zipfile.ZipFile(io.BytesIO(source.data)) as archive:
                unpacked = sum(m.file_size for m in archive.infolist())
        except (zipfile.BadZipFile, OSError, ValueError) as error:
            raise _damaged(source, error) from None
        limits.check("unpacked", unpacked, source.name, "save the sheet as CSV UTF-8")
    try:
        return calamine.load_workbook(io.BytesIO(source.data))
    except calamine.PasswordError:
        raise locked from None
    except calamine.CalamineError as error:
        raise _damaged(source, error) from None


def _has_password(data: bytes) -> bool:
    """True where one of the first records of an old Excel workbook is FILEPASS."""
    at = data.find(_BEGIN)
    for _ in range(_FIRST_RECORDS if at >= 0 else 0):
        if at + 4 > len(data):
            break
        kind, size = struct.unpack("<HH", data[at:at + 4])
        if kind == _FILEPASS:
            return True
        at += 4 + size
    return False


def _damaged(source: Source, error: Exception) -> DataError:
    return DataError(f"{source.name} is a damaged workbook, or of a kind that is not known: {in_short(error)}",
                     "open it and save it again, or save the sheet as CSV UTF-8")


def _rows_of(book: Any, name: str, source: Source, limits: Limits) -> list[Row]:
    """The cells of a sheet; empty for a sheet without cells, and for a chart."""
    import python_calamine as calamine

    try:
        sheet = book.get_sheet_by_name(name)
        if sheet.start is None:
            return []
        limits.check("rows", sheet.total_height, f"{source.name}, sheet {name}", "cut it into pieces")
        limits.check("columns", sheet.total_width, f"{source.name}, sheet {name}")
        rows = list(sheet.iter_rows())
        merged = sheet.merged_cell_ranges or []
    except calamine.WorksheetNotFound:
        return []
    except calamine.CalamineError as error:
        raise _damaged(source, error) from None
    first = sheet.start[1]  # the rows are those of the sheet; their cells begin with the first filled column
    return _grouped(rows, [((a, b - first), (c, d - first)) for (a, b), (c, d) in merged])


def _grouped(rows: list[Row], merged: list[tuple[tuple[int, int], tuple[int, int]]]) -> list[Row]:
    """Rows in which the heading of a group of columns (a merged cell) stands before the name of each of its columns.

    A merged title above all columns, the time among them, stays as it is.
    """
    for (top, left), (bottom, right) in merged:
        below = bottom + 1
        if right == left or left < 0 or top > MAX_HEADER_ROWS or below >= len(rows):
            continue
        group, names = str(rows[top][left]).strip(), rows[below][left:right + 1]
        words = [n for n in names if isinstance(n, str) and n.strip()]
        roles = [role_of(n) for n in words]
        if group and len(words) >= 2 and len(words) == len(names) and "time" not in roles and any(roles):
            rows[below][left:right + 1] = [f"{group}.{n}" if not take_apart(n).loop else n for n in words]
    return rows


def _text(rows: list[Row]) -> bytes:
    """Rows as tab-separated text; numbers get the decimal mark of numbers that stand as text."""
    width = max(map(len, rows))
    days = {i for i in range(width) if any(type(row[i]) is datetime for row in rows if i < len(row))}
    texts = [c for row in rows[:HEAD_ROWS] for c in row if type(c) is str and "," in c]
    point, comma, _ = decimal_evidence(texts)
    mark = "," if comma and not point else "."
    return "".join("\t".join(_cell(c, i in days, mark) for i, c in enumerate(row)) + "\n" for row in rows).encode()


def _cell(value: Any, stamped: bool, mark: str) -> str:
    """One cell as text; a date in a column of time stamps (`stamped`) is a stamp at midnight."""
    kind = type(value)
    if kind is float or kind is int:
        return repr(value) if mark == "." else repr(value).replace(".", mark)
    if kind is str:
        text = " ".join(value.split())
        return '"' + text.replace('"', '""') + '"' if '"' in text else text
    if kind is datetime:
        return str(_to_ms(value).isoformat(sep=" "))
    if kind is date:
        return f"{value.isoformat()} 00:00:00" if stamped else str(value.isoformat())
    if kind is time:
        return str(value.isoformat())
    if kind is timedelta:
        whole, rest = divmod(value / timedelta(seconds=1), 60)
        return f"{whole // 60:02.0f}:{whole % 60:02.0f}:{rest:06.3f}"
    return str(value).upper() if kind is bool else str(value)


def _to_ms(moment: datetime) -> datetime:
    """A moment to the millisecond: a day in a float resolves no more."""
    whole = moment.replace(microsecond=0)
    return whole + timedelta(milliseconds=round(moment.microsecond / 1000))


def _hollow(head: Table) -> bool:
    """True where a column with the name of a signal holds nothing at all."""
    signals = ("process_value", "output", "setpoint", "time", "value")
    return any(role_of(name) in signals and column.null_count == len(column)
               for name, column in zip(head.names, head.columns, strict=True))


def _refuse_formulas(source: Source) -> None:
    """DataError where a sheet has formulas without saved values: a program wrote the file and no one calculated it."""
    if not source.data.startswith(b"PK"):
        return
    cell = re.compile(rb"<c\b[^>]*>\s*<f\b[^>]*>([^<]*)</f>\s*(?:<v>\s*</v>|<v\s*/>)?\s*</c>")
    ods = re.compile(rb"<table:table-cell\b(?![^>]*office:(?:value|date-value|string-value))[^>]*?"
                     rb"table:formula=\"([^\"]*)\"[^>]*/>")
    with zipfile.ZipFile(io.BytesIO(source.data)) as archive:
        for name in archive.namelist():
            if name.startswith("xl/worksheets/") or name == "content.xml":
                found = (ods if name == "content.xml" else cell).search(archive.read(name))
                if found is not None:
                    formula = shown(found.group(1).decode("utf-8", "replace"))
                    raise DataError(f"{source.name}, {name.rsplit('/', 1)[-1]}: {formula} is a formula without a saved "
                                    "value", "open it, calculate it (F9) and save it again, or save it as CSV UTF-8")

