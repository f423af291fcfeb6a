"""What a caller may say about an export; everything left out is guessed, shown, and refused with `no_guess`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from ..errors import UsageError

ROLES = ("time", "setpoint", "process_value", "output", "position", "mode", "quality")
"""Roles a column can have; further columns are extras."""


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """How to read a file: names of columns, formats, spans, window; None or empty means "find out".

    `sp pv op position time mode quality extra` are column names or 1-based column numbers. `step_s` seconds.
    `span_pv`, `span_op`, `split` are (low, high) in the unit of the column. `start`, `end` are time stamps, or
    seconds since the first row. `dayfirst` True, False, or None to decide over the whole file. `mode_map` sends
    a mode as written to AUTO, CAS, MAN or OFF. `sentinels` are numbers that mean "no value".
    """

    sp: str | None = None
    pv: str | None = None
    op: str | None = None
    position: str | None = None
    time: str | None = None
    mode: str | None = None
    quality: str | None = None
    extra: tuple[str, ...] = ()
    loop: str | None = None
    step_s: float | None = None
    span_pv: tuple[float, float] | None = None
    span_op: tuple[float, float] | None = None
    split: tuple[float, float] | None = None
    reverse_op: bool = False
    start: str | None = None
    end: str | None = None
    no_guess: bool = False
    decimal: str | None = None
    dayfirst: bool | None = None
    zone: str | None = None
    time_format: str | None = None
    encoding: str | None = None
    separator: str | None = None
    header: int | None = None
    shape: str | None = None
    mode_map: dict[str, str] = field(default_factory=dict)
    quality_kind: str | None = None
    sentinels: tuple[float, ...] = ()
    keep_manual: bool = False
    profile: str | None = None

    def said(self) -> dict[str, Any]:
        """The options that differ from the defaults, as plain JSON types: what `Origin.options` remembers."""
        default = ReadOptions()
        changed = {
            f.name: getattr(self, f.name)
            for f in dataclasses.fields(self)
            if getattr(self, f.name) != getattr(default, f.name)
        }
        return {
            k: list(v) if isinstance(v, tuple) else dict(v) if isinstance(v, dict) else v for k, v in changed.items()
        }


def options_from(said: dict[str, Any]) -> ReadOptions:
    """The ReadOptions that `said` describes (the reverse of `ReadOptions.said`); UsageError for unknown names."""
    known = {f.name for f in dataclasses.fields(ReadOptions)}
    unknown = sorted(set(said) - known)
    if unknown:
        raise UsageError(f"{unknown[0]!r} is not an option of reading", f"known: {', '.join(sorted(known))}")
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in said.items()}
    return ReadOptions(**values)
