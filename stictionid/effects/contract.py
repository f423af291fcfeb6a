"""What a physical effect must bring, so that one new file is all it takes.

An effect is one file in this folder with a constant `EFFECT`. It fills the hooks of its kind and leaves the others:

* F (friction): `friction(table, profile, theta, context)` returns the friction table (ROWS, P) and time profile
  (n,) with other numbers; it transforms no signal, so every law gets it.
* T (transform): `transform(position, theta, context)` returns another position (rows, P) on the path from command
  to process; or `dynamics(dynamics, theta)` returns other process dynamics.
* L (linear): `columns(theta, context)` returns columns (n, P) for the least squares; their sizes are linear.
* N (noise): `noise` names the noise model; it cannot lower a free-run error.

`theta` is (k, P): one row for each parameter in the order of `parameters`. At every parameter's neutral value the
effect vanishes, so models are nested. `guess(context)` returns starting points (g, k) for the search, and
`disturb(theta, context, rng)` what the effect adds in a simulation: (at the output (n,), at the load (n,)).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from ..loop import FloatArray
from ..parameters import Parameter
from ..process import Dynamics


class Place(Enum):
    """Where an effect sits on the way from command to measurement; effects combine in this order."""

    FRICTION = 1
    STEM = 2
    TRIM = 3
    PROCESS = 4
    DISTURBANCE = 5
    NOISE = 6


@dataclass(frozen=True, slots=True)
class Context:
    """What an effect may look at: the record and its grid. Rows are fine steps, samples are every `substeps` rows."""

    command: FloatArray
    process_value: FloatArray
    setpoint: FloatArray | None
    step_s: float
    substeps: int
    period_s: float
    extras: dict[str, FloatArray] = field(default_factory=dict)
    residual: FloatArray | None = None

    @property
    def part_s(self) -> float:
        """Seconds of one fine step."""
        return self.step_s / self.substeps

    @property
    def time_s(self) -> FloatArray:
        """Seconds at the samples, (n,)."""
        return np.arange(self.process_value.size) * self.step_s

    @property
    def fine_time_s(self) -> FloatArray:
        """Seconds at the fine steps, (n*substeps,)."""
        return np.arange(self.command.size) * self.part_s

    @property
    def centre(self) -> float:
        """Mean setpoint, or mean of y without one: where gains are referred to."""
        return float(np.mean(self.process_value if self.setpoint is None else self.setpoint))


@dataclass(frozen=True, slots=True)
class Effect:
    """One physical effect: what it is called, its numbers, its equation, its source, and its hooks."""

    name: str
    kind: str
    place: Place
    summary: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...] = ()
    confused_with: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    limits: Callable[[Context], tuple[Parameter, ...]] | None = None
    friction: Callable[[FloatArray, FloatArray, FloatArray, Context], tuple[FloatArray, FloatArray]] | None = None
    transform: Callable[[FloatArray, FloatArray, Context], FloatArray] | None = None
    dynamics: Callable[[Dynamics, FloatArray], Dynamics] | None = None
    columns: Callable[[FloatArray, Context], tuple[FloatArray, ...]] | None = None
    load: bool = False
    noise: str | None = None
    guess: Callable[[Context], FloatArray] | None = None
    disturb: Callable[[FloatArray, Context, np.random.Generator], tuple[Any, Any]] | None = None

    def parameters_for(self, context: Context) -> tuple[Parameter, ...]:
        """The parameters with limits that suit this record (a period between samples and record length, say)."""
        return self.limits(context) if self.limits else self.parameters
