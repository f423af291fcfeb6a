"""A catalogue that is a folder: one file for each entry, each with one constant, found by looking.

Laws, effects and methods are such folders; a new entry is one new file and nothing else.
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
    """What every entry has."""

    @property
    def name(self) -> str:
        """The name it is chosen by."""


Entry = TypeVar("Entry", bound=Named)


def room(package: str, constant: str, kind: type[Entry], word: str,
         order: Callable[[Entry], Any]) -> tuple[Callable[[], dict[str, Entry]], Callable[[str], Entry]]:
    """Two functions for the modules of `package` that hold a `constant` of some `kind`: all by name, and one by name.

    All come sorted by `order`. One loads its own file only, where the file bears its name; UsageError with the nearest
    name where there is none (`word` says what it is).
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
