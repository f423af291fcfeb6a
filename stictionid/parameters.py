"""Parameters with names, units, limits and a neutral value, and the map between names and search vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

# A value closer than this share of the range to a limit counts as lying on it. Unit: 1; chosen so that a
# converged polish (last step 1e-4 of the range) can't hide on the limit.
AT_BOUND_SHARE = 1e-3


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of a law, an effect or a process: what it is called, its unit, its limits, where it vanishes."""

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    meaning: str

    def at_bound(self, value: float) -> bool:
        """True when `value` lies on one of the limits, where an estimate means "at least" or "at most"."""
        margin = AT_BOUND_SHARE * (self.high - self.low)
        return value <= self.low + margin or value >= self.high - margin


@dataclass(frozen=True, slots=True)
class Space:
    """An ordered set of parameters: a search vector has one entry for each, in this order."""

    parameters: tuple[Parameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names in the order of the vector."""
        return tuple(p.name for p in self.parameters)

    @property
    def size(self) -> int:
        """How many numbers a vector has."""
        return len(self.parameters)

    def index(self, name: str) -> int:
        """Position of `name` in the vector; KeyError where there is none."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(name) from None

    def as_dict(self, vector: Sequence[float]) -> dict[str, float]:
        """A vector as named values."""
        return {p.name: float(v) for p, v in zip(self.parameters, vector, strict=True)}
