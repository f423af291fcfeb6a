"""Re-sticking: a sliding valve sticks again when the command moves slower than a certain speed.

0 is Chen and Kano (slide until the command turns), infinite is He (stick at every sample): the effect bridges both,
for a valve that comes to rest between the scans of a held command. Source: METHODS.md sections 2 and 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..laws.contract import RESTICK
from ..loop import FloatArray
from ..parameters import Parameter
from .contract import Context, Effect, Place

_SPEED = Parameter("restick_speed", "% / s", 0.0, 1e4, 0.0, "slowest command a sliding valve follows")


# The lowest speed searched is this share of a low quantile of those that occur; slower than the third share of the
# largest is standing still.
_SLOWEST, _SLOW, _STILL = 0.5, 0.02, 1e-6


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    table[RESTICK] = theta[0] * command_step_s
    return table


def _speeds(context: Context) -> FloatArray:
    return np.abs(np.diff(context.command)) / context.command_step_s


def _limits(context: Context) -> tuple[Parameter, ...]:
    # Ranks of the speeds decide, and most are far below the largest. Below the slowest move nothing rests.
    speeds = _speeds(context)
    high = max(1.05 * float(speeds.max()), 1e-9)
    low = max(_SLOWEST * float(np.quantile(speeds[speeds > _STILL * high], _SLOW)), _STILL * high)
    return (replace(_SPEED, low=low, high=high, neutral=low, log=True),)


def _guess(context: Context) -> FloatArray:
    return np.quantile(_speeds(context), [0.2, 0.5, 0.8, 1.0])[:, None] * 1.02


EFFECT = Effect(
    name="re-sticking", kind="F", place=Place.FRICTION,
    summary="a sliding valve sticks when the command moves too slowly",
    equation="while sliding: |du/dt| < restick_speed -> stuck",
    source="METHODS.md section 5", parameters=(_SPEED,), limits=_limits, friction=_friction, guess=_guess,
)
