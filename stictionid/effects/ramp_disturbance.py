"""Ramp disturbance: the sensor or the load drifts from a certain time on.

The start is searched, the rate is linear. Can't be told from a random walk, or a step, when small.

Equation: d(t) = rate (t - start_s) for t >= start_s. Source: docs/details.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Disturbance, Effect, Place, Scales, Values

_START = Parameter("start_s", "s", 0.0, 1e9, 0.0, "when the drift begins")
_RATE = Parameter("rate", "unit of y / s", -1e6, 1e6, 0.0, "drift (in % of travel / s at the load)")
_STARTS = 12


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_START, high=0.95 * context.length_s),)


def _columns(theta: FloatArray, context: Context) -> tuple[FloatArray, ...]:
    return (np.maximum(context.time_s[:, None] - theta[0], 0.0) / context.length_s,)


def _guess(context: Context) -> FloatArray:
    return np.linspace(0.0, 0.9, _STARTS)[:, None] * context.length_s


def _report(searched: Values, sizes: FloatArray, base: Values) -> dict[str, float]:
    return {"start_s": searched["start_s"], "rate": float(sizes[0]) / base["length_s"]}


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    ramp = values["rate"] * np.maximum(time_s - values["start_s"], 0.0)
    return (np.zeros_like(ramp), ramp, {}) if values.get("load") else (ramp, np.zeros_like(ramp), {})


def _visible(scales: Scales) -> Values:
    return {"start_s": 0.3 * scales.length_s, "rate": 0.5 * scales.swing / scales.length_s}


EFFECT = Effect(
    name="ramp-disturbance", kind="L", place=Place.DISTURBANCE,
    summary="the sensor or the load drifts from a certain time on",
    equation="d(t) = rate (t - start_s) for t >= start_s, at the output or at the load",
    source="docs/details.md, section 5", parameters=(_START, _RATE), searched=("start_s",), variants=("output", "load"),
    confused_with=("step-disturbance", "random-walk-disturbance"), limits=_limits, columns=_columns, guess=_guess,
    report=_report, disturb=_disturb,
    visible=_visible,
    leaves={"level": 2, "stretch": 3},
    noun="a drift from {start_s} on",
    sentence="From {start_s} on the sensor or the load drifts by {rate}.",
    seen_over="time",
    action="Check the sensor's zero and the load from {start_s} on.",
    of_record=("start_s", "rate"),
    settled_by="a tag of the suspected load, or a check of the sensor's zero",
    told_apart={
        "step-disturbance": "a longer record after the change",
        "random-walk-disturbance": "a longer record, or the loop in manual for a while",
    },
)
