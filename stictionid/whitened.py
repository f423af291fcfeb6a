"""A model completed with the noise that its residual asks for: autoregression, refitted in prewhitened form.

Free run errors of a right model under coloured noise are coloured; least squares that take them for white find the
wrong process and, through it, the wrong slip jump. Local: the valve's basin is that of the model handed in.
Source: METHODS.md section 4, trap 2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .descent import descend
from .fit import movable
from .loop import BoolArray, FloatArray
from .model import Model
from .noise import autoregression

ORDER, TURNS = 8, 4
# A further turn must lower the innovations to this share of what they were.
WORTH = 0.999


@dataclass(frozen=True, slots=True)
class Whitened:
    """A model with its noise: its values (d,), free-run error, and innovations (n,) with the samples that count."""

    model: Model
    values: FloatArray
    rmse: float
    innovation: FloatArray
    good: BoolArray
    order: int

    @property
    def innovation_sd(self) -> float:
        """Standard deviation of the innovations, in the unit of y."""
        return float(np.sqrt(np.mean(self.innovation[self.good] ** 2)))


def whitened(model: Model, values: FloatArray) -> Whitened:
    """A model at its optimum (d,), completed with the autoregression that its residual asks for, refitted with it."""
    best = with_taps(model, values, np.asarray(model.spec.taps))
    rmse = best.rmse
    for _ in range(TURNS):
        taps = noise_taps(best)
        if np.array_equal(taps, best.model.spec.taps):
            break
        white = Model(model.loop, replace(model.spec, taps=tuple(taps)), s_max=model.s_max, period_s=model.period_s)
        found = descend(white.residuals, white.costs, white.cube(best.values[:, None]), spread=1e-3 * movable(white))
        now = with_taps(white, white.values(found.points[:1])[:, 0], taps)
        if now.innovation_sd > WORTH * best.innovation_sd:
            break
        best = now
    return replace(best, rmse=rmse)


def noise_taps(w: Whitened) -> FloatArray:
    """Autoregression of the free-run residual, in differences where the model is fitted in them."""
    e = w.model.evaluate(w.values)
    residual, good = np.nan_to_num(e.residual), e.counted > 0
    if w.model.spec.increments:
        residual = np.diff(residual, prepend=residual[0])
        good = good & np.roll(good, 1)
    return autoregression(residual, good, ORDER)


def with_taps(model: Model, values: FloatArray, taps: FloatArray) -> Whitened:
    """A model's values (d,) with given taps (p,), as they are."""
    e = model.evaluate(values)
    polynomial = np.concatenate([[1.0], taps])
    if model.spec.increments:
        polynomial = np.convolve(polynomial, [1.0, -1.0])
    residual = np.nan_to_num(e.residual)
    innovation = np.convolve(residual, polynomial)[:residual.size]
    counted = e.counted > 0
    good = counted.copy()
    for lag in range(1, polynomial.size):
        good[lag:] &= counted[:-lag]
    good[:model.skip + polynomial.size] = False
    return Whitened(model, values, e.rmse, innovation, good, taps.size)
