"""Intervals of a study that a finding withholds, or states in place of those that were fitted."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from .study import Estimate, Step


def intervals_withheld(steps: Iterable[Step]) -> bool:
    """True where a finding of some step withholds the intervals (`no_intervals` in its evidence)."""
    return any(finding.evidence.get("no_intervals") for step in steps for finding in step.findings)


def with_ranges(found: Estimate, steps: Iterable[Step]) -> Estimate:
    """The estimate with the ranges of S and J that a finding states, and its own values, as intervals.

    The evidence holds `S_range`, `J_range`, and the share of S by which they become `wider`.
    """
    said = next((f.evidence for step in steps for f in step.findings if "S_range" in f.evidence), None)
    if said is None:
        return found
    S, J = ((max(min(said[name][0], value) - said["wider"] * found.S, 0.0),
             max(said[name][1], value) + said["wider"] * found.S)
            for name, value in (("S_range", found.S), ("J_range", found.J)))
    return replace(found, S_interval=S, J_interval=J)


def without_intervals(steps: Iterable[Step]) -> tuple[Step, ...]:
    """The steps with no interval of any number."""
    return tuple(replace(step, parameters=tuple(replace(p, interval=None) for p in step.parameters)) for step in steps)
