"""A catalogue to which users add: entries from files, folders, an environment variable and installed packages.

A file's code runs only where a command line, the variable or a package names it.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Protocol, TypeVar

from ..errors import DataError
from .registry import Named, Room
from .user_code import files_in

Tell = Callable[[str], None]


class Written(Named, Protocol):
    """Entry of an open catalogue: its name, and file and sha256 of one that a user wrote."""

    @property
    def file(self) -> str:
        """The file it comes from; empty for a built-in entry."""

    @property
    def sha256(self) -> str:
        """Fingerprint of that file."""


Entry = TypeVar("Entry", bound=Written)


class OpenRoom(Room[Entry]):
    """A catalogue with the entries of a folder and those that users bring.

    `load(path, taken, tell)` of `contract/written.py` in the package gives the entry of a file; `taken` are names that
    it may not have. `variable` names the environment variable, `group` the entry points of packages, which bring an
    entry or a module.
    """

    def __init__(self, package: str, constant: str, kind: type[Entry], word: str, order: Callable[[Entry], Any], *,
                 variable: str, group: str) -> None:
        super().__init__(package, constant, kind, word, order, self._bring)
        self.variable, self.group, self.brought = variable, group, False

    def use(self, places: Iterable[str | Path], tell: Tell | None = None) -> tuple[Entry, ...]:
        """Load the entries of files and folders and add them; `tell` hears of every point they pass.

        UsageError for a place that is not there, DataError with file and line for a file that breaks the contract.
        """
        built_in = {name for name, entry in self.catalogue().items() if not entry.file}
        found = tuple(importlib.import_module(f"{self._package}.contract.written").load(path, built_in, tell)
                      for path in files_in(tuple(places), self._word))
        for entry in found:
            have = self.catalogue().get(entry.name)
            if have is not None and have.sha256 != entry.sha256 and have.file != entry.file:
                raise DataError(f"{entry.file}:1: NAME {entry.name} is that of {have.file}, too; choose another one")
            self.register(entry)
        return found

    def _bring(self) -> None:
        """Load the entries of the environment and of installed packages, once."""
        if self.brought:
            return
        self.brought = True
        try:
            if named := [place for place in os.environ.get(self.variable, "").split(os.pathsep) if place]:
                self.use(named)
            self._from_packages()
        except BaseException:
            self.brought = False
            raise

    def _from_packages(self) -> None:
        """Register what installed packages bring: an entry, or a module that is loaded as a file."""
        from importlib.metadata import entry_points

        for point in entry_points(group=self.group):
            try:
                brought = point.load()
            except Exception as error:
                raise DataError(f"the {self._word} {point.name} of {point.value} can't be loaded: {error}",
                                "update or uninstall that package") from None
            if isinstance(brought, self._kind):
                self.register(brought)
            else:
                self.use([str(brought.__file__)])
