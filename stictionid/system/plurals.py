"""Counts with their nouns: `1 loop`, `2 loops`."""

from __future__ import annotations


def counted(value: int, what: str, several: str = "") -> str:
    """A count with its noun, thousands separated by commas; `several` is a plural that has more than an s."""
    return f"{value:,} {what if value == 1 else several or what + 's'}"
