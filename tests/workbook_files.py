"""Workbooks of the three kinds (.xlsx, .ods, .xls) written by hand, so that tests need no further library."""

from __future__ import annotations

import io
import struct
import zipfile
from datetime import datetime
from xml.sax.saxutils import escape

_ROOT = "http://schemas.openxmlformats.org/"
_DAY_0 = datetime(1899, 12, 30)
_SECTOR = 512
_END, _FREE, _FAT = 0xFFFFFFFE, 0xFFFFFFFF, 0xFFFFFFFD


class Formula(str):
    """The text of a cell's formula that has no saved value."""


def _letters(column: int) -> str:
    return chr(65 + column)


def _serial(moment: datetime) -> float:
    return (moment - _DAY_0).total_seconds() / 86400.0


def _zip(files: dict[str, str]) -> bytes:
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return sink.getvalue()


def xlsx(sheets: dict[str, list[list]], merged: dict[str, list[str]] | None = None) -> bytes:
    """An .xlsx workbook of the sheets' rows; None is an empty cell, `merged` lists ranges such as "A1:D1"."""
    kinds = [f"{_ROOT}officeDocument/2006/relationships", f"{_ROOT}package/2006"]
    books, links, types, files = [], [], [], {}
    for number, (name, rows) in enumerate(sheets.items(), 1):
        books.append(f'<sheet name="{escape(name)}" sheetId="{number}" r:id="r{number}"/>')
        links.append(f'<Relationship Id="r{number}" Type="{kinds[0]}/worksheet" Target="worksheets/s{number}.xml"/>')
        types.append(f'<Override PartName="/xl/worksheets/s{number}.xml" ContentType="application/vnd.openxmlformats-'
                     'officedocument.spreadsheetml.worksheet+xml"/>')
        lines = []
        for r, row in enumerate(rows, 1):
            cells = []
            for c, value in enumerate(row):
                at = f'r="{_letters(c)}{r}"'
                if isinstance(value, Formula):
                    cells.append(f"<c {at}><f>{escape(value)}</f></c>")
                elif isinstance(value, str):
                    cells.append(f'<c {at} t="inlineStr"><is><t>{escape(value)}</t></is></c>')
                elif isinstance(value, datetime):
                    cells.append(f'<c {at} s="1"><v>{_serial(value)!r}</v></c>')
                elif value is not None:
                    cells.append(f"<c {at}><v>{value!r}</v></c>")
            lines.append(f'<row r="{r}">{"".join(cells)}</row>')
        spans = "".join(f'<mergeCell ref="{m}"/>' for m in (merged or {}).get(name, []))
        files[f"xl/worksheets/s{number}.xml"] = (
            f'<worksheet xmlns="{_ROOT}spreadsheetml/2006/main"><sheetData>{"".join(lines)}</sheetData>'
            + (f"<mergeCells>{spans}</mergeCells>" if spans else "") + "</worksheet>")
    links.append(f'<Relationship Id="r0" Type="{kinds[0]}/styles" Target="styles.xml"/>')
    return _zip({
        "[Content_Types].xml": f'<Types xmlns="{kinds[1]}/content-types"><Default Extension="rels" ContentType='
        '"application/vnd.openxmlformats-package.relationships+xml"/><Override PartName="/xl/workbook.xml" '
        'ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/>'
        f'{"".join(types)}</Types>',
        "_rels/.rels": f'<Relationships xmlns="{kinds[1]}/relationships"><Relationship Id="r1" '
        f'Type="{kinds[0]}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{_ROOT}spreadsheetml/2006/main" xmlns:r="{kinds[0]}">'
        f'<sheets>{"".join(books)}</sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{kinds[1]}/relationships">{"".join(links)}'
        "</Relationships>",
        "xl/styles.xml": f'<styleSheet xmlns="{_ROOT}spreadsheetml/2006/main"><cellXfs count="2"><xf numFmtId="0"/>'
        '<xf numFmtId="22"/></cellXfs></styleSheet>',
        **files,
    })


def ods(sheets: dict[str, list[list]]) -> bytes:
    """An .ods workbook of the sheets' rows."""
    tables = []
    for name, rows in sheets.items():
        lines = []
        for row in rows:
            cells = []
            for value in row:
                if isinstance(value, Formula):
                    cells.append(f'<table:table-cell table:formula="of:{escape(value)}"/>')
                elif isinstance(value, str):
                    cells.append('<table:table-cell office:value-type="string"><text:p>'
                                 f"{escape(value)}</text:p></table:table-cell>")
                elif isinstance(value, datetime):
                    cells.append('<table:table-cell office:value-type="date" '
                                 f'office:date-value="{value.isoformat()}"/>')
                elif value is None:
                    cells.append("<table:table-cell/>")
                else:
                    cells.append(f'<table:table-cell office:value-type="float" office:value="{value!r}"/>')
            lines.append(f"<table:table-row>{''.join(cells)}</table:table-row>")
        tables.append(f'<table:table table:name="{escape(name)}">{"".join(lines)}</table:table>')
    space = "urn:oasis:names:tc:opendocument:xmlns:"
    return _zip({
        "mimetype": "application/vnd.oasis.opendocument.spreadsheet",
        "META-INF/manifest.xml": f'<manifest:manifest xmlns:manifest="{space}manifest:1.0"/>',
        "content.xml": f'<office:document-content xmlns:office="{space}office:1.0" xmlns:table="{space}table:1.0" '
        f'xmlns:text="{space}text:1.0"><office:body><office:spreadsheet>{"".join(tables)}</office:spreadsheet>'
        "</office:body></office:document-content>",
    })


