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

# Slowest rate, in swings of the command a period; guesses from the first number of swings a period to the second a
# sample.
_SLOWEST, _GUESSED, _GUESSES = 0.1, (0.5, 0.6), 5
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
    # Faster than the whole swing of the command within a quarter of a sample shows nowhere. A valve that can't keep up
    # makes the loop swing ever wider: one was met that strokes less than a quarter of that in half a period.
    high = 8.0 * context.s_max / context.step_s
    return (replace(_RATE, low=max(_SLOWEST * context.s_max / context.period_s, 1e-6), high=high, neutral=high),)


def _guess(context: Context) -> FloatArray:
    # From a stroke that takes the period to one within two samples: which it is depends on how fast the samples are.
    slow, fast = _GUESSED[0] / context.period_s, _GUESSED[1] / context.step_s
    return context.s_max * np.geomspace(min(slow, fast), fast, _GUESSES)[:, None]


EFFECT = Effect(
    name="slew-limit", kind="T", place=Place.STEM,
    summary="the actuator strokes no faster than its air supply allows",
    equation="|du_v/dt| <= rate", source="METHODS.md section 5", parameters=(_RATE,), confused_with=("extra-lag",),
    fine=True, states=1, limits=_limits, run=_run, start=_start, guess=_guess,
)
