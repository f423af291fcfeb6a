"""The tree of a search on a terminal, and the models that explain the record alike."""

from __future__ import annotations

import sys
from typing import Any

from .output import safe


def print_tree(study: Any, console: Any) -> None:
    """Print the models tried, best first, then the cost evaluations and what was not asked; nothing without a tree.

    The branches are plain ASCII where stdout is no terminal, or one whose encoding lacks them.
    """
    from ...reports.tree_text import after_tree, tree_lines

    draws = _draws(console.encoding)
    lines = tree_lines(study, plain=not (sys.stdout.isatty() and draws), width=console.width)
    if lines:
        console.print("models tried", style="bold")
    for line in lines:
        console.print(safe(line if draws else line.replace("…", ".")), no_wrap=True, overflow="ignore", crop=False)
    said = after_tree(study)
    if said:
        console.print(said)


def print_equivalents(study: Any, console: Any) -> None:
    """Print one sentence for each model that explains the record alike."""
    from ...reports.tree_text import equivalents

    for said in equivalents(study):
        console.print(safe(said))


def _draws(encoding: str | None) -> bool:
    try:
        "├─│└…".encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True
