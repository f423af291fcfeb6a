"""The command to type next after a study was made or changed, as it can be typed."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .study_files import data_place


def next_step(study: Any, place: Path, *, data: Path | None = None, effects: Sequence[Path] | None = None,
              laws: Sequence[Path] | None = None, asked: bool | None = None) -> str:
    """The command that goes on from a study at `place`: add what is named, diagnose what is not, else report.

    `data`, `effects` and `laws` are what the present command was given. `asked` says that the model was diagnosed as it
    is; None reads it from the candidates. A study whose data cannot be found again is reported.
    """
    given = _given(data, effects, laws)
    if study.estimate is not None and study.steps[-1].model and data_place(study, place, data) is not None:
        waiting = _waiting(study)
        if waiting:
            return _typed("add", waiting, place, *given)
        if study.adequate is False and not (bool(study.candidates) if asked is None else asked):
            return _typed("diagnose", place, *given)
    return _typed("report", place, *given, "-o", place.with_name(f"{place.stem}.html"))


def remove_step(effect: str, place: Path, *, data: Path | None = None, effects: Sequence[Path] | None = None,
                laws: Sequence[Path] | None = None) -> str:
    """The command that takes an effect out of the study at `place` again."""
    return _typed("remove", effect, place, *_given(data, effects, laws))


def _given(data: Path | None, effects: Sequence[Path] | None, laws: Sequence[Path] | None) -> list[object]:
    """The data file and the user-written files as words of a command."""
    return [*([data] if data else []), *(word for path in effects or () for word in ("--effects", path)),
            *(word for path in laws or () for word in ("--laws", path))]


def _waiting(study: Any) -> str:
    """The first effect that was named and is not in the model yet, with its variant; empty where there is none."""
    from ...reports.answer import named_candidate, spelled

    have = {name.partition("@")[0].partition(":")[0] for name in study.steps[-1].effects}
    for name in study.missing:
        if name not in have:
            candidate = named_candidate(study, name)
            return spelled(candidate) if candidate is not None else str(name)
    return ""


def _typed(*words: object) -> str:
    return "stictionid " + shlex.join(map(str, words))
