"""Gain nonlinearity: the process gain changes with the process value.

The position's distance from its mean is multiplied by 1 + curvature (y - mean SP), so that K stays linear. y is the
model's own, at the time when the move arrives (one dead time after the valve made it). An error in the mean only
changes gain and time constant. Over a short travel it can't be told from a curved valve characteristic.

A disturbance at the output is part of that y where it acts on the process. It is not where it acts behind the process,
like a shift of the sensor. A fit takes the reading that explains the record better; a simulation takes the first.

A valve that hardly leaves one side of its mean shows no curvature, so there the gain stays constant. The reason: a
search follows the measured y, and a resting valve's distance times that y would predict y from itself.

Equation: K(y) = K (1 + curvature (y - mean SP)). Source: docs/details.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.jit import kernel
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_CURVATURE = Parameter("curvature", "1 / unit of y", -10.0, 10.0, 0.0, "relative change of the gain")
# Lower limit of the factor on the gain, as a share of the mean gain; the gain keeps its sign. Unit: 1.
_LEAST = 0.05
# The valve must be on either side of its mean for this share of the record. Unit: 1.
_EITHER_SIDE = 0.1
# Share of the record over which the gain changes by at most four fifths; it sets the limits of the curvature. Unit: 1.
_MOST = 0.9


@kernel
def _run(signal: FloatArray, y: FloatArray, theta: FloatArray, part_s: float, state: FloatArray,
         out: FloatArray) -> None:
    rows, lanes = signal.shape
    for k in range(rows):
        for p in range(lanes):
            stretch = max(1.0 + theta[0, p] * state[1, p] * y[k, p], _LEAST)
            out[k, p] = state[0, p] + (signal[k, p] - state[0, p]) * stretch


def _start(signal: FloatArray, theta: FloatArray) -> FloatArray:
    """Mean of the position, and 1 where the valve moves enough for the effect, else 0; one row starts a simulation."""
    mean, rows = signal.mean(axis=0), len(signal)
    above = _above(signal, mean)
    felt = (np.minimum(above, rows - above) >= _EITHER_SIDE * rows) if rows > 1 else np.ones(signal.shape[1])
    return np.stack([mean, felt])


@kernel
def _above(signal: FloatArray, mean: FloatArray) -> FloatArray:
    """Number of rows of each lane that are above its mean (P,)."""
    rows, lanes = signal.shape
    count = np.zeros(lanes)
    for k in range(rows):
        for p in range(lanes):
            count[p] += 1.0 if signal[k, p] > mean[p] else 0.0
    return count


def _reach(context: Context) -> float:
    """Distance of y from the reference of gains that most of the record keeps; short excursions may exceed it."""
    away = np.abs(context.process_value - context.centre)
    return float(np.quantile(away, _MOST)) or float(away.max()) or 1.0


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_CURVATURE, low=-0.8 / _reach(context), high=0.8 / _reach(context)),)


def _guess(context: Context) -> FloatArray:
    return np.array([[-0.5], [-0.15], [0.15], [0.5]]) / _reach(context)


def _visible(scales: Scales) -> Values:
    return {"curvature": 0.75 / scales.swing}


EFFECT = Effect(
    name="gain-nonlinearity", kind="T", place=Place.PROCESS,
    summary="the process gain changes with the process value",
    equation="K(y) = K (1 + curvature (y - mean SP))",
    source="docs/details.md, section 5", parameters=(_CURVATURE,), confused_with=("valve-characteristic",),
    follows_y=True,
    states=2,
    limits=_limits, run=_run, start=_start, guess=_guess,
    visible=_visible,
    leaves={"output": 3, "value": 1, "setpoint": 1, "valve": 3, "own line": 4},
    noun="a process gain that changes with PV",
    sentence="The process gain changes with PV, by {curvature} of itself.",
    seen_over="y",
    action="Schedule the controller gain on PV, or tune for the largest gain.",
    settled_by="setpoint moves to both ends of the range",
    told_apart={
        "valve-characteristic":
            "setpoint moves that carry OP over more than 15 %: then the error follows the valve or the PV, not both",
        "travel-limit": "a step in manual beyond the suspected limit: a limited valve moves no further",
    },
)
