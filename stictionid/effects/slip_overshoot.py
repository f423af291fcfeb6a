"""Slip overshoot: an underdamped stem jumps past the point where friction would stop it.

Equation: at the slip u_v = u_v + K (e - sign(e) f_d); K = 1 is no overshoot, K near 2 an almost undamped stem. Where
the command moves within its samples Chen's law takes e = f_s at the slip. The other laws take e at the end of the part
of the sample. With the end, y of a model with the true numbers was off by 3 to 14 times the noise. A stem that
overshoots needs less of the command to slip back: in a cycle the command swings by S - (K - 1) J only. That swing and
the slip K J are what the record identifies directly (`Natural`). Source: He and Wang 2010; docs/details.md, section 3.
"""

from __future__ import annotations

import numpy as np

from ..laws.contract import CROSSES, OVERSHOOT
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Natural, Place, Scales, Values

_K = Parameter("overshoot", "-", 1.0, 1.99, 1.0, "length of the slip as a multiple of the plain one")

# Distance of a held command beyond f_s when the valve slips: half of its move from sample to sample. Unit: moves.
_LATE = 0.5
# Growth of the longest slip, as a share of the swing of the command, for each unit of K - 1. At J = 0.85 S and K = 1.8
# the swing is a third of S and the slip nearly 5 times the swing.
_LONGER = 4.0


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    table[OVERSHOOT] = theta[0]
    table[CROSSES] = 0.0 if held else 1.0
    return table


def _late(context: Context) -> float:
    """Distance of the command beyond f_s when the valve slips, in %; the slip is longer by K times that."""
    moves = np.abs(np.diff(context.command))
    return _LATE * float(np.median(moves[moves > 0.0])) if moves.any() else 0.0


def _numbers(S: FloatArray, J: FloatArray, theta: FloatArray, context: Context) -> tuple[FloatArray, FloatArray]:
    past = J + _late(context)
    return S - (theta[0] - 1.0) * past, theta[0] * past


def _valve(swing: FloatArray, slip: FloatArray, theta: FloatArray, context: Context) -> tuple[FloatArray, FloatArray]:
    past = slip / theta[0]
    return swing + (theta[0] - 1.0) * past, past - _late(context)


def _longest(theta: FloatArray) -> FloatArray:
    return np.asarray(1.0 + _LONGER * (theta[0] - 1.0))


def _guess(context: Context) -> FloatArray:
    return np.array([[1.1], [1.3], [1.6]])


def _visible(scales: Scales) -> Values:
    return {"overshoot": 1.5}


EFFECT = Effect(
    name="slip-overshoot", kind="F", place=Place.FRICTION,
    summary="the stem jumps past its place and waits for the command",
    equation="at the slip u_v = u_v(k-1) + K (e - sign(e) f_d)",
    source="He and Wang 2010", parameters=(_K,), friction=_friction, guess=_guess, reach=2.0,
    natural=Natural(_numbers, _valve, _longest),
    # The longer slip of a valve that rests is that of another S and J.
    slides=True,
    visible=_visible,
    leaves={"slip": 3, "cycle": 2, "valve": 5, "bump": 1},
    noun="slips that go past their place",
    sentence="A slip is {overshoot} times as long as friction alone would make it; then the stem waits.",
    seen_over="direction",
    action="Check actuator and positioner: stored air lets the stem jump past its place.",
    settled_by="the measured valve position, sampled faster than the scan",
)
