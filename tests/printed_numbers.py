"""Errors, noises and gains that an output of a study prints, and those of them that are not the study's own.

An output is terminal text, markdown, HTML or the facts of a JSON report. A number counts where a sentence or a column
calls it an error, a noise or a gain. It is left out where the words around it hold a qualifier of the glossary.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from stictionid.record.study import Study

_GLOSSARY = Path(__file__).parents[1] / "docs" / "glossary.md"
_NUMBER = r"-?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?"
# A number that measures something else: a share, a multiple, a time, a count of samples, a window or a gain.
_OTHER = r"(?!\s*(?:%|times\b|x\b|s\b|min\b|BIC\b|of\b|added\b|samples\b|blocks\b|[a-z_]*\s*name))"
_ERROR = re.compile(rf"(?<![\w.,-])({_NUMBER})(?![\w,.]*\d){_OTHER}")
_TIMES = re.compile(rf"({_NUMBER}) times the (?:irreducible |measurement )?noise")
_NOISE = re.compile(rf"\bnoise (?:of )?({_NUMBER})")
_GAIN = re.compile(rf"({_NUMBER}) BIC\b")

Claim = tuple[str, str]


def qualifiers() -> tuple[str, ...]:
    """The qualifiers of the glossary's last table."""
    lines = _GLOSSARY.read_text(encoding="utf-8").partition("| qualifier |")[2].splitlines()[2:]
    words = [word.strip() for line in lines if line.startswith("|") for word in line.split("|")[1].split(",")]
    assert len(words) > 10
    return tuple(words)


def wrong_numbers(study: Study, text: str) -> list[str]:
    """The claims of an output that are no number of the study, each with its words; empty where all agree."""
    known = qualifiers()
    prose, tables = _read(text)
    found = [claim for words in prose if not any(q in words.casefold() for q in known) for claim in _said(study, words)]
    for caption, heads, rows in tables:
        if not any(q in caption.casefold() for q in known):
            found += _tabled(study, heads, rows, known)
    return found


def numbers_in(study: Study, text: str) -> int:
    """Number of errors, noises and gains that an output prints and that are the study's own."""
    prose, tables = _read(text)
    blank = _without_numbers(study)
    return sum(len(_said(blank, words)) for words in prose) + sum(len(_tabled(blank, heads, rows, ()))
                                                                  for _, heads, rows in tables)


def _without_numbers(study: Study) -> Study:
    """A study of which no printed number is true."""
    steps = tuple(replace(s, error=replace(s.error, rmse=1e9, noise_sd=1e-9)) for s in study.steps)
    return replace(study, steps=steps, candidates=tuple(
        replace(c, rmse=1e9, delta_bic=1e9, gain_beyond_noise=1e9) for c in study.candidates))


def _near(text: str, values: Iterable[float | None]) -> bool:
    """True where a printed number is one of the values, rounded to its digits."""
    shown = float(text.replace(",", ""))
    digits = len(text.partition("e")[0].partition(".")[2])
    unit = 10.0 ** -digits * (10.0 ** int(text.partition("e")[2] or 0))
    return any(v is not None and abs(v - shown) <= 0.501 * unit for v in values)


def _said(study: Study, words: str) -> list[str]:
    """The claims of one sentence that are no number of the study."""
    errors = [s.error.rmse for s in study.steps]
    noise = study.steps[-1].error.noise_sd
    assert noise is not None
    wrong = []
    for number in _TIMES.findall(words):
        wrong += [] if _near(number, (e / noise for e in errors)) else [f"{number} times the noise: {words}"]
    for number in _NOISE.findall(words):
        wrong += [] if _near(number, (noise,)) else [f"noise {number}: {words}"]
    for number in _GAIN.findall(words):
        wrong += [] if _near(number, (c.gain_beyond_noise for c in study.candidates)) else [f"gain {number}: {words}"]
    if re.search(r"\berrors?\b|\berrs\b", words):
        left = _TIMES.sub("", _NOISE.sub("noise", words))
        after = re.split(r"\berrors?\b|\berrs\b", left, maxsplit=1)[1]
        for number in _ERROR.findall(after):
            wrong += [] if "." not in number or _near(number, errors) else [f"error {number}: {words}"]
    return wrong


