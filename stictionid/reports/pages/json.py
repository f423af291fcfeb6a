"""The report as JSON: each study, its facts as worded elsewhere, and every number that its pictures show."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...record.study import plain
from .. import facts as facts_of
from ..pictures.curves import Case
from ..pictures.picture import Picture

SCHEMA = "stictionid.report/1"


def report_json(cases: Sequence[Case], pictures: Sequence[dict[str, Picture]]) -> str:
    """JSON text of the report; `series` holds the record and the last model's curves at full length.

    Facts and studies are indented for people. Pictures and series are for programs and stand on one line each.
    """
    studies = [_study(case, drawn) for case, drawn in zip(cases, pictures, strict=True)]
    text = f'{{\n "schema": "{SCHEMA}",\n "studies": [\n' + ",\n".join(studies) + "\n ]\n}\n"
    # A file name that is not valid UTF-8 reaches Python as lone surrogates; as JSON escapes they are legal text.
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _study(case: Case, drawn: dict[str, Picture]) -> str:
    facts = plain(facts_of.facts(case.study, no_pictures=case.missing))
    parts = [f'"facts": {_indented(facts)}', _in_lines("pictures", {key: plain(p) for key, p in drawn.items()}),
             _in_lines("series", series(case)), f'"study": {_indented(plain(case.study))}']
    return "{\n" + ",\n".join(parts) + "\n}"


def _indented(content: Any) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)


def _in_lines(name: str, content: dict[str, Any] | None) -> str:
    """An object with each member on a line of its own."""
    if content is None:
        return f'"{name}": null'
    lines = [f" {json.dumps(key)}: " + json.dumps(plain(value), ensure_ascii=False, allow_nan=False,
                                                 separators=(",", ":")) for key, value in content.items()]
    return f'"{name}": {{\n' + ",\n".join(lines) + "\n}"


def series(case: Case) -> dict[str, Any] | None:
    """Record and curves of the last model, arrays or lists of n numbers; None without data."""
    loop = case.loop
    if loop is None:
        return None
    last = case.curves[-1] if case.curves else None
    return {"step_s": loop.step_s, "segment_starts": list(loop.starts), "used": np.asarray(loop.used).tolist(),
            "setpoint": loop.setpoint, "output": loop.output, "process_value": loop.process_value,
            "measured_position": loop.position, "model": None if last is None else last.model,
            "residual": None if last is None else last.residual, "position": None if last is None else last.position}
