"""Effects inside the closed-loop simulation; it calls the effect files that the model is fitted with, step by step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..effects import get
from ..effects.contract import Effect, Friction, Mover, Place
from ..errors import UsageError
from ..laws.contract import SINCE
from ..process.linear import Dynamics
from ..typing import FloatArray

Given = Sequence[tuple[str, Mapping[str, float | str]]]


@dataclass(slots=True)
class Hidden:
    """Effects of one simulation, prepared by place; `output` and `load` are disturbances at the samples (n,)."""

    S: float
    J: float
    plant: Dynamics
    valve: list[tuple[Friction, FloatArray]]
    movers: list[tuple[Effect, Mover]]
    measured: list[Callable[[float], float]]
    drifting: Effect | None
    since_s: float
    output: FloatArray
    load: FloatArray
    extras: dict[str, FloatArray]

    def friction(self, table: FloatArray, command_step_s: float, held: bool) -> FloatArray:
        """The friction table with every friction effect applied."""
        for friction, theta in self.valve:
            table = friction(table, theta, command_step_s, held)
        self.since_s = float(table[SINCE, 0])
        return table

    def drift(self, time_s: float) -> float:
        """Value of the drift profile at one time."""
        if self.drifting is None or self.drifting.profile is None or time_s < self.since_s:
            return 0.0
        return float(self.drifting.profile(np.array([time_s]))[0])

    def move(self, position: float, y: float, time_s: float, part_s: float, *, arrived: bool = False) -> float:
        """Position after stem and trim effects or, where it has `arrived` at the process, after gain effects.

        `y` is the distance of the process value from its centre at that time.
        """
        for effect, mover in self.movers:
            if (effect.place is Place.PROCESS) == arrived:
                position = mover(position, y, time_s, part_s)
        return position


def hide(given: Given, *, S: float, J: float, plant: Dynamics, time_s: FloatArray, start: float,
         rng: np.random.Generator) -> Hidden:
    """Check the effects and prepare them for one simulation; `plant` is one candidate, `start` the position.

    Raises UsageError for an unknown effect or parameter, a value out of range, or the same effect twice.
    """
    zero = np.zeros(time_s.size)
    hidden = Hidden(S, J, plant, [], [], [], None, 0.0, zero, zero.copy(), {})
    seen: set[str] = set()
    for name, values in given:
        effect = get(name)
        if name in seen:
            raise UsageError(f"effect {name} is given twice", "give it once, with all its parameters")
        seen.add(name)
        _place(hidden, effect, _check_values(effect, values), time_s, start, rng)
    return hidden


def _check_values(effect: Effect, values: Mapping[str, float | str]) -> dict[str, float]:
    """All parameters of an effect by name; a variant that was asked for stands among them, as 1."""
    known = {p.name: p for p in effect.parameters}
    out: dict[str, float] = {p.name: p.neutral for p in effect.parameters}
    for key, value in values.items():
        if key == "at" and effect.variants:
            if value not in effect.variants:
                raise UsageError(f"{effect.name}: at={value} is unknown", "use at=" + " or at=".join(effect.variants))
            out[str(value)] = 1.0
            continue
        if key not in known:
            raise UsageError(f"effect {effect.name} has no parameter '{key}'",
                             "its parameters: " + ", ".join(known | ({"at": None} if effect.variants else {})))
        p = known[key]
        if isinstance(value, str) or not p.low <= value <= p.high:
            raise UsageError(f"{effect.name}: {key} = {value} is outside {p.low:g} to {p.high:g} {p.unit}",
                             f"give a number from {p.low:g} to {p.high:g}")
        out[key] = value
    return out


def _place(hidden: Hidden, effect: Effect, values: dict[str, float], time_s: FloatArray, start: float,
           rng: np.random.Generator) -> None:
    theta = np.array([[values[p.name]] for p in effect.parameters
                      if effect.searched is None or p.name in effect.searched])
    if effect.setting:
        theta, hidden.S, hidden.J = effect.setting(values, hidden.S, hidden.J)
    if effect.friction:
        hidden.valve.append((effect.friction, theta))
        if effect.profile:
            hidden.drifting = effect
    if effect.moves:
        step_s = float(time_s[1] - time_s[0]) if time_s.size > 1 else 1.0
        hidden.movers.append((effect, effect.mover(start, theta, step_s)))
        hidden.movers.sort(key=lambda m: m[0].place.value)
    if effect.dynamics:
        plant = hidden.plant
        hidden.plant = effect.plant(values, plant) if effect.plant else effect.dynamics(plant, theta)
    if effect.measured:
        hidden.measured.append(partial(effect.measured, values=values))
    if "integrator" in effect.needs and theta.any() and not hidden.plant.integrating:
        raise UsageError(f"effect {effect.name} needs an integrating process", "add --integrating, or --preset itptd")
    if effect.disturb:
        output, load, extras = effect.disturb(values, time_s, rng)
        hidden.output = hidden.output + output
        hidden.load = hidden.load + load
        hidden.extras |= extras
