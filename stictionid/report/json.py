"""The report as JSON: each study, its facts as worded elsewhere, and every number its pictures show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..results import plain, to_json
from . import facts as facts_of
from .curves import Case
from .picture import Picture

SCHEMA = "stictionid.report/1"


def report_json(cases: Sequence[Case], pictures: Sequence[dict[str, Picture]]) -> str:
    """JSON text of the report; `series` holds the record and the last model's curves at full length."""
    studies = []
    for case, drawn in zip(cases, pictures, strict=True):
        studies.append({
            "facts": plain(facts_of.facts(case.study, no_pictures=case.missing)),
            "pictures": {key: plain(p) for key, p in drawn.items()},
            "series": series(case),
            "study": plain(case.study),
        })
    text = to_json({"schema": SCHEMA, "studies": studies})
    # A file name that is not valid UTF-8 reaches Python as lone surrogates; as JSON escapes they are legal text.
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def series(case: Case) -> dict[str, Any] | None:
    """Record and curves of the last model, lists of n numbers; None without data."""
    loop = case.loop
    if loop is None:
        return None
    last = case.curves[-1] if case.curves else None
    return {"step_s": loop.step_s, "segment_starts": list(loop.starts), "used": loop.used.tolist(),
            "setpoint": None if loop.setpoint is None else loop.setpoint, "output": loop.output,
            "process_value": loop.process_value, "measured_position": loop.position,
            "model": None if last is None else last.model, "residual": None if last is None else last.residual,
            "position": None if last is None else last.position}
