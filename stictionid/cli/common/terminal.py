"""Facts as terminal text: verdict, tables at 80 columns and a small trend, braille where the encoding has it.

Colour comes from the console (none when it is not a terminal or NO_COLOR is set). It is never the only carrier.
"""

from __future__ import annotations

import textwrap
from dataclasses import replace
from typing import Any

import numpy as np

from ...record.loop import Loop
from ...reports import facts as facts_of
from ...reports import wording
from ...reports.document import Facts, PageTable
from ...reports.pictures import measures, study_pictures
from ...reports.pictures.curves import Case
from ...typing import FloatArray
from .output import can_write, plain_table

# Sections shown on a terminal; the rest is in the written reports.
_SECTIONS = ("equivalents", "no-pictures", "ladder", "candidates", "laws", "next", "test")
# Columns kept of wide tables on a console narrower than _ROOMY columns.
_NARROW = {"ladder": (0, 1, 2, 3, 4, 6), "candidates": (0, 1, 2, 3, 4)}
_ROOMY = 110
# Most rows of a table; the rest is left to the written reports.
_MOST_ROWS = 8
# Widest trend and its height. Unit: columns and rows of text, without the axis.
_MOST_COLUMNS, _ROWS = 66, 6
_AXIS = 10
# Dots of one braille character: columns, rows, and the bit of each (row, column). Source: Unicode, block U+2800.
_DOTS_X, _DOTS_Y = 2, 4
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
# Replacements for an encoding without these characters.
_PLAIN = {"…": "...", "·": ";", "³": "3", "²": "2", "°": "deg ", "µ": "u", "±": "+/-", "×": "x", "–": "-",
          "├": "|", "└": "`", "│": "|", "─": "-"}
_STYLES = {"stiction": "bold red", "no stiction": "bold green", "undecided": "bold yellow"}


def print_case(case: Case, console: Any) -> None:
    """Print one study to a rich console: verdict, tables, next steps and the trend of its last periods."""
    facts = facts_of.facts(case.study, no_pictures=case.missing)
    encoding = console.encoding or "ascii"
    console.print(_text(facts.title, encoding), style="bold")
    console.print(_text(facts.headline, encoding), style=_STYLES.get(facts.verdict, "bold"))
    for sentence in facts.then:
        console.print(_text(sentence, encoding), style="bold")
    if facts_of.adds(facts):
        console.print(_text(facts.reason, encoding))
    console.print(_table(PageTable("", ("quantity", "value", "note"),
                               tuple((n.label, n.value, n.note) for n in facts.numbers)), console, encoding))
    for line in trend(case, min(console.width - _AXIS - 4, _MOST_COLUMNS), braille=can_write("\u28ff", encoding)):
        console.print(_text(line, encoding), no_wrap=True, overflow="crop", crop=True)
    _sections(facts, console, encoding)


def _sections(facts: Facts, console: Any, encoding: str) -> None:
    for section in facts.sections:
        if section.key not in _SECTIONS and not section.key.startswith("evidence"):
            continue
        console.print(f"\n{_text(section.title, encoding)}", style="bold")
        for sentence in section.text:
            console.print(_text(sentence, encoding))
        for bullet in section.bullets:
            console.print(textwrap.fill(_text(f"- {bullet}", encoding), max(console.width, 20),
                                        subsequent_indent="  "))
        for table in section.tables:
            kept = _NARROW.get(section.key) if console.width < _ROOMY else None
            more = len(table.rows) - _MOST_ROWS
            shown = replace(table, rows=table.rows[:_MOST_ROWS])
            wide = kept is not None and len(table.columns) > max(kept)
            console.print(_table(_part(shown, kept) if kept and wide else shown, console, encoding))
            if more > 0:
                console.print(f"and {more} more; report -o shows all")


def _part(table: PageTable, kept: tuple[int, ...]) -> PageTable:
    """The table with only the columns in `kept`."""
    return PageTable(table.caption, tuple(table.columns[i] for i in kept), tuple(tuple(row[i] for i in kept)
                 for row in table.rows), tuple(k for k, i in enumerate(kept) if i in table.numeric))


def _table(table: PageTable, console: Any, encoding: str) -> Any:
    """A rich table: light lines on a terminal that has them, plain ASCII elsewhere."""
    return plain_table(*(_text(column, encoding) for column in table.columns), title=_text(table.caption, encoding),
                       right=table.numeric, lines=console.is_terminal and can_write("─", encoding),
                       rows=[[_text(cell, encoding) for cell in row] for row in table.rows])


