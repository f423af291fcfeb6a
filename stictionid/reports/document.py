"""Content of a report before any layout: sections of sentences, tables, pictures and commands, as plain text.

The text is unescaped and made harmless for one line by `wording`. Each renderer escapes for its own language and adds
no words.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PageTable:
    """Rows of text under column names; `numeric` holds the indexes of right-aligned columns."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Section:
    """One heading with its sentences, bullets, tables, commands, and keys of its pictures.

    `lines` is text whose columns are aligned by spaces; `lines_title` names it.
    """

    key: str
    title: str
    text: tuple[str, ...] = ()
    bullets: tuple[str, ...] = ()
    tables: tuple[PageTable, ...] = ()
    pictures: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()
    lines_title: str = ""

    def shows(self, drawn: Collection[str]) -> bool:
        """True where anything stands below the heading on a page that has the pictures `drawn`, by their keys."""
        return bool(self.text or self.bullets or self.tables or self.commands or self.lines
                    or any(key in drawn for key in self.pictures))


@dataclass(frozen=True, slots=True)
class KeyNumber:
    """A headline number: label, the value with its interval, and its meaning."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True, slots=True)
class Facts:
    """The whole content of one study in reading order; `verdict` is the contract's word.

    `headline` says what makes the loop swing, where that is known, and `then` the state of the valve and what to do.
    """

    name: str
    title: str
    verdict: str
    headline: str
    then: tuple[str, ...]
    reason: str
    numbers: tuple[KeyNumber, ...]
    sections: tuple[Section, ...]
