"""Re-sticking: a sliding valve sticks again when the command moves slower than a certain speed.

Speed 0 is the law of Chen and Kano (slide until the command turns), infinite speed that of He (stick at every sample).
Values in between describe a valve that comes to rest between the scans of a held command. Source: docs/details.md,
sections 3 and 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..laws.contract import CROSSES, RESTICK
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

# A root is searched: the moves below this speed count, and most moves are far slower than the fastest.
_SPEED = Parameter("restick_speed", "% / s", 0.0, 1e4, 0.0, "slowest command a sliding valve follows", power=3.0,
                   steps=True)
# Share of a moving command's samples away from its turns that no rest is slower than.
_SLOWEST = 0.1


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    table[RESTICK] = theta[0] * command_step_s
    table[CROSSES] = 0.0 if held else 1.0
    return table


def _speeds(context: Context) -> FloatArray:
    """Speeds of the command (m,), without the jumps that setpoint steps cause in a command that is not held.

    Such a jump takes one step of the command, however short, and is no speed. As the upper limit it would be a hundred
    times too large and leave the true speed a sliver of the range.
    """
    speeds = np.abs(np.diff(context.command)) / context.command_step_s
    return speeds if context.held else np.minimum(speeds[1:], speeds[:-1])


def _least(context: Context) -> float:
    """The speed in %/s that a moving command exceeds in nine of ten samples away from its turns.

    Where within a sample the command turned is not recorded. A rest that shows next to turns alone is a turn in another
    place, and its speed would be a number that lets each slip behind a turn come right.
    """
    if context.held:
        return 0.0
    moves = np.diff(context.command[::context.command.size // context.process_value.size])
    turns = np.concatenate([[False], moves[1:] * moves[:-1] <= 0.0, [False]])
    away = np.abs(moves)[~(turns[1:] | turns[:-1])]
    return float(np.quantile(away, _SLOWEST)) / context.step_s if away.size else 0.0


def _limits(context: Context) -> tuple[Parameter, ...]:
    low = _least(context)
    return (replace(_SPEED, low=low, high=max(1.05 * float(_speeds(context).max()), 2.0 * low, 1e-9)),)


def _guess(context: Context) -> FloatArray:
    return np.quantile(_speeds(context), [0.2, 0.5, 0.8, 1.0])[:, None] * 1.02


def _visible(scales: Scales) -> Values:
    return {"restick_speed": scales.speed}


EFFECT = Effect(
    name="re-sticking", kind="F", place=Place.FRICTION,
    summary="a sliding valve sticks when the command moves too slowly",
    equation="while sliding: |du/dt| < restick_speed -> stuck",
    source="docs/details.md, section 5", parameters=(_SPEED,), limits=_limits, friction=_friction, guess=_guess,
    by_itself=True,
    visible=_visible,
    leaves={"slide": 1},
    noun="a stem that sticks again when it moves slowly",
    sentence="The sliding stem sticks again when the command moves slower than {restick_speed}.",
    seen_over="direction",
    action="Check packing and guides; this goes with the friction itself.",
    settled_by="the measured valve position, sampled faster than the scan",
    told_apart={
        "slip-overshoot": "the measured valve position, sampled faster than the scan",
        "stiction-drift": "the measured valve position, or a second record some hours later",
    },
)
