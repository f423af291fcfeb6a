"""Report files: renderer chosen by the extension, all files of a report written, or none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...typing import Progress
from .. import wording
from ..pictures.curves import Case
from ..pictures.gallery import pictures
from ..pictures.picture import Picture
from ..pictures.study_pictures import comparison
from .html import html
from .json import report_json
from .markdown import markdown
from .place import beside, check_place, write_page

# First bytes of each kind of report, by which an older report may be replaced without --force.
KINDS = {".md": b"<!-- stictionid report -->", ".html": b"<!doctype html>\n<!-- stictionid report -->",
         ".json": b'{\n "schema": "stictionid.report/'}


def check_target(out: Path, *, figures: str = "svg", force: bool = False) -> None:
    """Refuse an unknown extension or figure kind, or a place that cannot be written, before any work is done."""
    check_place("report", out, KINDS, ", ".join(KINDS), figures=figures, force=force)


def write_report(cases: Sequence[Case], out: str | Path, *, figures: str = "svg", force: bool = False,
                 progress: Progress | None = None) -> list[Path]:
    """Write the report of `cases` to `out` (.md, .html or .json) and return the files written, `out` last.

    Markdown gets its pictures beside it, named after `out`. `progress` gets a text and the share done. Raises
    UsageError where a file cannot be written.
    """
    out = Path(out)
    check_target(out, figures=figures, force=force)
    kind = out.suffix.lower()
    tell = progress or (lambda text, share: None)
    drawn = []
    for i, case in enumerate(cases):
        tell(f"drawing {wording.name(case.study.data.name)}", 0.7 * i / len(cases))
        drawn.append(pictures(case))
    tell(f"writing {out.name}", 0.7)
    if kind == ".html":
        return write_page(out, html(cases, drawn), {}, force=force, kind=KINDS[kind])
    if kind == ".json":
        return write_page(out, report_json(cases, drawn), {}, force=force, kind=KINDS[kind])
    return _write_markdown(cases, drawn, out, figures, force)


def _write_markdown(cases: Sequence[Case], drawn: list[dict[str, Picture]], out: Path, figures: str,
                    force: bool) -> list[Path]:
    files: dict[Path, Picture] = {}

    def place(key: str, picture: Picture) -> str:
        path = beside(out, key, figures)
        files[path] = picture
        return path.name

    several = len(cases) > 1
    compared = comparison([c.study for c in cases]) if several else None
    names = [{key: place(f"{i}-{key}" if several else key, p) for key, p in one.items()}
             for i, one in enumerate(drawn, 1)]
    text = markdown(cases, drawn, names, (compared, place("comparison", compared)) if compared else None)
    return write_page(out, text, files, figures=figures, force=force, kind=KINDS[".md"])
