"""One family of noise models, from white noise to a random walk under measurement noise, with an autoregression.

    e = A(q) (1 - rho q^-1) / (1 - theta q^-1) v,    A = 1 + taps[0] q^-1 + …, of order 0 to 8, 0 <= rho, theta <= 1

rho = theta leaves A alone: an autoregression, or white noise. rho = 1 is a random walk under measurement noise, and 1 -
theta the gain of its steady Kalman filter. 0 < theta < rho < 1 is an AR(1) under measurement noise. Source:
docs/details.md, section 7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...typing import FloatArray

WHITE, AUTOREGRESSION, MEASURED, WALK = "white", "autoregression", "measured autoregression", "walk"
# Shortest period of a narrow band. Unit: samples.
_SHORTEST = 2.5


@dataclass(frozen=True, slots=True)
class Noise:
    """A noise model: `taps` of A after the leading 1, `rho` and `theta`; white noise unless stated."""

    taps: tuple[float, ...] = ()
    rho: float = 0.0
    theta: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rho", "theta"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} is {value:g}, outside 0 to 1; give a value from 0 to 1")
        if not all(map(math.isfinite, self.taps)):
            raise ValueError(f"taps {self.taps} are not finite; give finite numbers")

    @property
    def cancels(self) -> bool:
        """True where rho and theta cancel, so that A is all there is."""
        return self.rho == self.theta

    @property
    def numbers(self) -> int:
        """Number of estimated parameters; a rho of 0 or 1 and a theta of 0 or 1 are edges, not estimates."""
        return len(self.taps) + (0 if self.cancels else (0.0 < self.rho < 1.0) + (0.0 < self.theta < 1.0))

    @property
    def walks(self) -> bool:
        """True for a random walk: y then has no level of its own."""
        return self.rho == 1.0 and self.theta < 1.0

    @property
    def white(self) -> bool:
        """True where the residual is its own innovation."""
        return not any(self.taps) and self.cancels

    @property
    def kind(self) -> str:
        """One word or two for the noise: WHITE, AUTOREGRESSION, MEASURED (with measurement noise) or WALK."""
        if self.walks:
            return WALK
        if self.white:
            return WHITE
        return AUTOREGRESSION if self.cancels or self.theta == 0.0 else MEASURED

    @property
    def roots(self) -> tuple[complex, ...]:
        """Poles of A in the plane of z, the one nearest to the circle first; rho is not among them."""
        found = np.roots([1.0, *self.taps]) if self.taps else np.empty(0)
        return tuple(complex(z) for z in found[np.argsort(-np.abs(found), kind="stable")])

    @property
    def plain(self) -> tuple[FloatArray, float]:
        """Polynomial A (1 - rho q^-1), leading 1 included, and theta; without the pair where the two cancel."""
        polynomial = np.concatenate([[1.0], self.taps])
        return (polynomial, 0.0) if self.cancels else (np.convolve(polynomial, [1.0, -self.rho]), self.theta)


def resonance_of(noise: Noise, step: float) -> tuple[float, float] | None:
    """Period in the unit of `step` and coherence in cycles of the narrowest band of A; None at 1 cycle or less."""
    best: tuple[float, float] | None = None
    for root in noise.roots:
        angle, radius = float(np.angle(root)), abs(root)
        if 1e-9 < angle <= 2.0 * np.pi / _SHORTEST and 0.0 < radius < 1.0:
            coherence = -angle / (2.0 * np.pi * float(np.log(radius)))
            if coherence > 1.0 and (best is None or coherence > best[1]):
                best = (2.0 * np.pi / angle * step, coherence)
    return best
