"""Random load steps: the load shifts at random times and stays, as where feeds, users or grades change.

The name holds the times in seconds, "random-load-steps:120+431"; the sizes are linear. A search finds the times in the
innovations of a model without them (fit/noise/load_steps.py). A load that shifts in most samples is `load-noise`.

Equation: y gets G(s) d, d(t) = sum of size_i for t >= time_i; in a simulation times of a Poisson process and normal
sizes. Source: compound Poisson load, docs/details.md, section 7.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..errors import UsageError
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import BY_HAND, MOST_TIMES, Context, Disturbance, Effect, Place, Scales, Values, times_in

_INTERVAL = Parameter("interval_s", "s", 1e-3, 1e9, 1e9, "mean time between two steps")
_SIZE = Parameter("size", "unit of y", 0.0, 1e9, 0.0, "root mean square of a step (in % of travel in a simulation)")


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    step_s = float(time_s[1] - time_s[0])
    chance = -np.expm1(-step_s / values["interval_s"])
    steps = np.where(rng.random(time_s.size) < chance, values["size"] * rng.standard_normal(time_s.size), 0.0)
    return np.zeros_like(steps), np.cumsum(steps), {}


def _visible(scales: Scales) -> Values:
    return {"interval_s": 0.1 * scales.length_s, "size": scales.J}


def _known(option: str) -> Effect:
    """The effect with the times that its name gives."""
    try:
        times = times_in(f":{option}")
    except ValueError:
        times = np.array([np.nan])
    if not np.isfinite(times).all() or times.size > MOST_TIMES:
        raise UsageError(f"{EFFECT.name}:{option} names no times in seconds, {MOST_TIMES} at most",
                         f"write for example {EFFECT.name}:120+431")

    def columns(theta: FloatArray, context: Context) -> tuple[FloatArray, ...]:
        # The sample during which a step happens gets its share.
        return tuple(np.clip((context.time_s - t) / context.step_s + 1.0, 0.0, 1.0)[:, None].repeat(theta.shape[1], 1)
                     for t in times.tolist())

    def report(searched: Values, sizes: FloatArray, base: Values) -> dict[str, float]:
        return {"interval_s": base["length_s"] / times.size, "size": float(np.sqrt(np.mean(sizes**2)))}

    def picked_from(context: Context) -> float:
        return math.comb(max(context.process_value.size, times.size), times.size)

    return replace(EFFECT, searched=(), columns=columns, report=report, picked_from=picked_from)


EFFECT = Effect(
    name="random-load-steps", kind="L", place=Place.DISTURBANCE,
    summary="the load shifts at random times and stays",
    equation="y gets G(s) d, d(t) = sum of size_i for t >= time_i",
    source="compound Poisson load; docs/details.md, section 7", parameters=(_INTERVAL, _SIZE), searched=(),
    needs=("value",), confused_with=("load-noise", "random-walk-disturbance", "step-disturbance"), asked=BY_HAND,
    ahead=True, known=_known, disturb=_disturb,
    visible=_visible,
    leaves={"level": 4, "stretch": 8},
    noun="a load that shifts again and again",
    sentence="The load shifts every {interval_s} on average, by {size}.",
    seen_over="time",
    action="Look up what is switched or fed at these times.",
    of_record=("interval_s", "size"),
    settled_by="a tag of the suspected load, read with --extra",
    told_apart={
        "load-noise": "a tag of the suspected load, read with --extra",
        "random-walk-disturbance": "a tag of the suspected load, read with --extra",
        "step-disturbance": "a longer record: a load that shifts at random shifts again",
    },
)
