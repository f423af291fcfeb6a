"""Slew limit: the actuator strokes no faster than its air supply allows.

Indistinguishable from an extra lag when every stroke is short.

Equation: |du_v/dt| <= rate. Source: rate-limited actuator, METHODS.md section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..kernels import kernel
from ..loop import FloatArray
from ..parameters import Parameter
from .contract import Context, Effect, Place

_RATE = Parameter("rate", "% / s", 1e-3, 1e3, 1e3, "fastest stroke", log=True)


@kernel
def _run(signal, y, theta, part_s, state, out):
    rows, lanes = signal.shape
    for k in range(rows):
        for p in range(lanes):
            reach = theta[0, p] * part_s
            move = signal[k, p] - state[0, p]
            move = min(max(move, -reach), reach)
            state[0, p] += move
            out[k, p] = state[0, p]


def _start(signal: FloatArray, theta: FloatArray) -> FloatArray:
    return signal[:1].copy()


def _limits(context: Context) -> tuple[Parameter, ...]:
    # Faster than the whole swing within a quarter of a sample shows nowhere; slower than it in a period is no valve.
    high = 8.0 * context.s_max / context.step_s
    return (replace(_RATE, low=max(0.5 * context.s_max / context.period_s, 1e-6), high=high, neutral=high),)


def _guess(context: Context) -> FloatArray:
    return context.s_max / context.step_s * np.array([[0.05], [0.2], [0.6]])


EFFECT = Effect(
    name="slew-limit", kind="T", place=Place.STEM,
    summary="the actuator strokes no faster than its air supply allows",
    equation="|du_v/dt| <= rate", source="METHODS.md section 5", parameters=(_RATE,), confused_with=("extra-lag",),
    fine=True, states=1, limits=_limits, run=_run, start=_start, guess=_guess,
)
