"""PATHs of the command line as files and folders, and the files there that cannot hold a loop."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ...errors import UsageError
from ...historian.bytes.source import PARQUET, TEXT
from ...historian.dataset import RESULTS_MARK

PARTS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods", ".mat")
DATA = (*TEXT, *PARQUET, *PARTS)
"""Endings of files that may hold a loop."""
NOTES = (".txt",)
"""Endings of files that may as well hold a letter: one without a table is no record, where a .csv is damaged."""
EMPTY_FOLDER = "a folder without any file"
FOREIGN = "neither text, Parquet, workbook nor MATLAB file by its name"


@dataclass(frozen=True, slots=True)
class FoundFiles:
    """Files behind the paths: named one by one, found in folders, and skipped ones with their reason."""

    named: tuple[Path, ...]
    inside: dict[Path, tuple[Path, ...]]
    skipped: tuple[tuple[Path, str], ...]


def look(paths: Iterable[str], *, leave: Iterable[Path] = ()) -> FoundFiles:
    """Files behind files, folders and patterns; `leave` are files and folders left out. UsageError if a path is absent.
    """
    # The file or folder behind links; a link that leads to itself stays, where `Path.resolve` fails.
    left = {os.path.realpath(p) for p in leave}
    named: dict[Path, None] = {}
    inside: dict[Path, tuple[Path, ...]] = {}
    skipped: dict[Path, str] = {}
    for path in paths:
        for place in _places(path):
            if os.path.realpath(place) in left:
                continue
            if not place.is_dir():
                named[place] = None
                continue
            files = []
            for file in _walk(place, left) or [place]:
                if file.is_dir():
                    skipped[file] = EMPTY_FOLDER
                elif file.suffix.lower() in DATA:
                    files.append(file)
                else:
                    skipped[file] = FOREIGN
            inside[place] = tuple(files)
    return FoundFiles(tuple(named), inside, tuple(skipped.items()))


def _places(path: str) -> list[Path]:
    place = Path(path)
    if place.exists():
        return [place]
    found = sorted(glob.glob(path, recursive=True)) if glob.has_magic(path) else []
    if not found:
        raise UsageError(f"{path} does not exist" + (" (no file fits the pattern)" if glob.has_magic(path) else ""),
                         "check the spelling; ls shows what is there")
    return [Path(f) for f in found if not Path(f).name.startswith(".")]


def _walk(folder: Path, left: set[str]) -> list[Path]:
    """Files of a folder and its subfolders in order, without hidden ones, marks (_SUCCESS), locks (~$) and results.

    An empty folder stands for itself where it is called like a file of data. A link to a folder that contains it is
    not followed.
    """
    found: list[Path] = []
    if (folder / RESULTS_MARK).is_file():
        return found
    for entry in sorted(folder.iterdir(), key=lambda p: p.name):
        if entry.name.startswith((".", "_", "~$")) or os.path.realpath(entry) in left:
            continue
        if entry.is_dir():
            inside = _walk(entry, left | {os.path.realpath(folder)})
            found += inside or [entry] * (entry.suffix.lower() in DATA)
        elif entry.is_file():
            found.append(entry)
    return found
