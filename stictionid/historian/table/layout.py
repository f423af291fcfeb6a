"""Layout of a text export: separator, header lines (names, units, descriptions), first data line, decimal mark.

It is decided on the first lines, by the form of the cells and not by their position.
"""

from __future__ import annotations

import csv
import functools
import re
from collections import Counter
from dataclasses import dataclass

from ...errors import DataError
from ..words.cells import decimal_evidence, shown
from ..words.roles import role_of, unit_in
from ..words.states import is_state
from ..words.units import TIED

SAMPLE_BYTES = 1 << 16
SAMPLE_LINES = 300
MIN_TYPED_BLANKS = 0.8
"""Share of number, time or state cells for which blanks are believed to separate."""
MIN_SURE_SCORE = 0.9
"""Score of another separator (steady lines, typed cells; at most 1.14) that leaves blanks no chance."""
MIN_TYPED_CELLS = 0.5
"""Share of number, time, state or empty cells that makes a line a data line; headers are text."""

_SEPARATORS = ("\t", ";", "|", ",", " ")
_NUMBER = re.compile(
    r"[+\-−]?[\d.,'’\u00a0\u202f ]*\d[\d.,'’\u00a0\u202f]*(?:[eE][+\-−]?\d+)?\s*(?:%|[°a-zA-Z][\w°/³²%]{0,6})?\Z"
)
_TIME = re.compile(
    r"(?=.*\d)(?!.*[;|\t\"])(?!.*,(?! |\d{1,9}\Z))"
    r"(?:.*\d[-/.]\d+[-/.]\d.*|.*\d:\d\d.*|\d{1,4}[-/. ]\w{3,10}\.?[-/. ]\d{2,4}.*|\d{8}T\d{4,6}.*)\Z"
)
# Excel writes a text as ="…" where a cell must not become a number.
_EXCEL_TEXT = re.compile(r'="([^"]*)"\Z')
_UNIT = re.compile(
    rf"\s*[\[(<]?\s*(?:{TIED}|K|V|A|[kM]?W|[km]?m|cm|in|ft|s|sec|seconds|ms|min|h|d|"
    r"date(?:\s?time)?|time|datetime|-|eu|text|bool|UTC|local)\s*[\])>]?\s*\Z",
    re.IGNORECASE,
)


