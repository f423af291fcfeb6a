"""A comparison as markdown with pictures beside it, or as one self-contained HTML page."""

from __future__ import annotations

from pathlib import Path

from ..._version import __version__
from ...comparison import Comparison
from ...comparison.side_by_side import SideBySide
from ...system.files import write_whole
from ...system.plurals import counted
from .. import effect_words, wording
from ..document import PageTable
from ..pictures import svg
from ..pictures.comparison_pictures import comparison_pictures, overview
from ..pictures.curves import Case
from ..pictures.picture import Picture
from . import place
from .html import escaped, figure, page_html, side_by_side
from .markdown import escape as plain
from .markdown import table_text
from .side_by_side import tables as side_tables

MARK = "<!-- stictionid comparison -->"
KIND = f"<!doctype html>\n{MARK}"
KINDS = {".md": MARK.encode(), ".html": KIND.encode()}
# The picture that stands open above all others.
_FIRST = "fit"
SUSPECTED = ("Ranked by the trace that each effect would leave beside this model, its other numbers held; "
             "only a refit tells which it is (stictionid diagnose).")
# Most suspects of a page and of the terminal; the JSON has all.
MOST_SUSPECTS = 6


def check_place(out: Path, *, force: bool = False) -> None:
    """Refuse an unknown extension or a place that cannot be written, before any work is done."""
    place.check_place("comparison", out, KINDS, ".md or .html; --json prints JSON", force=force)


def write_comparison(c: Comparison, title: str, out: Path, *, force: bool = False) -> list[Path]:
    """Write the page and, for markdown, its pictures beside it; the files written, the page last."""
    check_place(out, force=force)
    drawn = comparison_pictures(c)
    if out.suffix.lower() == ".html":
        return place.write_page(out, _html(c, title, drawn), {}, force=force, kind=KINDS[".html"])
    files = {place.beside(out, key): p for key, p in drawn.items()}
    return place.write_page(out, _markdown(c, title, drawn, [p.name for p in files]), files, force=force,
                            kind=KINDS[".md"])


def write_beside(cases: tuple[Case, Case], found: SideBySide, out: Path, *, force: bool = False) -> None:
    """Write the page of two studies side by side; markdown has the tables alone."""
    check_place(out, force=force)
    title = f"Side by side: {wording.name(found.names[0])} and {wording.name(found.names[1])}"
    if out.suffix.lower() == ".html":
        body = f"<h1>{escaped(title)}</h1>{side_by_side(cases)}"
        write_whole(out, page_html(title, body, __version__, KIND), force=force, kind=KINDS[".html"])
        return
    text = "\n\n".join([f"{MARK}\n\n# {plain(title)}", plain(wording.sentence(found.statement)),
                        *map(table_text, side_tables(found))])
    write_whole(out, text + "\n", force=force, kind=KINDS[".md"])


def rows_of(c: Comparison) -> list[tuple[str, str]]:
    """The errors as label and value."""
    e = c.error
    unit = c.ground.loop.unit("process_value", "")
    return [("free-run error", wording.with_unit(e.rmse, unit)),
            ("one-step error", wording.with_unit(e.rmse_one_step, unit)),
            (f"error {counted(e.h_steps, 'sample')} ahead", wording.with_unit(e.rmse_h_step, unit)),
            ("error of the last value as forecast", wording.with_unit(e.persistence, unit)),
            ("irreducible noise", wording.with_unit(e.noise_sd, unit)),
            ("samples that count", wording.count(e.rows)),
            *([("as good as independent ones", wording.count(round(e.effective_rows)))] * _dependent(c))]


def sentences(c: Comparison) -> list[str]:
    """The errors in sentences."""
    e = c.error
    unit = c.ground.loop.unit("process_value", "")
    times = f", {wording.number(e.rmse / e.noise_sd)} times the irreducible noise" if e.noise_sd else ""
    return [f"The free run misses PV by {wording.with_unit(e.rmse, unit)}{times}.",
            f"One step ahead the model misses by {wording.with_unit(e.rmse_one_step, unit)}; the last value as "
            f"forecast misses by {wording.with_unit(e.persistence, unit)}.",
            *([f"Successive errors hang together: {wording.count(e.rows)} samples say as much as "
               f"{wording.count(round(e.effective_rows))} independent ones."] * _dependent(c))]


