"""Extra lag: one more first-order lag between valve and measurement.

Actuator, process and sensor lag are the same thing in u and y; only a measured position tells them apart.

Equation: G(s) = K e^{-L s} / ((T1 s + 1)(T2 s + 1)), T2 the second time constant. Source: docs/details.md, section 5;
exact discretisation in process/linear.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..process.linear import Dynamics
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_PARAMETER = Parameter("second_time_constant_s", "s", 0.0, 1e4, 0.0, "time constant of the further lag")


def _dynamics(dynamics: Dynamics, theta: FloatArray) -> Dynamics:
    return replace(dynamics, second_time_constant_s=theta[0])


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_PARAMETER, high=1.5 * max(context.period_s, 10.0 * context.step_s)),)


def _guess(context: Context) -> FloatArray:
    return context.step_s * np.array([[0.5], [2.0], [5.0]]) + context.period_s * np.array([[0.0], [0.02], [0.1]])


def _visible(scales: Scales) -> Values:
    return {"second_time_constant_s": 0.6 * scales.lag_s}


EFFECT = Effect(
    name="extra-lag", kind="T", place=Place.PROCESS,
    summary="one more first-order lag: actuator, process or sensor",
    equation="G(s) = K e^{-L s} / ((T1 s + 1)(T2 s + 1))",
    source="docs/details.md, section 5", parameters=(_PARAMETER,), limits=_limits, dynamics=_dynamics, guess=_guess,
    by_itself=True,
    visible=_visible,
    leaves={"stick": 1, "slip": 1, "cycle": 1, "setpoint": 3, "colour": 3, "valve": 1, "own line": 3, "dip": 2,
            "swing": 2},
    noun="a further lag of {second_time_constant_s}",
    sentence="The loop has one more lag of {second_time_constant_s}.",
    seen_over="direction",
    action="Look for the slow part, actuator, sensor or filter, and tune with this lag.",
    settled_by="the measured valve position: it tells a lag before the valve from one behind it",
    told_apart={
        "slew-limit":
            "two steps in manual of different size: a lag takes the same time for both, a slew limit longer for the "
            "larger",
        "slip-overshoot": "the measured valve position, sampled faster than the slip",
    },
)
