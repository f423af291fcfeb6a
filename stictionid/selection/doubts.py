"""Answers that another valve may show as well, one that rests for one that slides or the other way; drifts they lack.

Between samples of a command that moves, both look alike. A slip jump beyond the stickband needs a friction below zero:
the valve rests, or one that slides jumps past its place. So it may where nothing is named and the free run is far from
its innovations. Which measurement would settle what looks alike is said in words of the effects' own files.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..effects import parse
from ..fit.noise.completion import Refit
from ..fit.starts.beside_effect import RESTING
from ..record.tree import Gate
from .entry import Entry
from .gates import margin_of
from .node import depth, physical, plain
from .policy import Policy
from .score import Scored


def odd(entry: Entry, policy: Policy, *, lasting: bool) -> bool:
    """True for a slip jump beyond the stickband; with budget `lasting`, also for a base far from its innovations."""
    return jumps_past(entry) or (lasting and entry.spec.held and not depth(entry.spec)
                                 and not entry.scored.nearly(policy))


def jumps_past(entry: Entry) -> bool:
    """True for a slip jump beyond the stickband."""
    values = entry.scored.done.evaluated.values
    return values["J"] > values["S"]


def least_cost(name: str, without: Entry, policy: Policy) -> float:
    """BIC that an effect must cost to stay: its margin, or less than nothing for some rests.

    A valve that slides (`without` the rest) with a slip jump beyond its stickband must beat one that rests.
    """
    if plain(name) == RESTING and jumps_past(without):
        return -policy.margin
    return margin_of(name, policy, without.scored.done.model)


def judged_drop(name: str, without: Entry, before: Scored, policy: Policy) -> tuple[Gate, ...]:
    """The gate of an odd valve that came from one that rests and does not do clearly better; empty for others."""
    least, cost = least_cost(name, without, policy), before.done.gain_over(without.scored.done)
    return (Gate("rest", False, "its slip jump exceeds its stickband: a valve that rests does as well"),) \
        if least < 0.0 and cost >= least else ()


def lasting(memo: Mapping[str, Entry], entry: Entry) -> list[str]:
    """Disturbances that last beside other nodes and that a node which leaves more than noise lacks."""
    have = {plain(name) for name in physical(entry.spec)}
    names = dict.fromkeys(e.what for e in memo.values() if e.lasts and e.passed and plain(e.what) not in have)
    return [] if entry.scored.noise_alone else list(names)


def rests_instead(done: Refit, name: str) -> dict[str, float]:
    """Named values of a valve that rests, with the slips and the swings between them of one with effect `name`."""
    model, values, natural = done.model, done.values[:, None], parse(name)[0].natural
    assert natural is not None
    swing, slip = natural.numbers(values[0], values[1], values[model.rows_of(name)], model.context)
    rests = {f"{RESTING}:{p.name}": p.high for p in parse(RESTING)[0].parameters}
    return {**model.named(done.values), "S": float(swing[0]), "J": float(slip[0]), **rests}


def settling(name: str, rivals: tuple[str, ...]) -> str:
    """One test in words that tells an effect from its rivals; empty where nothing rivals it."""
    mine = parse(name)[0]
    for rival in rivals:
        other = parse(rival)[0]
        if other.name == mine.name:
            return "a tag of the suspected load, or a step of OP in manual: it shows how a load enters"
        if words := mine.told_apart.get(other.name) or other.told_apart.get(mine.name):
            return words
    return mine.settled_by if rivals else ""