def _dependent(c: Comparison) -> bool:
    """True where successive errors hang together, so that the samples say less than as many independent ones."""
    return round(c.error.effective_rows) < c.error.rows


def _suspects(c: Comparison) -> PageTable | None:
    """The ranked list of suspects; None where nothing points to any."""
    if not c.suspects:
        return None
    rows = []
    for s in c.suspects[:MOST_SUSPECTS]:
        effect, _ = effect_words.known(s.effect)
        rows.append((wording.name(s.effect), effect.summary if effect else "",
                     wording.clean(s.speaks_for)))
    return PageTable("Suspects, best first", ("suspect", "what it does", "speaks for it"), tuple(rows))


def _markdown(c: Comparison, title: str, drawn: dict[str, Picture], names: list[str]) -> str:
    parts = [MARK, "", f"# {plain(wording.clean(title))}", "", f"**{plain(wording.sentence(c.adequate_reason))}**", ""]
    parts += [part for sentence in sentences(c) for part in (plain(sentence), "")]
    suspects = _suspects(c)
    parts += [plain(SUSPECTED), "", table_text(suspects), ""] if suspects is not None else []
    parts += [f"- **{f.severity}**, {plain(wording.sentence(f.statement))}" for f in (*c.findings, *c.notes)]
    if not c.findings:
        parts.append("- nothing stands out")
    for picture, name in zip(drawn.values(), names, strict=True):
        parts += ["", f"## {plain(picture.title)}", "", f"![{plain(picture.alt)}]({name})", "", plain(picture.caption)]
    return "\n".join(parts) + "\n"


def _html(c: Comparison, title: str, drawn: dict[str, Picture]) -> str:
    """Model against measurement first, then suspects and an overview of the errors; others are folded below."""
    kind = "v-free" if c.adequate else "v-sticks"
    said = "".join(f"<p>{escaped(wording.clean(s))}</p>" for s in sentences(c))
    suspects = _suspects(c)
    shown = "<p>Nothing points to an effect.</p>"
    if suspects is not None:
        shown = f"<p>{escaped(SUSPECTED)}</p><ol>" + "".join(
            f"<li><b>{escaped(name)}</b>, {escaped(what)}. {escaped(wording.sentence(number))}</li>"
            for name, what, number in suspects.rows) + "</ol>"
    small = "".join(f'<figure><h3>{escaped(p.title)}</h3><div class="pic">{svg.inline(p, f"o{i}", small=True)}</div>'
                    "</figure>" for i, p in enumerate(overview(c)))
    points = "".join(f"<li><b>{escaped(f.severity)}</b>, {escaped(wording.sentence(f.statement))}</li>"
                     for f in (*c.findings, *c.notes)) or "<li>nothing stands out</li>"
    figures = {key: figure(p, f"c{i}", p.alt) for i, (key, p) in enumerate(drawn.items())}
    folded = "".join(f"<details><summary>{escaped(p.title)}</summary>{figures[key]}</details>"
                     for key, p in drawn.items() if key != _FIRST)
    first = (f'<section aria-labelledby="{_FIRST}"><h2 id="{_FIRST}">{escaped(drawn[_FIRST].title)}</h2>'
             f"{figures[_FIRST]}</section>")
    links = "".join(f'<li><a href="#{key}">{word}</a></li>' for key, word in (
        (_FIRST, drawn[_FIRST].title), ("who", "Suspects"), ("where", "Where it fails"), ("found", "Findings"),
        ("details", "Pictures")))
    body = (f'<h1>{escaped(wording.clean(title))}</h1><div class="verdict {kind}"><p class="said">'
            f'{escaped(wording.sentence(c.adequate_reason))}</p>{said}</div>'
            f'<nav aria-label="Sections"><ul>{links}</ul></nav>'
            f'{first}<section aria-labelledby="who"><h2 id="who">Suspects</h2>{shown}</section>'
            '<section aria-labelledby="where"><h2 id="where">Where it fails</h2><p>Free-run error of each part of the '
            f'record, all on one scale; dashed: the whole record.</p><div class="small">{small}</div></section>'
            f'<section aria-labelledby="found"><h2 id="found">Findings</h2><ul>{points}</ul></section>'
            f'<section aria-labelledby="details"><h2 id="details">Pictures</h2>{folded}</section>')
    return page_html(title, body, __version__, KIND)
