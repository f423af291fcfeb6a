"""Leak at an integrator: the level regulates itself a little, as by an outflow that grows with the head.

An integrator with a leak is a first order with a long time constant, 1000 / leak seconds, and a second lag: in u and y
it can't be told from that. `diagnose` asks for it beside an integrator, whose fit has the slips and the lag already.
Where the time constant exceeds the record, the leak shows as no more than a drift of the level.

Equation: y' = K x - leak y / 1000, x the position behind lag and dead time; leak in 1 / (1000 s).
Source: self-regulating level, e.g. Shinskey, Process Control Systems, chapter 1; exact discretisation in
process/state_space.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..process.linear import Dynamics
from ..process.state_space import element_of
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_LEAK = Parameter("leak", "1 / (1000 s)", 0.0, 1e5, 0.0, "share of the level that leaks away in 1000 s")
# Largest leak, as a share of one that empties the level in a period. Unit: 1.
_MOST = 3.0


def _dynamics(dynamics: Dynamics, theta: FloatArray) -> Dynamics:
    if not theta[0].any():
        return dynamics
    one, rate = np.ones_like(theta[0]), 1e-3 * theta[0]
    # s / (s + rate) turns the integral into a lag of the same slope.
    return replace(dynamics, elements=(*dynamics.elements, element_of(np.stack([one, 0.0 * one]),
                                                                      np.stack([one, rate]))))


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_LEAK, high=_MOST * 1e3 / max(context.period_s, context.step_s)),)


def _guess(context: Context) -> FloatArray:
    return np.array([[1e3 / context.length_s], [1e3 / (3.0 * context.period_s)], [1e3 / context.period_s]])


def _visible(scales: Scales) -> Values:
    return {"leak": 200.0 / scales.lag_s}


EFFECT = Effect(
    name="leak", kind="T", place=Place.PROCESS,
    summary="the level of an integrator regulates itself a little",
    equation="y' = K x - leak y / 1000, x the position behind lag and dead time",
    source="self-regulating level, Shinskey, Process Control Systems, chapter 1", parameters=(_LEAK,),
    confused_with=("extra-lag",), needs=("integrator",), limits=_limits, dynamics=_dynamics,
    guess=_guess,
    visible=_visible,
    noun="a level that regulates itself",
    sentence="The level regulates itself at a rate of {leak}.",
    seen_over="y",
    action="Look for what drains the vessel by its level, such as a bypass or an overflow.",
    settled_by="a longer record with the valve at rest: the level returns to its own value, or does not",
    told_apart={
        "extra-lag": "a longer record with the valve at rest: the level returns to its own value, or does not",
    },
)
