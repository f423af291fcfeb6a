"""Inverse response: the process value first goes the wrong way, as a boiler's level or a reboiler's temperature does.

Two opposing paths, a fast weak one and a slow strong one, make a zero in the right half plane. A second lag belongs to
it: without one the process value would jump. A small zero beside a dead time can't be told from a longer dead time,
and a zero of no size leaves an extra lag.

Equation: G(s) = K e^{-L s} (1 - zero_s s) / ((T1 s + 1)(lag_s s + 1)).
Source: right-half-plane zero, e.g. Seborg, Edgar, Mellichamp, Process Dynamics and Control, section 6.1; exact
discretisation in process/state_space.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..process.linear import Dynamics
from ..process.state_space import element_of
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_ZERO = Parameter("zero_s", "s", 0.0, 1e5, 0.0, "time constant of the zero: how long the response goes the wrong way")
_LAG = Parameter("lag_s", "s", 0.0, 1e5, 0.0, "time constant of the second lag")
# Shortest second lag of an inverse response, in samples; the jump of a shorter one falls between two samples.
_SHORTEST = 0.05
# Starting values as shares of the period, zero and lag.
_GUESSES = np.array([[0.02, 0.02], [0.05, 0.03], [0.05, 0.1], [0.12, 0.06], [0.12, 0.2]])


def _dynamics(dynamics: Dynamics, theta: FloatArray) -> Dynamics:
    zero, lag = theta
    if not (zero.any() or lag.any()):
        return dynamics
    one = np.ones_like(lag)
    # Without a lag the element would differentiate; a lag that is tiny beside the zero stands for none.
    lag = np.maximum(lag, np.maximum(1e-3 * zero, 1e-9))
    return replace(dynamics, elements=(*dynamics.elements, element_of(np.stack([-zero, one]), np.stack([lag, one]))))


def _limits(context: Context) -> tuple[Parameter, ...]:
    high = max(context.period_s, 10.0 * context.step_s)
    return (replace(_ZERO, high=high), replace(_LAG, low=_SHORTEST * context.step_s, high=1.5 * high,
                                               neutral=_SHORTEST * context.step_s))


def _guess(context: Context) -> FloatArray:
    return np.maximum(_GUESSES * context.period_s, _SHORTEST * context.step_s)


def _visible(scales: Scales) -> Values:
    return {"zero_s": 0.4 * scales.lag_s, "lag_s": 0.4 * scales.lag_s}


EFFECT = Effect(
    name="inverse-response", kind="T", place=Place.PROCESS,
    summary="the process value first goes the wrong way",
    equation="G(s) = K e^{-L s} (1 - zero_s s) / ((T1 s + 1)(lag_s s + 1))",
    source="right-half-plane zero, Seborg, Edgar, Mellichamp, section 6.1", parameters=(_ZERO, _LAG),
    confused_with=("extra-lag",), limits=_limits, dynamics=_dynamics, guess=_guess,
    visible=_visible,
    leaves={"slip": 5, "valve": 7, "dip": 1},
    noun="a response that starts the wrong way",
    sentence="PV first goes the wrong way, with a time constant of {zero_s}.",
    seen_over="direction",
    action="Tune for the wrong-way response: a lower gain and no derivative action.",
    settled_by="a step in manual: the process value first goes the wrong way",
    told_apart={
        "extra-lag": "a step in manual, sampled faster than the dead time: the first move tells",
    },
)
