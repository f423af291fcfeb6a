"""Positioner that integrates: an inner loop moves the stem while the command rests, and may hunt by itself.

A positioner adds the integral of its own error, command less stem, to the command. A stem that sticks short of its
place is pushed on until it slips, mostly past it; then it is pulled back. Friction and integral make a cycle of their
own, whatever the controller does. The stem then moves under a resting command, so S is larger than the swing of the
command shows. Under it the stem rests between slips, as in He's law at every instant:
laws/contract/behind_positioner.py.

At both ends of the integral time u and y can't tell it from a valve that rests between scans. Measured on three loops
each with the true numbers: from 8 periods of the loop on re-sticking leaves 1.01 to 1.27 times the noise. At
0.02 to 0.07 periods the stem follows the command, and any small S leaves as much as the positioner does, within 11 %.
From 0.1 to 5 periods re-sticking leaves 2.7 to 14 times the noise. A measured position separates them.

The integral part at the start is one more unknown, beside the residual force. Segments of a record share it, so that a
record with gaps is best cut. Physical laws have forces of their own and refuse a positioner; a user-written law is
replaced by He's.

Equation: the force is u + w - u_v, w' = integral_rate (u - u_v).
Source: PI control of the stem, as in IEC 61514 digital positioners; Ruel, Control valve diagnosis, 2000.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..laws.contract import CROSSES, INNER, INTEGRAL
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

# A root is searched: an integral time of a second is as far from none as one of a minute from none.
_RATE = Parameter("integral_rate", "1 / s", 0.0, 10.0, 0.0, "integral part of the positioner, 1 / integral time",
                  power=3.0)
_START = Parameter("start", "%", -100.0, 100.0, 0.0, "integral part of the positioner at the start of the record")
# Shortest integral time in periods of the loop, guesses of it, and the largest integral part at the start, as a share
# of the swing of the command.
_SHORTEST, _GUESSED, _LARGEST = 0.01, np.array([0.05, 0.15, 0.4, 1.0]), 1.0
# Ranges of a scan: S (swings of the command), J (S), residual force, lag and dead time (periods), rate (per period),
# integral part at the start (swings). Those of these rows are spread evenly in the logarithm.
_SCANNED = ((0.15, 1.6), (0.1, 1.0), (-1.0, 1.0), (0.05, 1.0), (0.0, 0.35), (0.3, 12.0), (-0.5, 0.5))
_LOGARITHMIC = [0, 3, 5]


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    table[INTEGRAL], table[INNER] = theta[0] * command_step_s, theta[1]
    table[CROSSES] = np.where(theta[0] > 0.0, 0.0 if held else 1.0, table[CROSSES])
    return table


def _limits(context: Context) -> tuple[Parameter, ...]:
    most = 1.0 / max(_SHORTEST * context.period_s, context.step_s)
    return replace(_RATE, high=most), replace(_START, low=-_LARGEST * context.s_max, high=_LARGEST * context.s_max)


def _guess(context: Context) -> FloatArray:
    rates = np.minimum(1.0 / (_GUESSED * context.period_s), _limits(context)[0].high)
    return np.array([[rate, share * context.s_max] for rate in rates for share in (-0.3, 0.0, 0.3)])


def _scan(shares: FloatArray, context: Context) -> FloatArray:
    """Values of the valve, its process and the effect: a positioner that hunts does so about as fast as its loop."""
    low, high = np.array(_SCANNED).T[:, :, None]
    s_max, period = context.s_max, context.period_s
    values: FloatArray = low + (high - low) * shares
    at = _LOGARITHMIC
    values[at] = low[at] * (high[at] / low[at]) ** shares[at]
    values *= np.array([s_max, 1.0, 1.0, period, period, 1.0 / period, s_max])[:, None]
    values[1] *= values[0]
    return values


def _visible(scales: Scales) -> Values:
    return {"integral_rate": 1.0 / scales.lag_s}


EFFECT = Effect(
    name="positioner", kind="F", place=Place.FRICTION,
    summary="a positioner that integrates moves the stem while the command rests",
    equation="force u + w - u_v, w' = integral_rate (u - u_v)",
    source="PI control of the stem in a digital positioner (IEC 61514)",
    parameters=(_RATE, _START), limits=_limits, friction=_friction, guess=_guess, reach=2.0, scan=_scan,
    visible=_visible, of_record=("start",),
    leaves={"stick": 5, "slip": 6, "own line": 5, "line": 3},
    noun="a positioner that integrates and hunts",
    sentence="The positioner pushes a stuck stem on at {integral_rate} times its error until it slips.",
    seen_over="time",
    action="Switch off or slow down the positioner's integral part; its dead zone should exceed the slip jump.",
    settled_by="the measured valve position: the stem moves while the command rests",
    told_apart={"re-sticking": "the measured valve position: only a positioner moves the stem while the command rests"},
)