class NoTable(DataError):
    """Text without rows of cells: a letter or a note, not a damaged export."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Layout of a text file; `offset` is the byte where data begin and `first_line` its 1-based line number."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    descriptions: tuple[str, ...] = ()
    separator: str = ""
    decimal: str = "."
    offset: int = 0
    first_line: int = 1
    header_lines: int = 0
    header_cells: tuple[tuple[str, ...], ...] = ()
    assumptions: tuple[str, ...] = ()


def find_layout(
    data: bytes, name: str, *, separator: str | None = None, header: int | None = None, decimal: str | None = None
) -> Layout:
    """The layout of a text table; `separator`, `header` (number of lines before the data) and `decimal` override.

    DataError for a file of one column, without data lines, or whose commas can't be told apart.
    """
    lines = _first_lines(data)
    separator = separator or _separator(lines, name)
    cells = [split_line(line, separator) for line in lines]
    width = _width(cells)
    if header is None:
        first = _below_names(cells, _data_start(cells, width, name), width, name)
        start = _damaged_first(cells, first, width)
    else:
        start = header
    if start >= len(cells):
        raise DataError(
            f"{name} has only {len(cells)} lines, none after the {start} header lines",
            "give the right number with --header",
        )
    names, units, descriptions, used = _header(cells[:start], width)
    _refuse_comma_in_comma(cells[:start], width, separator, name)
    mark, assumptions = _decimal(cells, start, names, separator, name) if decimal is None else (decimal, ())
    if not used:
        names = tuple(str(i + 1) for i in range(width))
    return Layout(names=names, units=units, descriptions=descriptions, separator=separator, decimal=mark,
                  offset=offset_of(data, start), first_line=start + 1, header_lines=start,
                  header_cells=tuple(map(tuple, used)), assumptions=assumptions)


def split_line(line: str, separator: str) -> list[str]:
    """The cells of one line, without surrounding blanks."""
    if separator == " ":
        return line.split()
    try:
        row = next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        row = line.split(separator)
    return [_EXCEL_TEXT.sub(r"\1", cell) if cell.startswith('="') else cell for cell in map(str.strip, row)]


def _first_lines(data: bytes) -> list[str]:
    head = data[:SAMPLE_BYTES]
    if len(data) > SAMPLE_BYTES and b"\n" in head:
        head = head[: head.rfind(b"\n")]
    return [line.rstrip("\r") for line in head.decode("utf-8", "replace").split("\n")][:SAMPLE_LINES]


def _separator(lines: list[str], name: str) -> str:
    """The separator under which most lines have the same number of well-typed cells."""
    tail = [line for line in lines if line.strip()]
    if not tail:
        raise NoTable(f"{name} has no table in it", "check that it is the export you meant")
    tail = tail[len(tail) // 3 :]
    scores: list[tuple[float, str]] = []
    for candidate in _SEPARATORS:
        rows = [split_line(line, candidate) for line in tail]
        width, votes = Counter(map(len, rows)).most_common(1)[0]
        if width < 2 or votes < 0.5 * len(rows):
            continue
        cells = [cell for row in rows if len(row) == width for cell in row]
        typed = sum(map(_typed, cells)) / len(cells)
        # Blanks also occur inside stamps and names: they separate only where all cells then have a type.
        if candidate != " " or (typed > MIN_TYPED_BLANKS and not any(score > MIN_SURE_SCORE for score, _ in scores)):
            scores.append((round(min(votes / len(rows), 0.95) * (0.2 + typed), 2), candidate))
    if not scores:
        raise NoTable(
            f"{name} has one column: line {len(lines)} is {shown(tail[-1])}",
            "export time and tags side by side, or name the separator with --separator",
        )
    return max(scores, key=lambda scored: scored[0])[1]


def _typed(cell: str) -> bool:
    return not cell or _value(cell)


@functools.lru_cache(maxsize=20_000)
def _value(cell: str) -> bool:
    """True where a cell holds a number, a time or a system state."""
    return bool(cell) and (bool(_NUMBER.match(cell)) or bool(_TIME.match(cell)) or is_state(cell))


def _width(cells: list[list[str]]) -> int:
    rows = [len(row) for row in cells[len(cells) // 3 :] if row and any(row)]
    return Counter(rows).most_common(1)[0][0] if rows else max(map(len, cells))


def _data_start(cells: list[list[str]], width: int, name: str) -> int:
    """Index of the first data line: the first of the file's width that holds values and is followed by more."""
    good = [_is_data(row, width) for row in cells]
    for i, fine in enumerate(good):
        following = [g for g, row in zip(good[i : i + 8], cells[i : i + 8], strict=True) if any(row)]
        if fine and sum(following) >= 0.6 * len(following):
            return i
    raise NoTable(
        f"{name} has no rows of numbers (line 1 is {shown(' '.join(cells[0]))})",
        "check that it is a table of time and values; --header and --separator say how it is built",
    )


def _below_names(cells: list[list[str]], start: int, width: int, name: str) -> int:
    """First data line below the names, where lines of settings ("Start", a time) above them look like data."""
    def names(row: list[str]) -> bool:
        return len(row) == width and _filled(row) >= 0.6 * width and _named(row) >= 2 and not any(map(_value, row))

    if any(names(row) for row in cells[:start]):
        return start
    at = next((i for i, row in enumerate(cells[start:], start) if names(row)), None)
    if at is None or not any(_is_data(row, width) for row in cells[at + 1:]):
        return start
    return at + 1 + _data_start(cells[at + 1:], width, name)


def _damaged_first(cells: list[list[str]], start: int, width: int) -> int:
    """First data line where the first rows are damaged: right below the names, unless more header lines follow."""
    for i in range(start):
        if len(cells[i]) == width and _filled(cells[i]) >= 0.6 * width and _named(cells[i]) >= 2:
            below = [j for j in range(i + 1, start) if any(cells[j]) and (cells[j] == cells[i] or _numeric(cells[j]))]
            return min(below, default=start)
    return start


def _numeric(row: list[str]) -> bool:
    """True for a line of any width that looks like numbers: most cells typed, or most characters digits."""
    text = "".join(row)
    digits = sum(c.isdigit() for c in text)
    return sum(map(_typed, row)) > MIN_TYPED_CELLS * len(row) or (
        text[0] in "+-0123456789" and digits > 0.5 * len(text)
    )


