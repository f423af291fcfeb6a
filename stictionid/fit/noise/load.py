"""Noise ahead of the process of a completed model: its autoregression beside the model's own prewhitening.

The process is that of the model, whatever its shape: its response to a pulse of the load is run, not derived. A load
with a root of 1 walks. One unit root in all is taken out by differences of y, that of an integrator or that of a load
that walks; without differences there is none. Wrong where PV is missing: no load noise is fitted there.
Source: docs/details.md, section 7.
"""

from __future__ import annotations

import numpy as np

from ...model.model import Model
from ...model.spec import INTEGRATOR, Evaluated
from ...numerics.autoregression import filter_residual, predicted_covariance
from ...numerics.noise.load import LARGEST_ORDER, ROOTS, WALK, LoadNoise, fit_load
from ...process.linear import free_run
from ...typing import BoolArray, FloatArray

# The name of this noise in an effect's file.
LOAD = "load"
# Samples of the response to a pulse. Unit: samples; a lag of a fifth of that has decayed.
_SAMPLES = 4096


def load_noise_of(model: Model, values: FloatArray, signal: FloatArray, good: BoolArray, own: FloatArray, *,
                  increments: bool) -> LoadNoise | None:
    """The load noise of a `signal` (n,): the residual of values (d,), passed through the polynomial `own` (differences
    included). None where the process has another number of unit roots than differences take out, or PV is missing.
    """
    integrates = model.spec.process == INTEGRATOR
    if any(piece.links is not None for piece in model.pieces) or (integrates and not increments):
        return None
    power = load_power(model, values)
    # (the sums of a polynomial are that polynomial over a difference)
    stationary = np.cumsum(own)[:-1] if increments else own
    power = power * np.abs(np.fft.rfft(stationary, 2 * (power.size - 1))) ** 2
    covariance = predicted_covariance(signal, good, LARGEST_ORDER, model.loop.starts)
    return fit_load(covariance, float(good.sum()), power, own, WALK if increments and not integrates else ROOTS)


def residual_load(model: Model, evaluated: Evaluated, increments: bool) -> LoadNoise | None:
    """The load noise of a model's free-run residual, in levels or in differences; None where there can be none."""
    own = np.array([1.0, -1.0]) if increments else np.ones(1)
    residual = model.take_out_landings(np.nan_to_num(evaluated.residual))
    signal, good = filter_residual(residual, evaluated.counted > 0, own, model.loop.starts)
    return load_noise_of(model, model.vector(evaluated.values), signal, good, own, increments=increments)


def step_response(model: Model, values: FloatArray, samples: int) -> FloatArray:
    """Response (samples,) of y, per unit of gain, to a load that steps by 1 % of travel at the first sample."""
    step = np.ones((samples + 1, 1))
    step[0] = 0.0
    return free_run(step, model.dynamics(values[:, None]), step_s=model.step_s)[1:, 0]


def load_power(model: Model, values: FloatArray) -> FloatArray:
    """Squared response (m,) of y, per unit of gain, to white noise ahead of the process; of its increments for an
    integrator."""
    pulse = np.diff(step_response(model, values, _SAMPLES), prepend=0.0)
    if model.spec.process == INTEGRATOR:
        pulse = np.diff(pulse, prepend=0.0)
    return np.abs(np.fft.rfft(pulse)) ** 2
