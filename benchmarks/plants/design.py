"""Crossed design of the plants: loop k of a base seed gets one level of every factor.

Loops are drawn one after the other. Each takes the candidate row whose levels, and pairs of levels, were used least so
far. So every level of a factor is used equally often and the pairs are spread. `possible` leaves out rows that no loop
can have. A design of more loops begins with the same rows.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FACTORS: dict[str, tuple[str, ...]] = {
    "process": ("first-order", "second-order", "integrating"),
    "excitation": ("steady", "moves", "cascade"),
    "controller": ("P", "PI", "PID", "gap"),
    "valve": ("sliding", "resting", "inertial"),
    "command": ("held", "moving"),
    "noise": ("white", "white-5", "ar", "ar-white"),
    "rounding": ("none", "rounded"),
    "export": ("1", "2", "5", "10"),
}
EFFECTS = ("asymmetric-stiction", "stiction-drift", "re-sticking", "slip-overshoot", "travel-limit", "slew-limit",
           "valve-characteristic", "gain-nonlinearity", "extra-lag", "sinusoidal-disturbance",
           "step-disturbance@output", "step-disturbance@load", "ramp-disturbance@output", "ramp-disturbance@load",
           "narrow-band-disturbance", "random-walk-disturbance", "coloured-noise", "measured-disturbance")
NOISES = ("narrow-band-disturbance", "random-walk-disturbance", "coloured-noise")
KINDS = ("clean", "one", "two")
# Effects that are nearly the same in u and y, so that a pair of them asks for what nobody can tell.
_ALIKE = ({"valve-characteristic", "gain-nonlinearity"}, {"extra-lag", "slew-limit"},
          {"step-disturbance", "ramp-disturbance"}, {"step-disturbance", "random-walk-disturbance"},
          {"ramp-disturbance", "random-walk-disturbance"}, {"travel-limit", "valve-characteristic"},
          {"narrow-band-disturbance", "sinusoidal-disturbance"}, {"re-sticking", "stiction-drift"})
_CANDIDATES = 300
# Weights of a level, and of a pair of levels (counted in both orders), that were used before.
_LEVEL_WEIGHT, _PAIR_WEIGHT = 4.0, 0.125


def plain(name: str) -> str:
    """The name of an effect without its variant or tag."""
    return name.partition("@")[0].partition(":")[0]


def pairs() -> tuple[tuple[str, str], ...]:
    """All pairs of effects that can be told apart: no two of noise, no two alike."""
    return tuple((a, b) for a, b in combinations(EFFECTS, 2)
                 if plain(a) != plain(b) and {plain(a), plain(b)} not in _ALIKE
                 and not (plain(a) in NOISES and plain(b) in NOISES))


def possible(row: dict[str, str], effects: tuple[str, ...]) -> bool:
    """False where a row of levels contradicts itself or its hidden effects."""
    names = {plain(name) for name in effects}
    if row["controller"] == "P" and row["excitation"] == "steady":
        return False  # Without an integral part nothing cycles.
    if "extra-lag" in names and row["process"] == "second-order":
        return False  # The second lag is in the process already.
    # A valve that rests can't re-stick, and its longer slip is that of another S and J. Under a held command only the
    # scans themselves show whether the valve slid.
    slides = row["valve"] == "sliding" and (row["command"] == "moving" or row["export"] == "1")
    if names & {"re-sticking", "slip-overshoot"} and not slides:
        return False
    if "valve-characteristic" in names and row["excitation"] == "steady":
        return False  # Over a short travel no curve shows.
    if "coloured-noise" in names:
        return row["noise"] in ("ar", "ar-white")
    return not (names & set(NOISES)) or row["noise"] in ("white", "white-5")


def _choices(kind: str) -> tuple[tuple[str, ...], ...]:
    if kind == "clean":
        return ((),)
    return tuple((name,) for name in EFFECTS) if kind == "one" else pairs()


def design(kind: str, loops: int, seed: int) -> list[tuple[dict[str, str], tuple[str, ...]]]:
    """Levels by factor and hidden effects of the first `loops` loops of a kind (see `KINDS`) and base seed."""
    if kind not in KINDS:
        raise ValueError(f"kind '{kind}' is unknown; use one of {', '.join(KINDS)}")
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    choices, sizes = _choices(kind), [len(levels) for levels in FACTORS.values()]
    chosen, hidden = Counter[tuple[str, ...]](), Counter[str]()
    # Uses of level a of factor i beside level b of factor j, (i, j, a, b); alone where i = j and a = b.
    used = np.zeros((len(sizes), len(sizes), max(sizes), max(sizes)))
    # Uses of a level beside each effect.
    beside = {name: np.zeros((len(sizes), max(sizes))) for name in EFFECTS}
    weights = _weights(sizes)
    rows = []
    for _ in range(loops):
        # Of the effects those that were hidden least often, in random order.
        scores = [10.0 * chosen[c] + sum(hidden[name] for name in c) + rng.random() for c in choices]
        effects = choices[int(np.argmin(scores))]
        drawn = rng.integers(0, sizes, (_CANDIDATES, len(sizes)))
        drawn = drawn[[possible(_named(row), effects) for row in drawn]]
        each = np.arange(len(sizes))
        pairs_used = used[each[:, None], each, drawn[:, :, None], drawn[:, None, :]]
        cost = (weights * pairs_used).sum(axis=(1, 2))
        for name in effects:
            cost += (beside[name][each, drawn] * sizes).sum(axis=1)
        best = drawn[int(np.argmin(cost))]
        used[each[:, None], each, best[:, None], best] += 1.0
        for name in effects:
            beside[name][each, best] += 1.0
        chosen[effects] += 1
        hidden.update(effects)
        rows.append((_named(best), effects))
    return rows


def _weights(sizes: list[int]) -> FloatArray:
    """Weight of the uses of each pair of factors (i, j): rarer the more levels they have; level alone where i = j."""
    count = np.array(sizes, dtype=np.float64)
    weights = _PAIR_WEIGHT * np.outer(count, count)
    np.fill_diagonal(weights, _LEVEL_WEIGHT * count)
    return weights


def _named(row: NDArray[np.int64]) -> dict[str, str]:
    return {factor: levels[i] for (factor, levels), i in zip(FACTORS.items(), row.tolist(), strict=True)}
