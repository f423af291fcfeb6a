"""Gain drift: the process gain changes steadily with time, as by fouling, a sinking supply pressure or a new grade.

The gain of the study is that at the start of the record; the drift is relative to it. The position counts from its
mean, and what another reference would do to the level is a ramp, whose size is linear. Where the controller moves the
valve little, a change of the gain can't be told from a drift of the stickband.

Equation: K(t) = K (1 + drift t / 100,000), drift in % per 1000 s; y gets level_drift t / 1000 beside it.
Source: time-varying gain, e.g. heat-exchanger fouling, Shinskey, Process Control Systems, chapter 2.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.jit import kernel
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Disturbance, Effect, Place, Scales, Values

_DRIFT = Parameter("drift", "% / 1000 s", -1e6, 1e6, 0.0, "change of the gain, relative to that at the start")
_LEVEL = Parameter("level_drift", "unit of y / 1000 s", -1e9, 1e9, 0.0, "drift of the level that goes with it")
# Largest fall and rise of the gain over a record. Unit: 1.
_FALL, _RISE = -0.9, 4.0
# Smallest gain, as a share of that at the start. Unit: 1.
_LEAST = 0.05


@kernel
def _run(signal: FloatArray, time_s: FloatArray, theta: FloatArray, part_s: float, state: FloatArray,
         out: FloatArray) -> None:
    rows, lanes = signal.shape
    for k in range(rows):
        for p in range(lanes):
            share = max(1.0 + theta[0, p] * time_s[k, p] * 1e-5, _LEAST)
            out[k, p] = state[0, p] + (signal[k, p] - state[0, p]) * share


def _start(signal: FloatArray, theta: FloatArray) -> FloatArray:
    """Mean of the position; one row starts a simulation."""
    return np.asarray(signal.mean(axis=0)[None], dtype=np.float64)


def _columns(theta: FloatArray, context: Context) -> tuple[FloatArray, ...]:
    return ((1e-3 * context.time_s)[:, None].repeat(theta.shape[1], axis=1),)


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_DRIFT, low=_FALL * 1e5 / context.length_s, high=_RISE * 1e5 / context.length_s),)


def _guess(context: Context) -> FloatArray:
    return np.array([[-0.6], [-0.3], [0.4], [1.2]]) * 1e5 / context.length_s


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    ramp = values["level_drift"] * 1e-3 * time_s
    return ramp, np.zeros_like(ramp), {}


def _visible(scales: Scales) -> Values:
    return {"drift": -40_000.0 / scales.length_s}


EFFECT = Effect(
    name="gain-drift", kind="L", place=Place.PROCESS,
    summary="the process gain changes steadily with time",
    equation="K(t) = K (1 + drift t / 100,000), with level_drift t / 1000 beside it",
    source="time-varying gain, Shinskey, Process Control Systems, chapter 2", parameters=(_DRIFT, _LEVEL),
    searched=("drift",), confused_with=("stiction-drift", "ramp-disturbance"),
    contains=("ramp-disturbance",), timed=True, states=1, limits=_limits,
    run=_run, start=_start, columns=_columns, guess=_guess, disturb=_disturb,
    visible=_visible,
    leaves={"stretch": 5, "drift": 1},
    noun="a process gain that drifts",
    sentence="The process gain changes by {drift}.",
    seen_over="time",
    action="Compare feed, pressure and load at both ends of the record.",
    settled_by="the same step in manual at the start and at the end of a shift: a gain that drifts gives other sizes",
    told_apart={
        "stiction-drift": "the measured valve position, or the same large step in manual early and late",
        "ramp-disturbance": "the same step in manual early and late: a ramp leaves its size alone",
    },
)
