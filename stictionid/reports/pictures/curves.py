"""The data and curves behind a study: finds and checks the record, re-runs each step's model once, searches nothing.

A study whose data are gone still gives a report of tables. A study whose data have changed is refused: its pictures
would differ from its numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ...errors import DataError
from ...historian import read_loop
from ...historian.bytes.options import options_from
from ...model.restore import rerun, unknown_code
from ...model.spec import Curves
from ...record.loop import Loop
from ...record.study import Study
from ...system.files import sha256_of
from .. import wording


@dataclass(frozen=True, slots=True)
class Case:
    """One study with its record and one set of curves per step; `missing` says why there is no record."""

    study: Study
    loop: Loop | None = None
    curves: tuple[Curves, ...] = ()
    missing: str = ""


def curves(study: Study, loop: Loop) -> list[Curves]:
    """Model output, residual and valve position of every step of `study` on `loop`, arrays (n,) in the loop's units.

    Steps without a description (written by hand or by older versions) are left out.
    """
    return [rerun(loop, step.model) for step in study.steps if step.model]


def find_data(study: Study, *, near: Sequence[Path] = ()) -> Path | None:
    """The study's file at its recorded place, or in one of the folders `near` when it has moved along with the study.
    """
    recorded = study.data.file
    if not recorded or recorded == "-":
        return None
    try:
        places = [Path(recorded), *(folder / recorded for folder in near),
                  *(folder / Path(recorded).name for folder in near)]
        return next((p for p in places if p.is_file() or p.is_dir()), None)
    except (OSError, ValueError):
        # A name that is too long or has a NUL byte is no place on this machine.
        return None


def load(study: Study, path: Path) -> Loop:
    """The record of `study` read from `path` with the options of the first reading.

    DataError (exit 3) when the file's SHA-256 is not the one the study was made from.
    """
    # A file is known by its bytes before it is read, a folder (a dataset) by the rows read from it.
    loop = read_loop(path, options=options_from(study.data.options)) if path.is_dir() else None
    found = sha256_of(path) if loop is None else loop.origin.sha256
    refuse_changed(study, path, found)
    return read_loop(path, options=options_from(study.data.options)) if loop is None else loop


def refuse_changed(study: Study, path: Path, sha256: str | None) -> None:
    """DataError where the data at `path` have another SHA-256 than those that the study was made from."""
    if study.data.sha256 and sha256 != study.data.sha256:
        raise DataError(
            f"{path} has changed since the study was made: SHA-256 {(sha256 or '')[:12]}…, the study has "
            f"{wording.name(study.data.sha256[:12])}…", "run stictionid identify again, or bring back the old file")


def gather(study: Study, *, data: Path | None = None, near: Sequence[Path] = ()) -> Case:
    """The study with everything its pictures need, or with the reason why they cannot be drawn.

    `data` names the file when it has moved (DataError when absent or changed); `near` are folders to look in.
    """
    if absent := next(filter(None, (unknown_code(step.model) for step in study.steps if step.model)), ""):
        return Case(study, missing=f"{absent}, so this report has tables only; give the file with "
                           "--effects or --laws")
    path = data or find_data(study, near=near)
    if path is None:
        where = wording.name(study.data.file) if study.data.file else "a file the study does not name"
        return Case(study, missing=f"the data ({where}) were not found, so this report has tables only; give the "
                                   "file with --data")
    if not path.exists():
        raise DataError(f"there is no file {path}", "give the data file of the study after --data")
    loop = load(study, path)
    return Case(study, loop, tuple(curves(study, loop)))
