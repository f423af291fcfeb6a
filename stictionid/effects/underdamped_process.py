"""Underdamped process: the process rings after a step, as a manometer or a closed inner loop does.

The lag of the base, time constant T1, becomes a second order: T1 stays the coefficient of s, so a natural period of 0
is the plain lag, and periods below pi T1 are two lags in series. Damping follows as pi T1 / natural_period_s; it is a
parameter of its own in a simulation only.

Beside a cycle of nearly the natural period it can't be told from a sine at the output. A process that rings because
another controller swings needs the record of that loop.

Equation: G(s) = K e^{-L s} / (tau^2 s^2 + T1 s + 1), tau = natural_period_s / (2 pi), damping = T1 / (2 tau).
Source: second-order system, e.g. Seborg, Edgar, Mellichamp, Process Dynamics and Control, section 5.4; exact
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

_PERIOD = Parameter("natural_period_s", "s", 0.0, 1e6, 0.0, "natural period of the process")
_DAMPING = Parameter("damping", "-", 0.0, 10.0, 0.0, "damping; 0 in a simulation takes that of the time constant")
# Shortest tau as a share of T1: the second lag is then a millionth of the first. Longest natural period in periods.
_SHORTEST, _LONGEST = 1e-3, 1.5
# Starting natural periods as shares of the period of the cycle, and in samples.
_SHARES, _SAMPLES = np.array([0.2, 0.45, 0.9]), np.array([6.0, 15.0, 40.0])


def _dynamics(dynamics: Dynamics, theta: FloatArray) -> Dynamics:
    if not theta[0].any():
        return dynamics
    T = dynamics.time_constant_s
    tau = np.maximum(theta[0] / (2.0 * np.pi), _SHORTEST * T)
    one = np.ones_like(tau)
    element = element_of(np.stack([0.0 * one, 0.0 * one, one]), np.stack([tau * tau, T, one]))
    return replace(dynamics, time_constant_s=np.zeros_like(T), elements=(*dynamics.elements, element))


def _plant(values: Values, dynamics: Dynamics) -> Dynamics:
    if values["damping"] > 0.0:
        T = dynamics.time_constant_s
        dynamics = replace(dynamics, time_constant_s=np.full_like(T, values["damping"] * values["natural_period_s"]
                                                                  / np.pi))
    return _dynamics(dynamics, np.array([[values["natural_period_s"]]]))


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_PERIOD, high=_LONGEST * max(context.period_s, 10.0 * context.step_s)),)


def _guess(context: Context) -> FloatArray:
    high = _limits(context)[0].high
    periods = np.concatenate([_SHARES * context.period_s, _SAMPLES * context.step_s])
    return np.asarray(np.minimum(periods, high)[:, None], dtype=np.float64)


def _report(searched: Values, sizes: FloatArray, base: Values) -> dict[str, float]:
    period = searched["natural_period_s"]
    return {"natural_period_s": period, "damping": np.pi * base["time_constant_s"] / max(period, 1e-9)}


def _visible(scales: Scales) -> Values:
    return {"natural_period_s": 4.0 * scales.lag_s, "damping": 0.35}


EFFECT = Effect(
    name="underdamped-process", kind="T", place=Place.PROCESS,
    summary="the process rings after a step",
    equation="G(s) = K e^{-L s} / (tau^2 s^2 + T1 s + 1), tau = natural_period_s / (2 pi), damping = T1 / (2 tau)",
    source="second-order system, Seborg, Edgar, Mellichamp, section 5.4", parameters=(_PERIOD, _DAMPING),
    searched=("natural_period_s",), confused_with=("extra-lag", "sinusoidal-disturbance"), limits=_limits,
    dynamics=_dynamics, plant=_plant, guess=_guess, report=_report,
    visible=_visible,
    leaves={"stick": 4, "cycle": 5, "valve": 6, "swing": 1},
    noun="a process that rings every {natural_period_s}",
    sentence="The process itself rings every {natural_period_s}, with a damping of {damping}.",
    seen_over="phase",
    action="Keep the controller slower than the ringing, or damp the process.",
    settled_by="a step in manual: a process that rings swings about its new value while the valve rests",
    told_apart={
        "sinusoidal-disturbance":
            "the loop in manual: a process that rings comes to rest, an oscillation from elsewhere goes on",
        "extra-lag": "a step in manual: two lags creep to the new value, a process that rings overshoots it",
    },
)
