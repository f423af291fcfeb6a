"""Valve characteristic: flow is not proportional to travel (equal percentage, or its mirror image, quick opening).

Over a short travel it can't be told from a process gain that changes with y.

Equation: 100 (R^{x/100} - 1)/(R - 1), ln R = log_rangeability; for ln R < 0 the mirror image. Source: equal-percentage
trim, docs/details.md, section 5.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import kernel
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_CURVE = Parameter("log_rangeability", "-", -6.0, 6.0, 0.0, "ln R; 0 is linear, negative quick opening")


@kernel
def _run(signal: FloatArray, y: FloatArray, theta: FloatArray, part_s: float, state: FloatArray,
         out: FloatArray) -> None:
    rows, lanes = signal.shape
    # (e^{ax} - 1)/(e^a - 1) for negative a is the mirror image of the positive one.
    scale = np.empty(lanes)
    for p in range(lanes):
        scale[p] = 0.0 if abs(theta[0, p]) < 1e-9 else 100.0 / np.expm1(theta[0, p])
    for k in range(rows):
        for p in range(lanes):
            x = signal[k, p]
            # A valve that sticks keeps its position for most of a record.
            if k > 0 and x == signal[k - 1, p]:
                out[k, p] = out[k - 1, p]
            else:
                out[k, p] = x if scale[p] == 0.0 else scale[p] * np.expm1(theta[0, p] * 0.01 * x)


def _guess(context: Context) -> FloatArray:
    return np.array([[-3.0], [-1.0], [1.0], [3.0]])


def _visible(scales: Scales) -> Values:
    return {"log_rangeability": 3.5}


EFFECT = Effect(
    name="valve-characteristic", kind="T", place=Place.TRIM,
    summary="flow is not proportional to travel",
    equation="100 (R^{x/100} - 1)/(R - 1), ln R = log_rangeability",
    source="docs/details.md, section 5", parameters=(_CURVE,), confused_with=("gain-nonlinearity",), run=_run,
    guess=_guess,
    visible=_visible,
    leaves={"slide": 2, "direction": 3, "output": 2, "value": 2, "setpoint": 4, "valve": 4},
    noun="a curved valve characteristic",
    sentence="Flow is not proportional to travel: the logarithm of the trim's rangeability is {log_rangeability}.",
    seen_over="travel",
    action="Straighten the characteristic in the positioner or behind the controller's output.",
    settled_by="steps in manual at both ends of the range",
)
