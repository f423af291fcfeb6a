"""Check of a page's file name: its extension and the kind of its figures."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ...errors import UsageError

FIGURE_KINDS = ("svg", "png")


def refuse_other_kinds(what: str, out: Path, endings: Iterable[str], choice: str, figures: str | None = None) -> None:
    """UsageError where `out` ends in none of `endings` (`choice` says them in words), or `figures` is no figure kind.
    """
    if out.suffix.lower() not in endings:
        raise UsageError(f"{out.suffix or 'no extension'!r} is no kind of {what}", f"give -o a name ending in {choice}")
    if figures is not None and figures not in FIGURE_KINDS:
        raise UsageError(f"'{figures}' is no kind of figure", "give --figures svg or --figures png")
