"""Specification of a model without its numbers (`Spec`), and the result of running one (`Evaluated`, `Curves`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..effects import noises_in, parse
from ..process.intersample import CORNER
from ..record.loop import bridged
from ..typing import FloatArray
from .slips import Paths

FIRST_ORDER, INTEGRATOR = "first-order", "integrator"
BASE = ("S", "J", "initial_residual_force", "time_constant_s", "dead_time_s")
# Softened differences (1 - q^-1) / (1 - 0.8 q^-1), cut after 14 samples: white for the errors of slips that an
# integrator adds up together with white noise on y. Plain differences double the noise and leave the slips. Measured
# on continuous itptd, S = 5, J = 3, noise 0.5 to 1 % of the swing of y: S within 0.8 and J within 1.1 %, against 4.3
# and 8.8 % with plain differences, 4 and 5 % with a first-order process of long lag.
SOFT = tuple(0.8**k for k in range(1, 15))


def suited_effects(names: tuple[str, ...], process: str) -> tuple[str, ...]:
    """Those effects that a process may have: some belong to an integrator."""
    return tuple(name for name in names if process == INTEGRATOR or "integrator" not in parse(name)[0].needs)


@dataclass(frozen=True, slots=True)
class Spec:
    """Structure of a model without its numbers, as `identify` chooses it and a study stores it.

    `fixed` holds values the user knows ("gain", "time_constant_s", "dead_time_s"). `taps` is the autoregressive
    noise model (coefficients after the leading 1); `increments` fits differences, for integrators.
    `guides` are models found before (see `Model.guide`), whose y between samples helps to rebuild a decimated command.
    `paths` are the slips of every segment, where PV placed them; they belong to one grid of the command. With `knots`
    the level of y wanders: it is straight between so many corners, evenly spaced.
    """

    law: str = "chen"
    process: str = FIRST_ORDER
    effects: tuple[str, ...] = ()
    between: str = "hold"
    substeps: int = 1
    increments: bool = False
    taps: tuple[float, ...] = ()
    fixed: dict[str, float] = field(default_factory=dict)
    friction_free: bool = False
    guides: tuple[dict[str, Any], ...] = ()
    paths: Paths | None = None
    knots: int = 0

    @property
    def held(self) -> bool:
        """True where the command is held from one of its values to the next: by the sample, or by the scan."""
        return self.between != CORNER

    def whitening(self) -> FloatArray:
        """All taps of the prewhitening filter, the difference for integrators included."""
        polynomial = np.concatenate([[1.0], self.taps])
        if self.increments:
            polynomial = np.convolve(polynomial, [1.0, -1.0])
        return polynomial[1:]


def own_taps(spec: Spec) -> tuple[float, ...]:
    """Prewhitening that belongs to the fit of the process (softened differences), not to a fitted noise model."""
    return () if has_noise(spec) else tuple(spec.taps)


def has_noise(spec: Spec) -> bool:
    """True where the model has a noise effect already; its coefficients are estimated anew with every refit."""
    return bool(noises_in(spec.effects))


@dataclass(frozen=True, slots=True)
class Curves:
    """One model run against its record, arrays (n,), for pictures. NaN where not defined. `position` is the stem's."""

    output: FloatArray
    model: FloatArray
    residual: FloatArray
    position: FloatArray
    innovation: FloatArray


@dataclass(frozen=True, slots=True)
class Evaluated:
    """One candidate in full: named values, linear coefficients, curves in the unit of y, and the sums behind them.

    `stem` (n,) is the valve position that could be measured; `position` moves the process, behind trim and gain.
    """

    values: dict[str, float]
    gain: float
    offset: float
    own: FloatArray
    transient: FloatArray
    transients: int
    model: FloatArray
    residual: FloatArray
    innovation: FloatArray
    position: FloatArray
    stem: FloatArray
    position_means: FloatArray
    rows: int
    sse: float
    counted: FloatArray
    # Process value (n,) that effects followed, where one follows y.
    followed: FloatArray | None = None
    # First samples of the segments.
    starts: tuple[int, ...] = (0,)

    @property
    def guide(self) -> FloatArray:
        """The y (n,) that the effects of a later model are to follow."""
        return self.model if self.followed is None else self.followed

    @property
    def left(self) -> FloatArray:
        """Residual (n,) for a later model: y less the y that it is to follow.

        Where y is missing it goes straight from one value to the next.
        """
        left = self.residual if self.followed is None else self.residual + self.model - self.followed
        missing = np.isnan(left)
        return np.where(missing, bridged(self.residual + self.model) - self.guide, left) if missing.any() else left

    @property
    def rmse(self) -> float:
        """Free-run error over the samples that count, in the unit of y."""
        return float(np.sqrt(np.mean(self.residual[self.counted > 0] ** 2)))
