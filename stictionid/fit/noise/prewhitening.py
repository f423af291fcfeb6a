"""A model completed with an autoregression of its residual and refitted in prewhitened form, in its own basin.

Free-run errors of a right model under coloured noise are coloured. Least squares that take them for white find the
wrong process and, through it, the wrong slip jump. Local: the valve's basin is that of the given model. Source:
docs/details.md, section 6.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...model.model import Model
from ...model.segments import rebind_model
from ...model.spec import INTEGRATOR, Evaluated
from ...numerics.autoregression import filter_residual
from ...typing import BoolArray, FloatArray
from ..points.moves import descend_model, descend_values
from ..starts.basins import along_ridge, process_grid
from .bias_correction import noise_of
from .whiteness import passes_tests

# Largest order of the autoregression: disturbances of real plants remember more than 8 samples. Turns of noise and
# refit.
ORDER, _TURNS = 24, 4
# A descent has settled when the cost falls by less than this share: a tenth of a likelihood ratio on 1,000 samples.
SETTLE = 1e-4
# A further turn must lower the innovations to this share of their size before.
_WORTH = 0.999
# Ranks of the processes of a grid that are polished: neighbours of the best one would end where it does. Then the
# most neighbours under a held command.
STARTS, _RIDGE = (0, 3, 10), 3


@dataclass(frozen=True, slots=True)
class Whitened:
    """A model with its noise model: values (d,), its full run, innovations (n,) and the samples that count.

    `rmse` is the free-run error of the model before any noise model.
    """

    model: Model
    values: FloatArray
    evaluated: Evaluated
    rmse: float
    innovation: FloatArray
    good: BoolArray

    @property
    def innovation_sd(self) -> float:
        """Standard deviation of the innovations, in the unit of y."""
        return float(np.sqrt(np.mean(self.innovation[self.good] ** 2)))

    @property
    def white(self) -> bool:
        """True where the innovations pass every test for whiteness."""
        taps = self.model.spec.taps
        return passes_tests(self.model, np.concatenate([[1.0], taps]), len(taps), self.evaluated.position,
                            self.innovation, self.good)


def whiten_model(model: Model, values: FloatArray) -> Whitened:
    """A model at its optimum (d,), completed with the autoregression that its residual asks for, refitted with it."""
    def refit(best: Whitened, taps: tuple[float, ...]) -> tuple[Model, FloatArray]:
        white = rebind_model(model, replace(model.spec, taps=taps))
        start = white.cube(best.values[:, None])
        found = descend_model(white, np.concatenate([start, _starts_elsewhere(white, start[0])]), settle=SETTLE)
        return white, white.values(found.points[:1])[:, 0]

    return whiten_in_turns(whitened(model, values), refit)


def whiten_in_turns(first: Whitened, refit: Callable[[Whitened, tuple[float, ...]], tuple[Model, FloatArray]],
                    ) -> Whitened:
    """The autoregression of a residual, and a `refit` with these taps, in turns as long as the innovations fall.

    `rmse` stays that of the first model.
    """
    best = first
    for _ in range(_TURNS):
        # The autoregression of the free-run residual, in differences where the model is fitted in them.
        polynomial = np.array([1.0, -1.0]) if best.model.spec.increments else np.ones(1)
        taps = noise_of(best.model, best.evaluated, polynomial, ORDER)
        if np.array_equal(taps, best.model.spec.taps):
            break
        now = whitened(*refit(best, tuple(taps)))
        if now.innovation_sd > _WORTH * best.innovation_sd:
            break
        best = now
    return replace(best, rmse=first.rmse)


def _starts_elsewhere(white: Model, point: FloatArray) -> FloatArray:
    """Starts (k, d) with the valve of a point (d,) and another process, or another dead time and break-away.

    The free run may have taken a coloured disturbance for the process, from where no descent leads back.
    """
    points, costs = process_grid(white, point)
    found = points[np.argsort(costs, kind="stable")[list(STARTS)]]
    return found if not white.spec.held else np.concatenate([found, along_ridge(white, point[None])[:_RIDGE]])


def with_noise_of(w: Whitened, other: Whitened) -> Whitened:
    """A model refitted under the noise model of another one, where that predicts better: equal freedom for both."""
    taps, spec = np.asarray(other.model.spec.taps), w.model.spec
    if spec.increments != other.model.spec.increments or np.array_equal(taps, spec.taps):
        return w
    model = rebind_model(w.model, replace(spec, taps=tuple(taps)))
    now = whitened(model, descend_values(model, w.values[:, None], settle=SETTLE))
    return replace(now, rmse=w.rmse) if now.innovation_sd < w.innovation_sd else w


def without_noise(model: Model, values: FloatArray) -> float:
    """The free-run error (in the unit of y) of a model with a noise model, after a descent without that noise model.

    A first order is fitted in levels: differences, in which a walk is fitted, say nothing of them.
    """
    spec = replace(model.spec, taps=(), increments=model.spec.increments and model.spec.process == INTEGRATOR)
    white = rebind_model(model, spec)
    return white.evaluate(descend_values(white, values[:, None])).rmse


def whitened(model: Model, values: FloatArray) -> Whitened:
    """A model at values (d,) with the noise model that it has, without a search."""
    e = model.evaluate(values)
    polynomial = np.concatenate([[1.0], model.spec.whitening()])
    innovation, good = filter_residual(e.residual, e.counted > 0, polynomial, model.loop.starts)
    good &= ~model.starting(polynomial.size)
    return Whitened(model, values, e, e.rmse, innovation, good)
