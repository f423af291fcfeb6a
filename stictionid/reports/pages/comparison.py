"""A comparison as markdown with pictures beside it, or as one self-contained HTML page."""

from __future__ import annotations

from html import escape
from pathlib import Path

from ...comparison import Comparison
from ...system.files import ensure_writable, write_whole
from .. import wording
from ..pictures import svg
from ..pictures.comparison_pictures import comparison_pictures
from ..pictures.figures import figure_bytes
from ..pictures.picture import Picture
from .place import refuse_other_kinds

MARK = "<!-- stictionid comparison -->"
KINDS = {".md": MARK.encode(), ".html": b"<!doctype html>\n" + MARK.encode()}


def check_place(out: Path, *, force: bool = False) -> None:
    """Refuse an unknown extension or a place that cannot be written, before any work is done."""
    refuse_other_kinds("comparison", out, KINDS, ".md or .html; --json prints JSON")
    ensure_writable(out, force=force, kind=KINDS[out.suffix.lower()])


def write_comparison(c: Comparison, title: str, out: Path, *, force: bool = False) -> list[Path]:
    """Write the page and, for markdown, its pictures beside it; the files written, the page last."""
    check_place(out, force=force)
    drawn = comparison_pictures(c)
    if out.suffix.lower() == ".html":
        write_whole(out, _html(c, title, drawn), force=force, kind=KINDS[".html"])
        return [out]
    files = {out.with_name(f"{out.stem}-{key.replace('_', '-')}.svg"): p for key, p in drawn.items()}
    for path in files:
        ensure_writable(path, force=force, kind=svg.SVG_KIND)
    for path, picture in files.items():
        write_whole(path, figure_bytes(picture, "svg"), force=force, kind=svg.SVG_KIND)
    write_whole(out, _markdown(c, title, drawn, [p.name for p in files]), force=force, kind=KINDS[".md"])
    return [*files, out]


def rows_of(c: Comparison) -> list[tuple[str, str]]:
    """The errors as label and value."""
    e = c.error
    unit = c.ground.loop.unit("process_value", "")
    return [("free-run error", wording.with_unit(e.rmse, unit)),
            ("one-step error", wording.with_unit(e.rmse_one_step, unit)),
            (f"error {e.h_steps} samples ahead", wording.with_unit(e.rmse_h_step, unit)),
            ("error of y(k) = y(k-1)", wording.with_unit(e.persistence, unit)),
            ("irreducible noise", wording.with_unit(e.noise_sd, unit)),
            ("samples, worth", f"{e.rows}, {e.effective_rows:.0f}")]


def _markdown(c: Comparison, title: str, drawn: dict[str, Picture], names: list[str]) -> str:
    from .markdown import escape as plain

    parts = [MARK, "", f"# {plain(wording.clean(title))}", "", plain(wording.sentence(c.adequate_reason)), "",
             "| | |", "|---|---:|"]
    parts += [f"| {plain(a)} | {plain(b)} |" for a, b in rows_of(c)]
    parts.append("")
    for f in (*c.findings, *c.notes):
        tail = f" Points to {', '.join(f.suggests)}." if f.suggests else ""
        parts.append(f"- **{f.severity}**, {plain(wording.sentence(f.statement))}{plain(tail)}")
    if not c.findings:
        parts.append("- nothing stands out")
    for picture, name in zip(drawn.values(), names, strict=True):
        parts += ["", f"## {plain(picture.title)}", "", f"![{plain(picture.alt)}]({name})", "", plain(picture.caption)]
    return "\n".join(parts) + "\n"


def _html(c: Comparison, title: str, drawn: dict[str, Picture]) -> str:
    def safe(text: str) -> str:
        return escape(wording.clean(text))

    style = (f":root{{{svg.variables(False)}}}\n@media (prefers-color-scheme:dark){{:root{{{svg.variables(True)}}}}}\n"
             "body{margin:0 auto;max-width:60rem;padding:1rem;background:var(--ground);color:var(--ink);"
             "font:1rem/1.5 system-ui,Arial,sans-serif}figure{margin:1.5rem 0}svg{width:100%;height:auto}"
             f"td{{padding:.1rem 1rem .1rem 0}}\n{svg.style('.pic')}")
    rows = "".join(f"<tr><td>{safe(a)}</td><td>{safe(b)}</td></tr>" for a, b in rows_of(c))
    points = "".join(
        f"<li><b>{safe(f.severity)}</b>, {safe(wording.sentence(f.statement))}"
        + (f" Points to {safe(', '.join(f.suggests))}." if f.suggests else "") + "</li>"
        for f in (*c.findings, *c.notes)) or "<li>nothing stands out</li>"
    figures = "".join(f'<figure><h2>{safe(p.title)}</h2><div class="pic">{svg.inline(p, f"c{i}")}</div>'
                      f"<figcaption>{safe(p.caption)}</figcaption></figure>" for i, p in enumerate(drawn.values()))
    return (f'<!doctype html>\n{MARK}\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            '<meta name="color-scheme" content="light dark">'
            f"<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">"
            f'<title>{safe(title)}</title><style>{style}</style></head><body><main><h1>{safe(title)}</h1>'
            f'<svg width="0" height="0" aria-hidden="true">{svg.HATCH}</svg>'
            f"<p>{safe(wording.sentence(c.adequate_reason))}</p><table>{rows}</table><ul>{points}</ul>{figures}"
            "</main></body></html>\n")
