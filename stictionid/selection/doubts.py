"""Answers that another kind of valve may show as well: one that rests for one that slides, and the other way round.

Between samples of a command that moves, both look alike. A slip jump beyond the stickband needs a friction below zero:
the valve rests, or one that slides jumps past its place. So it may where nothing is named and the free run is far from
its innovations.
"""

from __future__ import annotations

from ..effects import parse
from ..fit.noise.completion import Refit
from ..fit.starts.beside_effect import RESTING
from ..model.spec import Spec
from .entry import Entry
from .node import depth, physical
from .policy import Policy


def odd(entry: Entry, policy: Policy, *, lasting: bool) -> bool:
    """True for a slip jump beyond the stickband; with budget `lasting`, also for a base far from its innovations."""
    values = entry.scored.done.evaluated.values
    return values["J"] > values["S"] or (lasting and entry.spec.held and not depth(entry.spec)
                                         and not entry.scored.nearly(policy))


def slips_like_rests(spec: Spec) -> str:
    """The effect of a node whose slips a valve that rests may show as well; empty where it has none."""
    return next((name for name in physical(spec) if parse(name)[0].natural is not None), "")


def rests_instead(done: Refit, name: str) -> dict[str, float]:
    """Named values of a valve that rests, with the slips and the swings between them of one with effect `name`."""
    model, values, natural = done.model, done.values[:, None], parse(name)[0].natural
    assert natural is not None
    swing, slip = natural.numbers(values[0], values[1], values[model.rows_of(name)], model.context)
    rests = {f"{RESTING}:{p.name}": p.high for p in parse(RESTING)[0].parameters}
    return {**model.named(done.values), "S": float(swing[0]), "J": float(slip[0]), **rests}
