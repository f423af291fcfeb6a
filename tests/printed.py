"""Comparison of printed text that holds on any processor: words are equal, numbers are within a share of themselves.

Not compared are the layout (a number of one digit more widens a column), counts of work, and what is said of effects
and models that were not named: a refit that explains little ends in one basin or another. Nor are intervals of a model
that misses something: they end where next to nothing tells points apart.
"""

from __future__ import annotations

import os
import re

import pytest

# Share by which a number may differ on another processor, beside one unit of its last printed digit.
SHARE = 0.01
_NUMBER = re.compile(r"-?\d+(?:,\d{3})+(?!\d)|-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_WORK = re.compile(r"[\d,]+ (?=cost evaluations?|models? (?:was|were) tried)")
# Column of a count of work, and column that says how an effect was answered.
_RESTARTS, _ANSWER, _NAMED = "restarts", "answer", "named"
_RULE = re.compile(r"[-+|─┼├┤┬┴ ]*[-─]{3,}[-+|─┼├┤┬┴ ]*")
# A row of a tree of models, and a line on which it goes on.
_BRANCH, _FURTHER = re.compile(r"(?:[|│] {2,3}| {3,4})*(?:\|-|`-|├─|└─) "), re.compile(r"[|│] {2,}| {20,}")
_INADEQUATE = re.compile(r"^(?:adequate: no|not adequate)|is not adequate", re.MULTILINE)
_INTERVAL = re.compile(rf"(?:{_NUMBER.pattern}) to (?:{_NUMBER.pattern})")
_BRACKETED = re.compile(rf"\({_INTERVAL.pattern}\)")

# Every command of a page takes most of a minute. `.ci/run` runs the pages once, as on another processor.
whole_page = pytest.mark.skipif(not os.environ.get("STICTIONID_PAGES"),
                                reason="a whole page is run by .ci/run, or with STICTIONID_PAGES=1")


def same_text(shown: str, today: str) -> None:
    """Assert that a text says today what is shown, as far as any processor says it."""
    before, now = said(shown), said(today)
    for i in range(max(len(before), len(now))):
        place = f"shown: {' '.join(before[max(i - 9, 0):i + 9])!r}, today: {' '.join(now[max(i - 9, 0):i + 9])!r}"
        assert i < min(len(before), len(now)) and _NUMBER.sub("#", before[i]) == _NUMBER.sub("#", now[i]), place
        for x, y in zip(_NUMBER.findall(before[i]), _NUMBER.findall(now[i]), strict=True):
            unit = max(_last_digit(x), _last_digit(y)) if "." in x + y else 0.0
            assert _value(x) == pytest.approx(_value(y), rel=SHARE, abs=1.01 * unit), f"{x} is {y}; {place}"


def said(text: str) -> list[str]:
    """The words and numbers of a text, without its layout and without what depends on the processor."""
    adequate = not _INADEQUATE.search(text)
    out: list[str] = []
    table: list[list[str]] = []
    named = True
    for line in [*map(str.rstrip, text.splitlines()), ""]:
        rule = _RULE.fullmatch(line)
        if line.startswith("|") and line.endswith("|"):
            table += [] if rule else [[cell.strip() for cell in line[1:-1].split("|")]]
            continue
        if table:
            out += _rows(table, adequate)
            table = []
        if rule:
            continue
        branch = _BRANCH.match(line)
        if branch or not _FURTHER.match(line):
            named = branch is None or _NAMED in line
        out += [line[branch.end() if branch else 0:]] if named else []
    prose = "\n".join(out)
    return _WORK.sub("some ", prose if adequate else _BRACKETED.sub("(an interval)", prose)).split()


def _rows(table: list[list[str]], adequate: bool) -> list[str]:
    """Cells of a table, each wrapped cell whole again; the effects that are not named in the order of the alphabet."""
    head, *rows = _unwrapped(table)
    out, others = list(head), []
    for row in rows:
        cells = dict(zip(head, row, strict=False))
        if _ANSWER in cells and not cells[_ANSWER].startswith(_NAMED):
            others.append(row[0])
            continue
        if _RESTARTS in cells:
            cells[_RESTARTS] = "some"
        out += [cell if adequate else _INTERVAL.sub("an interval", cell) for cell in cells.values()]
    return [*out, *sorted(others)]


def _unwrapped(table: list[list[str]]) -> list[list[str]]:
    """Rows of a table of which those with an empty cell go on with the row above."""
    rows: list[list[str]] = []
    for row in table:
        if rows and "" in row:
            rows[-1] = [f"{above} {cell}".strip() for above, cell in zip(rows[-1], row, strict=True)]
        else:
            rows.append(row)
    return rows


def _value(number: str) -> float:
    return float(number.replace(",", ""))


def _last_digit(number: str) -> float:
    """Size of one unit of the last printed digit: 0.01 of 2.55, 10 of 1.55e3."""
    digits, _, power = number.replace(",", "").partition("e")
    return 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
