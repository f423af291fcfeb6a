"""Study files of the commands: the study, its data file by path and sha256, and a second record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ...errors import DataError, UsageError
from ...system.files import ensure_writable, sha256_of, text_of

StudyArgument = Annotated[Path, typer.Argument(metavar="STUDY", help="Study written by identify -o.")]
DataArgument = Annotated[Path | None, typer.Argument(metavar="[FILE]", help="Its data file, when it has moved.")]


def open_study(path: Path) -> Any:
    """The study in a file; UsageError where it cannot be read, DataError where it is none."""
    from ...record.study import study_from_json

    text = text_of(path, "the study", hint="give a file written by stictionid identify -o")
    try:
        return study_from_json(text)
    except DataError as error:
        # The study comes first: the message says so for a command given its data file there.
        swapped = not text.lstrip().startswith("{")
        raise DataError(f"{path}: {error.message}",
                        "give the study first, a file written by stictionid identify -o, and its data file after it"
                        if swapped else error.hint) from None


def check_study_place(output: Path, *, force: bool) -> None:
    """Refuse a place that can't take a study before any work is done; UsageError for the name of a data file."""
    from ...batch.plan.sources import DATA

    if output.suffix.lower() in DATA:
        raise UsageError(f"-o {output} is the name of a data file, and a study is JSON",
                         f"type -o {output.with_suffix('.json')}")
    ensure_writable(output, force=force, kind=b"{")


def data_place(study: Any, study_path: Path, given: Path | None) -> Path | None:
    """The place of a study's data: the file given, else the one that it names, else one beside it; None without any."""
    from ...reports.pictures.curves import find_data

    if given is not None:
        return given if given.is_file() or given.is_dir() else None
    return find_data(study, near=(study_path.parent,))


def open_data(study: Any, study_path: Path, given: Path | None) -> Any:
    """The loop behind a study; DataError when its sha256 has changed, UsageError when the file is nowhere."""
    from ...reports.pictures.curves import load

    found = data_place(study, study_path, given)
    if found is None:
        raise UsageError(f"the data of the study ({study.data.file or 'unnamed'}) are not there",
                         "give the file after the study")
    return load(study, found)


def open_other(study: Any, study_path: Path, file: Path) -> tuple[Any, Any]:
    """The study's own loop, and the one in `file` (None where `file` is the study's data, moved).

    Where the study's own data are gone its loop is None. UsageError when `file` is absent.
    """
    from ...historian import read_loop
    from ...historian.bytes.options import options_from

    if not file.is_file():
        raise UsageError(f"there is no file {file}", "give the data file of another record of the same loop")
    options = options_from(study.data.options)
    if study.data.sha256 and sha256_of(file) == study.data.sha256:
        return read_loop(file, options=options), None
    # A window of the first record says nothing about another one.
    other = read_loop(file, options=replace(options, start=None, end=None))
    try:
        return open_data(study, study_path, None), other
    except UsageError:
        return None, other