def _tabled(study: Study, heads: list[str], rows: list[list[str]], known: tuple[str, ...]) -> list[str]:
    """The cells of a table that are no number of the study; the first column says whose they are."""
    noise = study.steps[-1].error.noise_sd
    assert noise is not None
    wrong = []
    for row in rows:
        whose = row[0].split("@")[0].strip()
        of = [c for c in study.candidates if c.effect == whose]
        steps = [s for s in study.steps if whose == f"+ {s.added}" or (s.added is None and whose.startswith("base"))]
        if not of and not steps:
            continue
        errors = [c.rmse for c in of] or [s.error.rmse for s in steps]
        gains = [c.gain_beyond_noise for c in of]
        for head, cell in zip(heads, row, strict=False):
            if not re.fullmatch(_NUMBER, cell) or any(q in head for q in known):
                continue
            right = (_near(cell, errors) if head.startswith("error") else
                     _near(cell, (e / noise for e in errors if e is not None)) if head == "x noise" else
                     _near(cell, (noise,)) if head == "noise" else
                     _near(cell, gains) if head.startswith("gain") else True)
            wrong += [] if right else [f"{whose}, {head}: {cell}"]
    return wrong


def _read(text: str) -> tuple[list[str], list[tuple[str, list[str], list[list[str]]]]]:
    """The sentences of an output, and its tables as caption, heads and rows."""
    if text.startswith("{"):
        return _facts(json.loads(text)["studies"][0]["facts"])
    if "<html" in text:
        return _page(text)
    return _lines(text.replace("\\", ""))


def _sentences(text: str) -> list[str]:
    return [s for s in re.split(r"(?<=[.;:])\s+|\n\n+", re.sub(r"[ \t]+", " ", text)) if s.strip()]


def _facts(facts: dict) -> tuple[list[str], list]:
    prose, tables = [facts["headline"], *facts["then"], facts["reason"]], []
    for section in facts["sections"]:
        prose += [*section["text"], *section["bullets"]]
        tables += [(t["caption"], list(t["columns"]), [list(r) for r in t["rows"]]) for t in section["tables"]]
    return [s for p in prose for s in _sentences(p)], tables


def _page(text: str) -> tuple[list[str], list]:
    tables = []
    for body in re.findall(r"<table.*?</table>", text, re.S):
        cells = [[_plain(c) for c in re.findall(r"<t[hd].*?>(.*?)</t[hd]>", row, re.S)]
                 for row in re.findall(r"<tr.*?</tr>", body, re.S)]
        caption = _plain(" ".join(re.findall(r"<caption.*?>(.*?)</caption>", body, re.S)))
        tables.append((caption, cells[0], cells[1:]))
    left = re.sub(r"<(table|script|style|svg|pre)\b.*?</\1>", "\n\n", text, flags=re.S)
    left = re.sub(r"</?(p|li|h\d|figcaption|div|section|summary|dt|dd|td)\b[^>]*>", "\n\n", left)
    return _sentences(_plain(left)), tables


def _plain(text: str) -> str:
    return html.unescape(re.sub(r"<[^>]+>", "", text)).strip(" ")


def _lines(text: str) -> tuple[list[str], list]:
    """Markdown, or terminal text that is too wide to wrap: rows of cells between bars are tables."""
    prose: list[str] = []
    tables: list[tuple[str, list[str], list[list[str]]]] = []
    caption, inside, tree = "", False, False
    for line in text.splitlines():
        tree = (tree and re.match(r"base:|[|`├└│ ]", line) is not None and bool(line.strip())) \
            or (line.startswith("model ") and "beside its noise model" in line)
        if tree:
            continue
        if re.match(r"\s*[|│┃├┡╞]", line) and not re.search(r"[^-|│┃├┡╞┤┩╡:=+─━═┼╇╪ ]", line):
            continue  # between the heads and the rows
        cells = [c.strip() for c in re.split(r"[|│┃]", line.strip().strip("|│┃"))]
        if not re.match(r"\s*[|│┃]", line) or len(cells) < 2:
            if not re.match(r"\s*([+┌└├╭╰┏┡┗-]{2}|\|[-+]+\|$)", line.rstrip()):
                caption, inside = (line if line.strip() else caption), False
                prose.append(line)
            continue
        rows = tables[-1][2] if inside else []
        if not inside:
            tables.append((caption, cells, []))
            inside = True
        elif rows and cells[0] and not any(cells[1:]):
            rows[-1][0] += cells[0]  # a name that goes on in the next line
        else:
            rows.append(cells)
    return _sentences("\n".join(_joined(prose))), tables


def _joined(lines: list[str]) -> Iterator[str]:
    """Lines of prose, each list item and paragraph apart."""
    for line in lines:
        yield f"\n{line}\n" if line.startswith(("-", "*", "#", "!", "`")) else line
