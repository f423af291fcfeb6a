"""Named parameters with unit, limits and neutral value, and the map between their values and search vectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..typing import BoolArray, FloatArray

# A value closer than this share of the range to a limit counts as lying on it. Unit: 1; chosen so that a
# converged polish (last step 1e-4 of the range) can't hide on the limit.
AT_BOUND_SHARE = 1e-3


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of a law, an effect or a process: name, unit, limits, and the neutral value at which it vanishes.

    `log` makes the search move it on a logarithmic scale (time constants, rates). `power` makes the search move a root
    of it, for small values in a wide range that begins at 0.
    A model changes by `steps` with a number that each sample either reaches or not: slopes say nothing of it.
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    meaning: str
    log: bool = False
    power: float = 1.0
    steps: bool = False

    def at_bound(self, value: float) -> bool:
        """True when `value` lies on one of the limits, where an estimate means "at least" or "at most"."""
        share = self.share(value)
        return share <= AT_BOUND_SHARE or share >= 1.0 - AT_BOUND_SHARE

    def share(self, value: float) -> float:
        """Position of `value` in the range on the scale of the search, clipped to 0..1; 0 for a fixed parameter."""
        if not self.high > self.low:
            return 0.0
        value = min(max(value, self.low), self.high)
        if self.log:
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return float(((value - self.low) / (self.high - self.low)) ** (1.0 / self.power))


@dataclass(frozen=True, slots=True)
class Space:
    """An ordered set of parameters: a search vector has one entry for each, in this order."""

    parameters: tuple[Parameter, ...]

    @property
    def size(self) -> int:
        """Number of entries of a vector."""
        return len(self.parameters)

    @property
    def movable(self) -> BoolArray:
        """True for parameters that may move, False for those that are fixed (d,)."""
        return np.array([p.high > p.low for p in self.parameters], dtype=bool)

    def to_cube(self, values: FloatArray) -> FloatArray:
        """Points in the unit cube (P, d) of physical values (d, P), clipped to the limits; fixed ones sit at 0."""
        low, span, log = self.scales()
        moved = np.array(values, dtype=np.float64, copy=True)
        moved[log] = np.log(np.maximum(moved[log], 1e-300))
        moved = (moved - low[:, None]) / np.where(span > 0, span, 1.0)[:, None]
        moved[span == 0] = 0.0
        points = np.clip(moved.T, 0.0, 1.0)
        for row, power in self.powers():
            points[:, row] **= 1.0 / power
        return points

    def powers(self) -> list[tuple[int, float]]:
        """Positions and powers of the parameters whose root is searched."""
        return [(i, p.power) for i, p in enumerate(self.parameters) if p.power != 1.0]

    def scales(self) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Lower limits, spans and logarithmic flags (d,), limits of logarithmic parameters as logarithms."""
        log = np.array([p.log for p in self.parameters], dtype=bool)
        low = np.array([np.log(p.low) if p.log else p.low for p in self.parameters])
        high = np.array([np.log(p.high) if p.log else p.high for p in self.parameters])
        return low, high - low, log
