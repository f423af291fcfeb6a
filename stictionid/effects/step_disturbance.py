"""Step disturbance: the process value, or the load, shifts once.

The time is searched, the size is linear. At the output it shifts y at once; a load step enters through the process,
like the valve. A small one can't be told from a ramp or a random walk.

Equation: d(t) = size for t >= time_s. Source: docs/details.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Disturbance, Effect, Place, Scales, Values

_TIME = Parameter("time_s", "s", 0.0, 1e9, 0.0, "when the step happens")
_SIZE = Parameter("size", "unit of y", -1e9, 1e9, 0.0, "size of the step (in % of travel at the load)")
_TIMES = 24
# Number of the largest jumps of the residual that are tried as well. Where changes of y are fitted (integrators), a
# step shows in the one sample at which it happens.
_JUMPS = 4


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_TIME, low=0.02 * context.length_s, high=0.98 * context.length_s,
                    neutral=0.98 * context.length_s),)


def _columns(theta: FloatArray, context: Context) -> tuple[FloatArray, ...]:
    # The sample during which the step happens gets its share, so that the cost is continuous in the time.
    return (np.clip((context.time_s[:, None] - theta[0]) / context.step_s + 1.0, 0.0, 1.0),)


def _guess(context: Context) -> FloatArray:
    times = np.linspace(0.04, 0.96, _TIMES) * context.length_s
    if context.residual is not None:
        jumps = np.abs(np.diff(context.residual))
        # Jumps that stand out of their neighbours; the remainder of an unknown start changes in all samples.
        alone = jumps[1:-1] - 0.5 * (jumps[:-2] + jumps[2:])
        times = np.append(times, context.time_s[2 + np.argsort(-alone)[:_JUMPS]])
    return times[:, None]


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    step = np.where(time_s >= values["time_s"], values["size"], 0.0)
    return (np.zeros_like(step), step, {}) if values.get("load") else (step, np.zeros_like(step), {})


def _visible(scales: Scales) -> Values:
    return {"time_s": 0.5 * scales.length_s, "size": 0.2 * scales.swing}


EFFECT = Effect(
    name="step-disturbance", kind="L", place=Place.DISTURBANCE,
    summary="the process value or the load shifts once",
    equation="d(t) = size for t >= time_s, at the output or at the load", source="docs/details.md, section 5",
    parameters=(_TIME, _SIZE), searched=("time_s",), variants=("output", "load"),
    confused_with=("ramp-disturbance", "random-walk-disturbance"), limits=_limits, columns=_columns, guess=_guess,
    disturb=_disturb,
    visible=_visible,
    leaves={"level": 1, "stretch": 2, "stick": 2},
    noun="a shift at {time_s}",
    sentence="At {time_s} the sensor or the load shifts once, by {size}.",
    seen_over="time",
    action="Look up what was switched or fed at {time_s}.",
    of_record=("time_s", "size"),
    settled_by="a tag of the suspected load, read with --extra",
)
