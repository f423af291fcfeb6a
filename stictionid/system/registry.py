"""Registry of a catalogue kept as a folder: one module for each entry, each with one constant of a given name.

Laws, effects and methods are such folders. A new entry is one new file and no other change.
"""

from __future__ import annotations

import difflib
import importlib
import pkgutil
import sys
from collections.abc import Callable
from functools import cache
from typing import Any, Protocol, TypeVar

from ..errors import UsageError


class Named(Protocol):
    """Entry of a catalogue; it has a name."""

    @property
    def name(self) -> str:
        """The name it is chosen by."""


Entry = TypeVar("Entry", bound=Named)


def room(package: str, constant: str, kind: type[Entry], word: str,
         order: Callable[[Entry], Any]) -> tuple[Callable[[], dict[str, Entry]], Callable[[str], Entry]]:
    """Two functions over the modules of `package` that hold a `constant` of type `kind`: all by name, and one by name.

    The first returns all entries sorted by `order`. The second imports only the file that bears the name, where there
    is one. It raises UsageError with the nearest name for an unknown one; `word` is the kind of entry in that message.
    """
    @cache
    def catalogue() -> dict[str, Entry]:
        """All entries by name, in their order."""
        found = []
        for module in pkgutil.iter_modules(sys.modules[package].__path__):
            entry = getattr(importlib.import_module(f"{package}.{module.name}"), constant, None)
            if entry is not None:
                found.append(entry)
        return {entry.name: entry for entry in sorted(found, key=order)}

    def get(name: str) -> Entry:
        """The entry called `name`; UsageError naming the nearest one where there is none."""
        try:  # the usual case loads one file only
            entry = getattr(importlib.import_module(f"{package}.{name.replace('-', '_')}"), constant, None)
            if isinstance(entry, kind) and entry.name == name:
                return entry
        except (ImportError, ValueError):
            pass
        entries = catalogue()
        if name in entries:
            return entries[name]
        near = difflib.get_close_matches(name, entries, 1)
        raise UsageError(f"unknown {word} '{name}'", (f"did you mean '{near[0]}'? " if near else "")
                         + f"{word}s: " + ", ".join(entries))

    return catalogue, get