def _record(kind: int, body: bytes = b"") -> bytes:
    return struct.pack("<HH", kind, len(body)) + body


def xls(sheets: dict[str, list[list]], *, locked: bool = False) -> bytes:
    """An old Excel workbook (BIFF8) of the sheets' rows; `locked` marks it as encrypted."""
    bodies = []
    for rows in sheets.values():
        body = _record(0x809, struct.pack("<HHHHII", 0x600, 0x10, 0, 0, 0, 0))
        for r, row in enumerate(rows):
            for c, value in enumerate(row):
                if isinstance(value, str):
                    text = value.encode("utf-16-le")
                    body += _record(0x204, struct.pack("<HHHHB", r, c, 0, len(value), 1) + text)
                elif isinstance(value, datetime):
                    body += _record(0x203, struct.pack("<HHHd", r, c, 1, _serial(value)))
                elif value is not None:
                    body += _record(0x203, struct.pack("<HHHd", r, c, 0, float(value)))
        bodies.append(body + _record(0x0A))
    head = _record(0x809, struct.pack("<HHHHII", 0x600, 5, 0, 0, 0, 0))
    if locked:
        head += _record(0x2F, struct.pack("<HHH", 1, 1, 1) + bytes(48))
    head += b"".join(_record(0xE0, struct.pack("<HH", 0, form) + bytes(16)) for form in (0, 22))
    names = [_record(0x85, struct.pack("<IBBBB", 0, 0, 0, len(n), 1) + n.encode("utf-16-le")) for n in sheets]
    at = len(head) + sum(map(len, names)) + len(_record(0x0A))
    for i, (name, body) in enumerate(zip(sheets, bodies, strict=True)):
        names[i] = _record(0x85, struct.pack("<IBBBB", at, 0, 0, len(name), 1) + name.encode("utf-16-le"))
        at += len(body)
    return compound({"Workbook": head + b"".join(names) + _record(0x0A) + b"".join(bodies)})


def compound(streams: dict[str, bytes]) -> bytes:
    """An OLE compound file with the streams, each padded beyond the size of small ones (4,096 bytes)."""
    sectors: list[bytes] = []
    fat: list[int] = []

    def store(data: bytes) -> int:
        first, count = len(sectors), -(-len(data) // _SECTOR)
        for i in range(count):
            sectors.append(data[i * _SECTOR:(i + 1) * _SECTOR].ljust(_SECTOR, b"\0"))
            fat.append(first + i + 1 if i + 1 < count else _END)
        return first

    entries = []
    items = {name: data.ljust(4096, b"\0") for name, data in streams.items()}
    for i, (name, data) in enumerate(items.items()):
        right = i + 2 if i + 1 < len(items) else 0xFFFFFFFF
        entries.append(_entry(name, 2, store(data), len(data), right))
    directory = _entry("Root Entry", 5, _END, 0, 0xFFFFFFFF, child=1) + b"".join(entries)
    start = store(directory.ljust(-(-len(directory) // _SECTOR) * _SECTOR, b"\0"))
    count = 1
    while (len(fat) + count) * 4 > count * _SECTOR:
        count += 1
    places = list(range(len(sectors), len(sectors) + count))
    table = fat + [_FAT] * count
    table += [_FREE] * (count * _SECTOR // 4 - len(table))
    sectors.append(struct.pack(f"<{len(table)}I", *table))
    header = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(16) + struct.pack("<HHHHH", 0x3E, 3, 0xFFFE, 9, 6) + bytes(6)
    header += struct.pack("<IIIIIIIII", 0, count, start, 0, 4096, _END, 0, _END, 0)
    header += struct.pack("<109I", *(places + [_FREE] * (109 - count)))
    return header + b"".join(sectors)


def _entry(name: str, kind: int, start: int, size: int, right: int, child: int = 0xFFFFFFFF) -> bytes:
    text = (name + "\0").encode("utf-16-le")
    return (text.ljust(64, b"\0") + struct.pack("<HBBIII", len(text), kind, 1, 0xFFFFFFFF, right, child) + bytes(36)
            + struct.pack("<IQ", start, size))
