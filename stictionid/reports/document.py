"""What a report consists of before any layout: sections of sentences, tables, pictures and commands, as plain text.

Everything here is unescaped text already made harmless for one line by `wording`; each renderer escapes for its own
language and adds nothing in words.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PageTable:
    """Rows of text under column names; `numeric` holds the indexes of columns set flush right."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Section:
    """One heading with its sentences, bullets, tables, commands, and keys of the pictures that belong to it."""

    key: str
    title: str
    text: tuple[str, ...] = ()
    bullets: tuple[str, ...] = ()
    tables: tuple[PageTable, ...] = ()
    pictures: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class KeyNumber:
    """A number to be read from across the room: label, the number with its interval, and what it means."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True, slots=True)
class Facts:
    """Everything one study says, in reading order; `verdict` is the contract's word, `headline` the sentence."""

    name: str
    title: str
    verdict: str
    headline: str
    reason: str
    numbers: tuple[KeyNumber, ...]
    sections: tuple[Section, ...]
