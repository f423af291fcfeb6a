"""Travel limit: a hard stop holds the stem, and friction starts from the stop.

The effect is no clip of the output: a valve at its stop breaks away from it when the command has come back by f_s. Over
a short travel it can't be told from a curved valve characteristic. Source: docs/details.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..laws.contract import LOWER, UPPER
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Seen, Values

_LOWER = Parameter("lower", "%", -20.0, 120.0, -20.0, "the stem can't close further")
_UPPER = Parameter("upper", "%", -20.0, 120.0, 120.0, "the stem can't open further")
# Share of the record for which the command may be beyond a limit (a controller winds up against it), and guesses.
_MOST, _GUESSED = 0.9, (0.05, 0.15, 0.3, 0.5)


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    # An upper stop below the lower one is moved to it and leaves no travel; exchanged stops would act outside their
    # ranges.
    table[LOWER], table[UPPER] = theta[0], np.maximum(theta[0], theta[1])
    return table


def _reach(context: Context) -> tuple[float, float]:
    low, high = float(context.command.min()), float(context.command.max())
    return low - 0.6 * context.s_max, high + 0.6 * context.s_max


def _limits(context: Context) -> tuple[Parameter, ...]:
    low, high = _reach(context)
    least, most = (float(q) for q in np.quantile(context.command, [1.0 - _MOST, _MOST]))
    return (replace(_LOWER, low=low, high=most, neutral=low), replace(_UPPER, low=least, high=high, neutral=high))


def _guess(context: Context) -> FloatArray:
    low, high = _reach(context)
    closed, opened = (np.quantile(context.command, shares) for shares in (_GUESSED, 1.0 - np.array(_GUESSED)))
    return np.array([[q, high] for q in closed] + [[low, q] for q in opened])


def _released(context: Context) -> tuple[Parameter, ...]:
    # A stop that the command never releases holds the stem for ever; one released at every command is never met.
    low, high = float(context.command.min()), float(context.command.max())
    return tuple(replace(p, low=low, high=high) for p in (_LOWER, _UPPER))


def _behind_release(S: FloatArray, J: FloatArray) -> FloatArray:
    static = 0.5 * (S + J)
    return np.stack([-static, static])


def _visible(scales: Scales) -> Values:
    return {"upper": scales.highest - 0.25 * (scales.highest - scales.lowest)}


EFFECT = Effect(
    name="travel-limit", kind="T", place=Place.FRICTION,
    summary="a hard stop holds the stem short of its travel",
    equation="lower <= u_v <= upper; at a limit the stem is stuck there",
    source="docs/details.md, section 5", parameters=(_LOWER, _UPPER), confused_with=("valve-characteristic",),
    limits=_limits, friction=_friction, guess=_guess, seen=Seen(_released, _behind_release),
    visible=_visible, two_sided=True,
    leaves={"direction": 2, "output": 1, "value": 3, "setpoint": 2},
    noun="a hard stop at [{lower}|{upper}] of travel",
    sentence="The stem moves only [above {lower}|below {upper}], whatever the controller asks for.",
    seen_over="travel",
    action="Check end stops, handwheel and the limits set in the positioner.",
    settled_by="a step in manual beyond the suspected limit",
    told_apart={
        "valve-characteristic": "a step in manual beyond the suspected limit: a limited valve moves no further",
    },
)
