"""Crossed design of the plants: loop k of a base seed gets one level of every factor.

Loops are drawn one after the other. Each takes the candidate row whose levels, and pairs of levels, were used least so
far. So every level of a factor is used equally often and the pairs are spread. `possible` leaves out rows that no loop
can have. A design of more loops begins with the same rows.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np

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
_CANDIDATES = 150
# Weight of a level used too often beside that of a pair of levels.
_LEVEL_WEIGHT = 4.0


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
    if "re-sticking" in names and row["valve"] != "sliding":
        return False  # The valve rests already.
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
    choices = _choices(kind)
    used: Counter[object] = Counter()
    rows = []
    for _ in range(loops):
        # Of the effects those that were hidden least often, in random order.
        weight = [used[c] * 10.0 + sum(used[e] for e in c) + rng.random() for c in choices]
        effects = choices[int(np.argmin(weight))]
        found = [dict(zip(FACTORS, (str(rng.choice(levels)) for levels in FACTORS.values()), strict=True))
                 for _ in range(_CANDIDATES)]
        best = min((row for row in found if possible(row, effects)), key=lambda row: _cost(used, row, effects))
        used.update([effects, *effects, *best.items(), *combinations(best.items(), 2),
                     *((e, item) for e in effects for item in best.items())])
        rows.append((best, effects))
    return rows


def _cost(used: Counter[object], row: dict[str, str], effects: tuple[str, ...]) -> float:
    """Use so far of the levels of a row and of their pairs, each relative to the number of levels."""
    levels = sum(used[item] * len(FACTORS[item[0]]) for item in row.items()) * _LEVEL_WEIGHT
    both = sum(used[a, b] * len(FACTORS[a[0]]) * len(FACTORS[b[0]]) for a, b in combinations(row.items(), 2))
    beside = sum(used[e, item] * len(FACTORS[item[0]]) for e in effects for item in row.items())
    return levels + 0.25 * both + beside