def trend(case: Case, columns: int, *, braille: bool) -> list[str]:
    """PV and OP of the last periods as lines of text; empty without data."""
    loop = case.loop
    if loop is None or loop.samples < 2 or columns < 8:
        return []
    part = study_pictures.window(case.study, loop)
    if part.stop - part.start < 2:
        part = slice(0, loop.samples)
    lines = ["", f"PV and OP from {wording.number(part.start * loop.step_s)} s to "
                 f"{wording.number(part.stop * loop.step_s)} s"]
    for what, values, role in (("PV", loop.process_value, "process_value"), ("OP", loop.output, "output")):
        lines += _plot(what, values[part], wording.clean(loop.unit(role, "%" if role == "output" else ""), 8), columns,
                       braille)
    return [*lines, *_marks(case, loop, part, columns)]


def _plot(what: str, values: FloatArray, unit: str, columns: int, braille: bool) -> list[str]:
    """One signal: highest value, name and lowest value at the left, the curve at the right."""
    good = values[np.isfinite(values)]
    if not good.size:
        return [f"{what:>{_AXIS}} | no finite value"]
    low, high = float(good.min()), float(good.max())
    labels = {0: wording.number(high, 4), _ROWS - 1: wording.number(low, 4), _ROWS // 2 - 1: what, _ROWS // 2: unit}
    across, down = (_DOTS_X, _DOTS_Y) if braille else (1, 1)
    dots = raster(values, columns * across, _ROWS * down, low, high)
    if braille:
        cells = dots.reshape(_ROWS, _DOTS_Y, columns, _DOTS_X).transpose(0, 2, 1, 3)
        codes = 0x2800 + (cells * _BITS).sum(axis=(2, 3))
        rows = ["".join(map(chr, row)) for row in codes.tolist()]
    else:
        rows = ["".join("*" if dot else " " for dot in row).rstrip() for row in dots.tolist()]
    return [f"{labels.get(i, ''):>{_AXIS}} | {row}".rstrip() for i, row in enumerate(rows)]


def raster(values: FloatArray, columns: int, rows: int, low: float, high: float) -> np.ndarray:
    """Dots (rows, columns), True where the curve (n,) passes: lowest to highest value of each column, joined up."""
    at = np.linspace(0, values.size - 1, max(values.size, 2 * columns))
    signal = np.interp(at, np.arange(values.size), values)
    edges = np.linspace(0, signal.size, columns + 1).astype(np.intp)
    dots = np.zeros((rows, columns), dtype=bool)
    scale = (rows - 1) / (high - low) if high > low else 0.0
    for k in range(columns):
        # Each column includes one sample of the next one, so that steep flanks stay joined.
        piece = signal[edges[k]:edges[k + 1] + 1]
        piece = piece[np.isfinite(piece)]
        if piece.size:
            top = rows - 1 - round((float(piece.max()) - low) * scale)
            bottom = rows - 1 - round((float(piece.min()) - low) * scale)
            dots[top:bottom + 1, k] = True
    return dots


def _marks(case: Case, loop: Loop, part: slice, columns: int) -> list[str]:
    """A line of carets under the stretches where the model fails."""
    if not case.curves:
        return []
    line = [" "] * columns
    per_column = (part.stop - part.start) / columns
    for start, end in measures.failing(case.study, loop, case.curves[-1].residual):
        first = (start / loop.step_s - part.start) / per_column
        last = (end / loop.step_s - part.start) / per_column
        for k in range(max(int(first), 0), min(max(int(last), int(first) + 1), columns)):
            line[k] = "^"
    shown = "".join(line).rstrip()
    return [f"{'fails at':>{_AXIS}} | {shown}"] if shown else []


def _text(text: str, encoding: str) -> str:
    """Text that the encoding can write: close ASCII where there is one, escapes elsewhere."""
    if can_write(text, encoding):
        return text
    text = "".join(c if can_write(c, encoding) else _PLAIN.get(c, c) for c in text)
    try:
        return text.encode(encoding, "backslashreplace").decode(encoding)
    except LookupError:
        return text.encode("ascii", "backslashreplace").decode("ascii")
