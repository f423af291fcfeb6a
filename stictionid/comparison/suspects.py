"""Suspects of a comparison: the effects that may be missing as one ranked list, each with its strongest number.

A candidate of the study ranks by its gain. Effects without one rank by the BIC that their own change of the model
output gains (see matches.py). Others, such as noise models, follow by their traces: a finding's weight is its
z value; an effect gets all of it where it stands first among those that leave such a trace, half where it stands
second, a quarter third. All this only suspects; `diagnose` refits.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..record.loop import Finding
from ..record.study import Candidate
from ..selection.node import plain_name
from .matches import Match

# Largest weight of one finding: beyond it a test of many samples says no more. Unit: standard deviations.
_LARGEST = 10.0


@dataclass(frozen=True, slots=True)
class Clue:
    """A finding that points to suspects: its weight as a z value, and the number in words that speaks for them."""

    finding: Finding
    z: float
    speaks: str


@dataclass(frozen=True, slots=True)
class Suspect:
    """One effect that may be missing: score by traces, number of findings that point to it, and what speaks for it.

    `gain_expected` is the BIC that its change of the model output gains beside the base parameters, taken as linear;
    `gain_beyond_noise` is the BIC that a refit gained. Each is None where there is none.
    """

    effect: str
    score: float
    findings: int
    speaks_for: str
    gain_beyond_noise: float | None = None
    gain_expected: float | None = None


def suspects_of(clues: Iterable[Clue], present: Sequence[str], candidates: Iterable[Candidate],
                matched: Sequence[Match] = ()) -> tuple[Suspect, ...]:
    """Effects by which a candidate gained, that match the residual, or that findings point to.

    Those `present` in the model are left out.
    """
    votes: dict[str, list[tuple[float, str]]] = {}
    have = {plain_name(name) for name in present}
    gains = {c.effect: c.gain_beyond_noise for c in candidates
             if c.gain_beyond_noise is not None and c.gain_beyond_noise > 0.0 and c.effect not in have}
    match = {m.effect: m for m in matched if m.effect not in have}
    for clue in clues:
        for rank, effect in enumerate(clue.finding.suggests):
            if effect not in have:
                votes.setdefault(effect, []).append((min(clue.z, _LARGEST) / 2**rank, clue.speaks))
    found = []
    for effect in {**gains, **match, **votes}:
        said, gain, expected = votes.get(effect, []), gains.get(effect), match.get(effect)
        speaks = [max(said)[1]] if said else []
        if gain is not None:
            speaks.insert(0, f"a refit with it gains {gain:.0f} BIC beyond noise")
        elif expected is not None:
            speaks.insert(0, f"its trace explains {100 * expected.share:.0f} % of the free-run error's square")
        found.append(Suspect(effect, sum(w for w, _ in said), len(said), "; ".join(speaks), gain,
                             expected.gain if expected else None))
    return tuple(sorted(found, key=lambda s: (-(s.gain_beyond_noise or 0.0), -(s.gain_expected or 0.0), -s.score,
                                              s.effect)))