def _is_data(row: list[str], width: int) -> bool:
    if len(row) != width or not any(row):
        return False
    typed = sum(map(_typed, row))
    return typed >= MIN_TYPED_CELLS * len(row) and any(map(_value, row)) and len(row) - typed <= len(row) // 2


def _header(
    rows: list[list[str]], width: int
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], list[list[str]]]:
    """Names, units and descriptions among the lines above the data; lines of another width are preamble."""
    blank = ("",) * width
    fit = [[*row, ""][:width] for row in rows
           if len(row) > 1 and abs(len(row) - width) <= 1 and sum(map(bool, row)) >= max(1, min(2, width))]
    texts = [row for row in fit if not all(_UNIT.match(c) for c in row[1:] if c)]
    if not texts:
        return blank, blank, blank, []
    names = next(
        (row for row in texts if re.fullmatch(r"tag\s?names?|tags?|names?", row[0], re.IGNORECASE)),
        max(texts, key=lambda row: (_filled(row) >= 0.6 * width, _named(row))),
    )
    if not any(letter.isalpha() for c in names for letter in c):
        return blank, blank, blank, []
    rest = [row for row in fit if row is not names]
    units = next((row for row in rest if _units_row(row)), list(blank))
    described = next((row for row in rest if row is not units), list(blank))
    inside = [unit_in(c) for c in names]
    bare = [unit.strip().strip("[](){}<>").strip() for unit in units]
    return tuple(names), tuple(a or b for a, b in zip(bare, inside, strict=True)), tuple(described), fit


def _filled(row: list[str]) -> int:
    return len({c for c in row if c})


def _named(row: list[str]) -> int:
    """Number of cells of a header line with a known role; it finds the line of tags among lines of descriptions."""
    return sum(role_of(c) is not None for c in row)


def _units_row(row: list[str]) -> bool:
    filled = [c for c in row if c]
    return bool(filled) and sum(bool(_UNIT.match(c)) for c in filled) >= 0.5 * len(filled)


def _refuse_comma_in_comma(header: list[list[str]], width: int, separator: str, name: str) -> None:
    """Refuse decimal commas in a file separated by commas, because they can't be told apart."""
    texts = [row for row in header if any(row) and len(row) > 1]
    if separator == "," and texts and width >= 2 * len(texts[-1]) - 1 and len(texts[-1]) >= 2:
        raise DataError(
            f"{name}: its header has {len(texts[-1])} cells and its rows have {width}: "
            "decimal commas between separating commas can't be told apart",
            "export it with semicolons, tabs or quotes",
        )


def _decimal(
    rows: list[list[str]], start: int, names: tuple[str, ...], separator: str, name: str
) -> tuple[str, tuple[str, ...]]:
    """The decimal mark, by the cells of the sample: a comma not followed by exactly three digits is decimal."""
    cells = [cell for row in rows[start:] for cell in row if "," in cell and not _TIME.match(cell)]
    if not cells:
        return ".", ()

    def place(cell: str) -> str:
        line, row = next((i, row) for i, row in enumerate(rows) if i >= start and cell in row)
        column = row.index(cell)
        tag = names[column] if column < len(names) and names[column] else str(column + 1)
        return f"{name}, line {line + 1}, column {shown(tag)}"

    point, comma, either = decimal_evidence(cells)
    if point and comma:
        raise DataError(
            f"{place(comma)}: {shown(comma)} has a decimal comma where {shown(point)} has a point",
            "say --decimal . or --decimal ,",
        )
    if point or comma or not either:
        return "," if comma else ".", ()
    if separator == ";":
        return ",", (
            f"decimal comma, because cells are separated by semicolons ({shown(either)} could also be thousands; "
            "--decimal . or --decimal ,)",
        )
    raise DataError(
        f"{place(either)}: {shown(either)} may be a thousand or a decimal fraction", "say --decimal . or --decimal ,"
    )


def offset_of(data: bytes, lines: int) -> int:
    """The byte at which the line behind so many lines begins."""
    position = 0
    for _ in range(lines):
        position = data.index(b"\n", position) + 1
    return position
