"""Loops from everything that a function of the interface takes: a Loop, a record, a DataFrame, a path."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from ..errors import UsageError
from ..record.loop import Loop as Record
from .loop import Loop, read_loop

if TYPE_CHECKING:
    from ..record.study import Study


def loop_of(source: Any) -> Loop:
    """The loop in a Loop, a record, a DataFrame, a path or an open file; UsageError for anything else."""
    if isinstance(source, Loop):
        return source
    if isinstance(source, Record):
        return Loop(source)
    if isinstance(source, str | os.PathLike) or hasattr(source, "read"):
        return read_loop(source)
    if hasattr(source, "columns") and hasattr(source, "index"):
        return Loop.from_dataframe(source)
    raise UsageError(f"{type(source).__name__} is no loop", "give a Loop, a DataFrame or the path of a file")


def loop_in_file(study: Study) -> Loop:
    """The loop in the file that a study names; UsageError where it is not there, DataError where it has changed."""
    from ..reports.pictures.curves import find_data, refuse_changed

    place = find_data(study)
    if place is None:
        raise UsageError(f"the data of the study ({study.data.file or 'no file'}) are not there",
                         "give the loop that was identified")
    found = read_loop(place, options=study.data.options)
    refuse_changed(study, place, found.record.origin.sha256)
    return found
