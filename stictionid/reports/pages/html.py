"""Facts and pictures as one self-contained HTML page: no network, light and dark, on paper and on a phone.

All foreign text is escaped in this file and nowhere else. A content security policy names the page's own style and
script by their hashes: text that slipped through could neither run nor load anything.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from html import escape
from importlib.resources import files

from ...comparison import side_by_side as beside
from .. import facts as facts_of
from .. import wording
from ..document import Facts, PageTable, Section
from ..pictures import palette, svg
from ..pictures.curves import Case
from ..pictures.picture import Picture
from ..pictures.study_pictures import comparison
from . import side_by_side as words_beside
from .trend_layer import trend_layer

KIND = "<!doctype html>\n<!-- stictionid report -->"
# Class and sign of each verdict: the sign says it without colour.
_VERDICTS = {"stiction": ("v-sticks", "▲"), "no stiction": ("v-free", "✓"), "undecided": ("v-open", "?")}
# Background of buttons and code, light and dark; both keep 4.5:1 under the ink and the softer ink.
_PANEL = palette.Look("#f4f6f8", "#1d242c")
# Words of a cell longer than the first may break after every so many characters. Unit: characters.
_LONGEST_WORD, _PIECE = 24, 12
# Ids of the comparison's table and filter field, which the page's script uses.
COMPARED, FILTER = "compared", "filter"


def html(cases: Sequence[Case], drawn: Sequence[dict[str, Picture]]) -> str:
    """The whole page for one study, or for several with a comparison first; the same text for the same studies."""
    all_facts = [facts_of.facts(c.study, no_pictures=c.missing) for c in cases]
    if len(cases) == 1:
        title = all_facts[0].title
        body = _study(cases[0], all_facts[0], drawn[0], "s1", 1)
    else:
        title = f"Valve stiction: {len(cases)} loops compared"
        body = f"<h1>{escaped(title)}</h1>" + _comparison(cases, all_facts, drawn) + "".join(
            _study(c, f, d, f"s{i}", 2) for i, (c, f, d) in enumerate(zip(cases, all_facts, drawn, strict=True), 1))
    version = cases[0].study.created_by.version if cases else ""
    return page_html(title, body, version)


def page_html(title: str, body: str, version: str, kind: str = KIND) -> str:
    style, script = _style(), _resource("page.js")
    policy = (f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; img-src data:; "
              "base-uri 'none'; form-action 'none'")
    return (f'{kind}\n<html lang="en"><head><meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n<meta name="referrer" content="no-referrer">\n'
            f'<link rel="icon" href="data:,">\n<title>{escaped(title)}</title>\n<style>{style}</style></head>\n'
            '<body><a class="skip" href="#main">Skip to the result</a>\n'
            f'<svg class="pic" width="0" height="0" aria-hidden="true" focusable="false">{svg.HATCH}</svg>\n'
            f'<main id="main">{body}\n<footer>Made by stictionid {escaped(wording.name(version))}. '
            "This page needs no network.</footer>"
            f"</main>\n<script>{script}</script></body></html>\n")


def _style() -> str:
    light, dark = svg.variables(False), svg.variables(True)
    return (f":root{{{light};--panel:{_PANEL.light}}}\n"
            f"@media (prefers-color-scheme:dark){{:root{{{dark};--panel:{_PANEL.dark}}}}}\n"
            f"@media print{{:root{{{light};--panel:{_PANEL.light};color-scheme:light}}}}\n"
            f"{svg.style('.pic')}\n{_resource('page.css')}")


def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")


def _cell(text: str) -> str:
    """A table cell's text, with break points in words that would widen the table beyond the page."""
    return " ".join(escaped(word) if len(word) <= _LONGEST_WORD else
                    "<wbr>".join(escaped(word[k:k + _PIECE]) for k in range(0, len(word), _PIECE))
                    for word in text.split(" "))


def escaped(text: str) -> str:
    """Text for element content and quoted attributes, without characters that a page cannot hold."""
    return escape("".join(c for c in text if c >= " " and not "\ud800" <= c <= "\udfff" and not "\x7f" <= c <= "\x9f"))


def _study(case: Case, facts: Facts, drawn: dict[str, Picture], prefix: str, level: int) -> str:
    kind, sign = _VERDICTS.get(facts.verdict, _VERDICTS["undecided"])
    # The sign is that of the valve, which follows the cause of the swing where that is known.
    mark = f'<span class="sign" aria-hidden="true">{sign}</span> '
    then = "".join(f'<p class="then">{mark if not i else ""}{escaped(sentence)}</p>'
                   for i, sentence in enumerate(facts.then))
    reason = f"<p>{escaped(facts.reason)}</p>" if facts_of.adds(facts) else ""
    numbers = "".join(f'<div><dt>{escaped(n.label)}</dt><dd class="value">{escaped(n.value)}</dd>'
                      + (f'<dd class="note">{escaped(n.note)}</dd>' if n.note else "") + "</div>"
                      for n in facts.numbers)
    sections = [s for s in facts.sections if s.shows(drawn)]
    links = "".join(f'<li><a href="#{prefix}-{s.key}">{escaped(s.title)}</a></li>' for s in sections)
    return (f'<article id="{prefix}" aria-labelledby="{prefix}-title">'
            f'<h{level} id="{prefix}-title">{escaped(facts.title)}</h{level}>\n'
            f'<div class="verdict {kind}"><p class="said">{"" if then else mark}{escaped(facts.headline)}</p>'
            f'{then}{reason}</div>\n<dl class="numbers">{numbers}</dl>\n'
            f'<nav aria-label="Sections of {escaped(facts.name)}"><ul>{links}</ul></nav>\n'
            + "".join(_section(case, s, drawn, prefix, level + 1) for s in sections) + "</article>\n")


