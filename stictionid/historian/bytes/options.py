"""Options of the reader: columns, formats, spans and window; options not given are guessed, and guesses are listed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from ...errors import UsageError

# Stands among the further tags for all columns of numbers that have no other use.
ALL_TAGS = "*"


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options for reading a file: names of columns, formats, spans, window; None or empty means "find out".

    `sp pv op position time mode quality extra` are column names or 1-based column numbers; an `extra` of * stands for
    every other tag. `step_s` seconds.
    `span_pv`, `span_op`, `split` are (low, high) in the unit of the column. `start`, `end` are time stamps, or
    seconds since the first row. `dayfirst` True, False, or None to decide over the whole file. `mode_map` maps
    a mode as written to AUTO, CAS, MAN or OFF. `roles` maps the reason of a guess, as `Reading.why` words it
    ("suffix 'mv'"), to the role it has on this site; profiles store it. `sentinels` are numbers that mean
    "no value". `limit` raises limits, for example "rows=1e8".
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
    keep_startup: bool = False
    profile: str | None = None
    limit: tuple[str, ...] = ()
    roles: dict[str, str] = field(default_factory=dict)

    @property
    def extra_tags(self) -> tuple[str, ...]:
        """Further tags that are named one by one."""
        return tuple(tag for tag in self.extra if tag != ALL_TAGS)

    def said(self) -> dict[str, Any]:
        """The options that differ from the defaults, as plain JSON types, for `Origin.options`."""
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
    return ReadOptions(**{name: typed(name, value) for name, value in said.items()})


_KINDS = {f.name: str(f.type) for f in dataclasses.fields(ReadOptions)}


def typed(name: str, value: Any) -> Any:
    """A value of TOML or JSON in the type of its option; UsageError where its type is another."""
    kind = _KINDS[name]
    several = list(value) if isinstance(value, (list, tuple)) else []
    numbers = bool(several) and all(_is_number(v) for v in several)
    if value is None and kind.endswith("None"):
        return None
    if kind.startswith("tuple[float, float]") and numbers and len(several) == 2:
        return (float(several[0]), float(several[1]))
    if kind.startswith("tuple[float, ...]") and (numbers or value == []):
        return tuple(float(v) for v in several)
    if kind.startswith("tuple[str, ...]") and isinstance(value, (list, tuple)) and all(
            isinstance(v, str) for v in several):
        return tuple(several)
    if kind.startswith("dict") and isinstance(value, dict):
        return {str(k): str(v) for k, v in value.items()}
    if kind.startswith("bool") and isinstance(value, bool):
        return value
    if kind.startswith("float") and _is_number(value):
        return float(value)
    if kind.startswith("int") and isinstance(value, int) and not isinstance(value, bool):
        return value
    if kind.startswith("str") and isinstance(value, str):
        return value
    raise UsageError(f"{name} = {str(value)[:60]!r} is not a {kind.split(' |')[0]}", "correct it, or save it again")


def _is_number(value: Any) -> bool:
    """A finite JSON number that a float holds."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300
