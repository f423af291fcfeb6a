"""A valve that was repaired, replaced or packed within a record: when S and J change, and from what to what.

The effect of friction that changes at once is fitted to the whole record. It is said where the record supports it, and
where the intervals before and after do not overlap. Wrong where S changes more than once: one change is then said at
the time that explains most. Source: docs/details.md, sections 5 and 11.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from ..effects import built_in
from ..record.intervals import Span
from ..record.loop import Finding, Loop
from ..record.segments import fitted_segments
from ..record.study import VALVE_CHANGED, ParameterValue, Step, Study
from .by_hand import with_finding
from .support import OPEN, REJECTED

CHANGE = built_in(lambda effect: effect.at_once)
_SOURCE = "Hinkley 1970"
# Span of the possible times below which seconds are said, in seconds.
_SECONDS = 600.0


@dataclass(frozen=True, slots=True)
class Change:
    """One change within a record: `at_s` in seconds since its first sample, `at` as a stamp where it has stamps.

    `S` and `J` hold the value before and after; None for the one that does not change beyond its intervals.
    """

    file: str | None
    at_s: float
    at_interval_s: Span | None
    at: str | None
    S: Span | None
    J: Span | None
    statement: str


def change_of(loop: Loop, study: Study) -> Change | None:
    """The change in the last model of a study of this loop; None where it has none that the record supports."""
    step = study.steps[-1] if study.steps else None
    if step is None or study.estimate is None or CHANGE not in step.effects or _refused(study.steps):
        return None
    rows = {(p.effect, p.name): p for p in step.parameters}
    time = rows[CHANGE, "time_s"]
    S, J = (_change(rows.get((None, name)), rows[CHANGE, of]) for name, of in
            (("S", "stickband_change"), ("J", "jump_change")))
    parts = [f"{name} {'changes ' * (name == 'S' or S is None)}from {both[0]:.3g} to {both[1]:.3g} "
             f"{study.estimate.unit}" for name, both in (("S", S), ("J", J)) if both is not None]
    if not parts:
        return None
    first = float(loop.clock_s[fitted_segments(loop, step.model)[1][0].start])
    span = None if time.interval is None else (first + time.interval[0], first + time.interval[1])
    stamp, said = _when(loop, first + time.value, span)
    return Change(study.data.file, first + time.value, span, stamp, S, J, f"{' and '.join(parts)} {said}")


def with_change(loop: Loop, study: Study) -> Study:
    """The study with a finding on the change in its last model, if it has one."""
    found = change_of(loop, study)
    if found is None:
        return study
    evidence: dict[str, Any] = {"at_s": found.at_s, "at": found.at, "S": found.S, "J": found.J}
    return with_finding(study, Finding(VALVE_CHANGED, "warning", found.statement, evidence, (), _SOURCE))


def _refused(steps: tuple[Step, ...]) -> bool:
    """True where a change was added by hand and the record does not support it."""
    return any(f.code in (REJECTED, OPEN) for step in steps if step.added == CHANGE for f in step.findings)


def _change(now: ParameterValue | None, by: ParameterValue) -> Span | None:
    """A value before and after; None where the intervals of both overlap."""
    if now is None:
        return None
    if now.interval is not None and by.interval is not None:
        low, high = (now.value - end for end in reversed(by.interval))
        if low <= now.interval[1] and high >= now.interval[0]:
            return None
    return now.value - by.value, now.value


def _when(loop: Loop, at_s: float, span: Span | None) -> tuple[str | None, str]:
    """The time of a change as a stamp, and in words with its interval."""
    try:
        start = datetime.fromisoformat(loop.origin.start or "")
    except ValueError:
        ends = f" ({span[0]:.4g} to {span[1]:.4g} s)" if span else ""
        return None, f"{at_s:.4g} s after the first sample{ends}"
    at = start + timedelta(seconds=at_s)
    form = "%H:%M:%S" if span is not None and span[1] - span[0] < _SECONDS else "%H:%M"

    def clock(seconds: float) -> str:
        moment = start + timedelta(seconds=seconds)
        return f"{moment:{form}}" + ("" if moment.date() == at.date() else f" on {moment.day} {moment:%B}")

    ends = f" ({clock(span[0])} to {clock(span[1])})" if span else ""
    return at.isoformat(timespec="seconds"), f"on {at.day} {at:%B %Y} at {at:{form}}{ends}"