def _section(case: Case, section: Section, drawn: dict[str, Picture], prefix: str, level: int) -> str:
    name = f"{prefix}-{section.key}"
    parts = [f'<section aria-labelledby="{name}"><h{level} id="{name}">{escaped(section.title)}</h{level}>']
    parts += [f"<p>{escaped(sentence)}</p>" for sentence in section.text]
    if section.bullets:
        parts.append("<ul>" + "".join(f"<li>{escaped(b)}</li>" for b in section.bullets) + "</ul>")
    shown = [drawn[key] for key in section.pictures if key in drawn]
    wide = [p for p in shown if p.wide]
    square = [p for p in shown if not p.wide]
    for picture in wide:
        drawing = figure(picture, f"{prefix}-{picture.key}")
        if picture.key == "trend" and case.loop is not None:
            layer = trend_layer(case, case.loop, f"{prefix}-live")
            drawing = f'<div class="trends">{layer}{drawing}</div>'
        parts.append(drawing)
    if square:
        figures = "".join(figure(p, f"{prefix}-{p.key}") for p in square)
        parts.append(f'<div class="pair">{figures}</div>' if len(square) > 1 else figures)
    parts += [table_html(t, f"{name}-t{i}") for i, t in enumerate(section.tables)]
    if section.lines:
        parts.append(f'<h{level + 1} id="{name}-lines">{escaped(section.lines_title)}</h{level + 1}>'
                     f'<pre class="aligned" role="region" tabindex="0" aria-labelledby="{name}-lines">'
                     f"{escape_lines(section.lines)}</pre>")
    if section.commands:
        parts.append(f"<pre><code>{escape_lines(section.commands)}</code></pre>")
    return "\n".join(parts) + "</section>\n"


def escape_lines(commands: Sequence[str]) -> str:
    """Commands one per line, each escaped."""
    return "\n".join(escaped(c) for c in commands)


def figure(picture: Picture, prefix: str, said: str = "") -> str:
    """A picture with its caption, before which `said` stands.

    A page-wide one has a narrow version for phones; the style sheet shows one of them.
    """
    caption = f"<figcaption>{escaped(f'{said} {picture.caption}'.strip())}</figcaption></figure>"
    if not picture.wide:
        return f'<figure class="square"><div class="pic">{svg.inline(picture, prefix)}</div>{caption}'
    return (f'<figure class="static"><div class="pic desk">{svg.inline(picture, prefix)}</div>'
            f'<div class="pic phone">{svg.inline(picture, prefix + "-n", narrow=True)}</div>{caption}')


def table_html(table: PageTable, name: str, *, links: Sequence[str] = ()) -> str:
    """A table that scrolls sideways by itself; `links` are targets of the first cell of each row, "" for none."""
    right = [' class="right"' if i in table.numeric else "" for i in range(len(table.columns))]
    head = "".join(f'<th scope="col"{r}>{escaped(c)}</th>' for c, r in zip(table.columns, right, strict=True))
    rows = []
    for k, row in enumerate(table.rows):
        cells = [_cell(c) for c in row]
        if links and links[k]:
            cells[0] = f'<a href="{links[k]}">{cells[0]}</a>'
        rows.append(f'<tr><th scope="row"{right[0]}>{cells[0]}</th>'
                    + "".join(f"<td{r}>{c}</td>" for c, r in zip(cells[1:], right[1:], strict=True)) + "</tr>")
    return (f'<div class="scroll" role="region" tabindex="0" aria-labelledby="{name}">'
            f'<table><caption id="{name}">{escaped(table.caption)}</caption><thead><tr>{head}</tr></thead>'
            f"<tbody>{''.join(rows)}</tbody></table></div>")


def side_by_side(cases: tuple[Case, Case]) -> str:
    """Sentence, tables and picture of two studies."""
    found = beside.side_by_side(cases[0].study, cases[1].study)
    drawn = words_beside.picture(found, cases)
    return (f'<p class="beside">{escaped(wording.sentence(found.statement))}</p>'
            + (figure(drawn, "beside") if drawn is not None else "")
            + "".join(table_html(t, f"beside-t{i}") for i, t in enumerate(words_beside.tables(found))))


def _comparison(cases: Sequence[Case], all_facts: Sequence[Facts], drawn: Sequence[dict[str, Picture]]) -> str:
    """Table of all loops (sortable and filterable with the page's script), their S on one axis, small multiples."""
    table = table_html(facts_of.comparison([c.study for c in cases]), COMPARED,
                   links=[f"#s{i}" for i in range(1, len(cases) + 1)])
    parts = [f'<section id="all" aria-labelledby="all-title"><h2 id="all-title">Comparison</h2>'
             f'<p class="filter" hidden><label>Show loops with <input type="search" id="{FILTER}" '
             f'autocomplete="off"></label> <output></output></p>{table}']
    if len(cases) == 2:
        parts.append(side_by_side((cases[0], cases[1])))
    picture = comparison([c.study for c in cases])
    if picture is not None:
        parts.append(figure(picture, "all"))
    small = [(i, f, d["trend"]) for i, (f, d) in enumerate(zip(all_facts, drawn, strict=True), 1) if "trend" in d]
    if small:
        figures = "".join(f'<figure><div class="pic">{svg.inline(p, f"m{i}", narrow=True)}</div>'
                          f'<figcaption><a href="#s{i}">{escaped(f.name)}</a>: {escaped(f.verdict)}</figcaption>'
                          f'</figure>'
                          for i, f, p in small)
        parts.append(f'<h3>All trends</h3><div class="pair">{figures}</div>')
    return "\n".join(parts) + "</section>\n"
