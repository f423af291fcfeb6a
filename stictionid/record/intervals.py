"""Intervals of a study in pieces, and those that a finding withholds or states in place of those that were fitted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from .study import Step

Span = tuple[float, float]
# Share of the value below which two pieces of an interval are one.
GAP = 0.02


def united(spans: Iterable[Span | None]) -> tuple[Span, ...]:
    """Pieces in ascending order that cover all spans; pieces that nearly touch are one."""
    pieces: list[Span] = []
    for low, high in sorted(span for span in spans if span is not None):
        if pieces and low <= pieces[-1][1] + GAP * abs(low):
            low, high = pieces[-1][0], max(pieces.pop()[1], high)
        pieces.append((low, high))
    return tuple(pieces)


def hull(pieces: Sequence[Span]) -> Span | None:
    """The least and the largest number of pieces; None of none."""
    return (pieces[0][0], pieces[-1][1]) if pieces else None


def intervals_withheld(steps: Iterable[Step]) -> bool:
    """True where a finding of some step withholds the intervals (`no_intervals`)."""
    return any(finding.no_intervals for step in steps for finding in step.findings)


def without_intervals(steps: Iterable[Step]) -> tuple[Step, ...]:
    """The steps with no interval of any number."""
    return tuple(replace(step, parameters=tuple(replace(p, interval=None) for p in step.parameters)) for step in steps)
