"""Which measurement would settle it: for effects that look alike in u and y, the test in which they differ.

The tests are words of the effects' own files. Source: docs/method.md, section 10.
"""

from __future__ import annotations

from ..effects import parse


def settling(name: str, rivals: tuple[str, ...]) -> str:
    """One test in words that tells an effect from its rivals; empty where nothing rivals it."""
    mine = parse(name)[0]
    for rival in rivals:
        other = parse(rival)[0]
        if other.name == mine.name:
            return "a tag of the suspected load, or a step of OP in manual: it shows how a load enters"
        if words := mine.told_apart.get(other.name) or other.told_apart.get(mine.name):
            return words
    return mine.settled_by if rivals else ""
