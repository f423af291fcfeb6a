"""Sinusoidal disturbance: a steady oscillation from elsewhere in the plant adds to the process value.

The period is searched, amplitude and phase are linear. Can't be told from the limit cycle itself when the loop is
entrained (both then have one period).

Equation: d(t) = amplitude sin(2 pi t / period_s + phase). Source: docs/details.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.jit import kernel
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Disturbance, Effect, Place, Scales, Values

_PERIOD = Parameter("period_s", "s", 1e-3, 1e7, 60.0, "period of the disturbance", log=True)
_AMPLITUDE = Parameter("amplitude", "unit of y", 0.0, 1e9, 0.0, "amplitude at the output")
_PHASE = Parameter("phase", "rad", -7.0, 7.0, 0.0, "phase at the start of the record")
_LINES = 8
# Shares of the oscillation's period at which the smallest amplitude that shows is asked for; none is a harmonic.
_TRIED = np.array([0.23, 0.37, 0.61, 0.83, 1.7])
# Rows after which the waves are computed anew. Unit: samples.
_ANEW = 64


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_PERIOD, low=2.5 * context.step_s, high=context.length_s, neutral=context.length_s),)


@kernel
def _waves(turn: FloatArray, first: float, sine: FloatArray, cosine: FloatArray) -> None:
    """Sine and cosine of first + k turns by rotation from row to row, computed anew every _ANEW rows against drift."""
    rows, lanes = sine.shape
    a, b = np.cos(turn), np.sin(turn)
    for k in range(rows):
        if k % _ANEW == 0:
            for p in range(lanes):
                sine[k, p] = np.sin((first + k) * turn[p])
                cosine[k, p] = np.cos((first + k) * turn[p])
        else:
            for p in range(lanes):
                sine[k, p] = sine[k - 1, p] * a[p] + cosine[k - 1, p] * b[p]
                cosine[k, p] = cosine[k - 1, p] * a[p] - sine[k - 1, p] * b[p]


def _columns(theta: FloatArray, context: Context) -> tuple[FloatArray, ...]:
    sine, cosine = (np.empty((context.process_value.size, theta.shape[1])) for _ in range(2))
    _waves(2.0 * np.pi * context.step_s / theta[0], context.start_s / context.step_s, sine, cosine)
    return sine, cosine


def _guess(context: Context) -> FloatArray:
    """Periods of the strongest lines in the residual's spectrum, then that in y.

    Any linear loop answers a sine as if it were its own: a process that took the sine leaves no line of it.
    """
    y = context.process_value
    signal = np.zeros(y.size) if context.residual is None else np.nan_to_num(context.residual)
    return np.array(_lines(signal, _LINES - 1) + _lines(y, 1))[:, None] * context.step_s


def _lines(signal: FloatArray, count: int) -> list[float]:
    """Periods in samples of the strongest lines in a signal (n,)."""
    n = signal.size
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(n), 4 * n)) ** 2
    spectrum[:8] = 0.0
    found = []
    for _ in range(count):
        k = int(spectrum.argmax())
        found.append(4 * n / max(k, 1))
        spectrum[max(k - 8, 0):k + 9] = 0.0
    return found


def _report(searched: Values, sizes: FloatArray, base: Values) -> dict[str, float]:
    return {"period_s": searched["period_s"], "amplitude": float(np.hypot(*sizes)),
            "phase": float(np.arctan2(sizes[1], sizes[0]))}


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    wave = values["amplitude"] * np.sin(2.0 * np.pi * time_s / values["period_s"] + values["phase"])
    return wave, np.zeros_like(time_s), {}


def _tried_at(context: Context) -> FloatArray:
    return _TRIED * context.period_s


def _visible(scales: Scales) -> Values:
    return {"period_s": 6.0 * scales.lag_s, "amplitude": 0.1 * scales.swing}


EFFECT = Effect(
    name="sinusoidal-disturbance", kind="L", place=Place.DISTURBANCE,
    summary="a steady oscillation from elsewhere adds to the process value",
    equation="d(t) = amplitude sin(2 pi t / period_s + phase)", source="docs/details.md, section 5",
    parameters=(_PERIOD, _AMPLITUDE, _PHASE), searched=("period_s",), limits=_limits, columns=_columns, guess=_guess,
    report=_report, disturb=_disturb,
    visible=_visible, tried_at=_tried_at,
    leaves={"stick": 3, "colour": 4, "own line": 1, "line": 1},
    noun="an oscillation of {period_s} from outside",
    sentence="An oscillation of {period_s} from outside moves PV by {amplitude} either way.",
    seen_over="phase",
    action="Look for the loop or the machine that swings every {period_s}.",
    of_record=("phase",),
    settled_by="the loop in manual: an oscillation from elsewhere goes on",
)
