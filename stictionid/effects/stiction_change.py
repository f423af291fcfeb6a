"""Stiction change: stickband and slip jump change once (the valve is repaired, repacked, or its packing is tightened).

`estimate.S` and `estimate.J` are those of the valve as it is now, after the change. The time is known no better than
from one slip to the next. Wrong where friction drifts: a drift over the whole record takes one number less, and BIC
tells the two apart. No stickband and no slip jump is negative, and none jumps by more than twice its stickband: beyond
that the change stops.

Equation: S(t) = S - stickband_change and J(t) = J - jump_change for t < time_s, then S and J. Source: Page, Continuous
inspection schemes, 1954; docs/details.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..laws.contract import FD_DOWN, FD_DRIFT, FD_UP, FS_DOWN, FS_DRIFT, FS_UP, SINCE
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_S = Parameter("stickband_change", "%", -100.0, 100.0, 0.0, "stickband after the change less that before")
_J = Parameter("jump_change", "%", -100.0, 100.0, 0.0, "slip jump after the change less that before")
_TIME = Parameter("time_s", "s", 0.0, 1e9, 0.0, "when stickband and slip jump change")
# Largest changes, and the ends of the record without a change: its stickband would rest on a few slips. Shares.
_REACH, _END = (1.2, 0.9), 0.04
# Guesses: times, and changes of S and J as shares of S_max.
_TIMES, _CHANGES = 12, ((-0.7, -0.4), (-0.4, -0.2), (-0.2, -0.1), (0.2, 0.1), (0.4, 0.2), (0.7, 0.4))


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    S = table[FS_UP] + table[FD_UP]
    J = 0.5 * (table[FS_UP] + table[FS_DOWN] - table[FD_UP] - table[FD_DOWN])
    swing = np.minimum(theta[0], S)
    jump = np.clip(theta[1], np.minimum(J - 2.0 * (S - swing), J), J)
    breaks, slides = 0.5 * (swing + jump), 0.5 * (swing - jump)
    table[[FS_UP, FS_DOWN]] -= breaks
    table[[FD_UP, FD_DOWN]] -= slides
    table[FS_DRIFT] += breaks
    table[FD_DRIFT] += slides
    table[SINCE] = np.where((swing == 0.0) & (jump == 0.0), table[SINCE], theta[2])
    return table


def _profile(time_s: FloatArray) -> FloatArray:
    return np.ones_like(time_s)


def _limits(context: Context) -> tuple[Parameter, ...]:
    S, J = (share * context.s_max for share in _REACH)
    first, last = _END * context.length_s, (1.0 - _END) * context.length_s
    return (replace(_S, low=-S, high=S), replace(_J, low=-J, high=J),
            replace(_TIME, low=first, high=last, neutral=last))


def _guess(context: Context) -> FloatArray:
    times = (np.arange(_TIMES) + 0.5) / _TIMES * context.length_s
    return np.array([[context.s_max * S, context.s_max * J, time] for time in times for S, J in _CHANGES])


def _places(context: Context) -> float:
    """Number of half cycles, each of which may be the first after the change."""
    return 2.0 * context.length_s / context.period_s


def _report(searched: Values, sizes: FloatArray, base: Values) -> dict[str, float]:
    S = max(base["S"] - searched["stickband_change"], 0.0)
    J = min(max(base["J"] - searched["jump_change"], 0.0), 2.0 * S)
    return {"stickband_change": base["S"] - S, "jump_change": base["J"] - J, "time_s": searched["time_s"]}


def _visible(scales: Scales) -> Values:
    return {"stickband_change": -0.6 * scales.S, "jump_change": -0.6 * scales.J, "time_s": 0.5 * scales.length_s}


EFFECT = Effect(
    name="stiction-change", kind="F", place=Place.FRICTION,
    summary="stickband and slip jump change once, as when a valve is repaired",
    equation="S(t) = S - stickband_change, J(t) = J - jump_change for t < time_s, then S, J",
    source="Page, Continuous inspection schemes, 1954; docs/details.md, section 5",
    parameters=(_S, _J, _TIME), searched=("stickband_change", "jump_change", "time_s"),
    confused_with=("stiction-drift", "random-walk-disturbance"), at_once=True, limits=_limits, friction=_friction,
    profile=_profile, guess=_guess, picked_from=_places, report=_report,
    visible=_visible,
    leaves={"stretch": 7, "slide": 4},
    noun="friction that changes at {time_s}",
    sentence="At {time_s} [the stickband changes by {stickband_change}|the slip jump by {jump_change}]; "
             "S and J are those after.",
    seen_over="time",
    action="Look up what was done to the valve at {time_s}.",
    of_record=("time_s",),
    settled_by="the work order of the valve, or a record of each side of the change",
    told_apart={
        "stiction-drift": "a second record some hours later: a change stays, a drift goes on",
        "random-walk-disturbance": "the measured valve position, or a record of each side of the change",
        "gain-drift": "the measured valve position, or the same large step in manual early and late",
    },
)
