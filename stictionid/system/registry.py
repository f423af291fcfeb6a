"""Registry of a catalogue kept as a folder: one module for each entry, each with one constant of a given name.

Laws, effects and methods are such folders. A new entry is one new file and no other change.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import pkgutil
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from ..errors import UsageError


class Named(Protocol):
    """Entry of a catalogue; it has a name."""

    @property
    def name(self) -> str:
        """The name it is chosen by."""


def names_in(package: str, constant: str) -> list[str]:
    """Names of a folder's entries, sorted, by its files alone: no module of it is imported."""
    spec = importlib.util.find_spec(package)
    places = spec.submodule_search_locations if spec is not None else None
    return sorted(path.stem.replace("_", "-") for place in places or () for path in Path(place).glob("*.py")
                  if re.search(rf"^{constant}\b", path.read_text(encoding="utf-8"), re.MULTILINE))


Entry = TypeVar("Entry", bound=Named)


class Room(Generic[Entry]):
    """A catalogue: the modules of a package that hold a constant of one type, and entries added from elsewhere.

    Entries are sorted by `order`, `word` is the kind of entry in messages. `late` is called before other entries than
    those of the folder are asked for; it adds them.
    """

    def __init__(self, package: str, constant: str, kind: type[Entry], word: str, order: Callable[[Entry], Any],
                 late: Callable[[], None] = lambda: None) -> None:
        self._package, self._constant, self._kind, self._word = package, constant, kind, word
        self._order, self._late = order, late
        self._own: dict[str, Entry] = {}
        self._places: list[str] = []
        self._others: dict[str, Entry] = {}

    def built_in(self) -> dict[str, Entry]:
        """The entries of the folder by name, in no order, read once; again where the package has got another folder."""
        places = list(sys.modules[self._package].__path__)
        if places != self._places:
            self._own, self._places = {}, places
            for module in pkgutil.iter_modules(places):
                entry = getattr(importlib.import_module(f"{self._package}.{module.name}"), self._constant, None)
                if entry is not None:
                    self._own[entry.name] = entry
        return self._own

    def catalogue(self) -> dict[str, Entry]:
        """All entries by name, in their order."""
        self._late()
        entries = sorted((*self.built_in().values(), *self._others.values()), key=self._order)
        return {entry.name: entry for entry in entries}

    def added(self) -> dict[str, Entry]:
        """The entries that do not come from the folder by name, in their order; no file of the folder is read."""
        self._late()
        return {entry.name: entry for entry in sorted(self._others.values(), key=self._order)}

    def get(self, name: str) -> Entry:
        """The entry called `name`; UsageError naming the nearest one where there is none."""
        try:  # the usual case loads one file only
            entry = getattr(importlib.import_module(f"{self._package}.{name.replace('-', '_')}"), self._constant, None)
            if isinstance(entry, self._kind) and entry.name == name:
                return entry
        except (ImportError, ValueError):
            pass
        entries = self._others if name in self._others else self.catalogue()
        if name in entries:
            return entries[name]
        near = difflib.get_close_matches(name, entries, 1)
        raise UsageError(f"unknown {self._word} '{name}'", (f"did you mean '{near[0]}'? " if near else "")
                         + f"{self._word}s: " + ", ".join(entries))

    def register(self, entry: Entry) -> None:
        """Add an entry, or put it in the place of an added one; UsageError where the folder has its name."""
        if entry.name in self.built_in():
            raise UsageError(f"the name {entry.name} is that of a built-in {self._word}", "choose another name")
        self._others[entry.name] = entry

    def forget(self, name: str) -> None:
        """Take an added entry out again; nothing happens where there is none."""
        self._others.pop(name, None)


def room(package: str, constant: str, kind: type[Entry], word: str, order: Callable[[Entry], Any],
         ) -> tuple[Callable[[], dict[str, Entry]], Callable[[str], Entry]]:
    """The functions `catalogue` and `get` of a room to which nothing is added."""
    found = Room(package, constant, kind, word, order)
    return found.catalogue, found.get
