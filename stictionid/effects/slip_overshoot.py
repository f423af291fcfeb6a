"""Slip overshoot: an underdamped stem jumps past the point where friction would stop it.

Equation: at the slip u_v = u_v + K (e - sign(e) f_d); K = 1 is no overshoot, K near 2 an almost undamped stem. Where
the command moves within its samples e is f_s at the slip, whatever it is when the part of the sample ends (Chen's law;
the others take the end): with the end, the y of a model with the true numbers was 3 to 14 times the noise off.
A stem that overshoots needs less of the command to slip back: in a cycle the command swings by S - (K - 1) J only.
Source: He and Wang 2010; METHODS.md section 2.
"""

from __future__ import annotations

import numpy as np

from ..laws.contract import CROSSES, OVERSHOOT
from ..loop import FloatArray
from ..parameters import Parameter
from .contract import Context, Effect, Place

_K = Parameter("overshoot", "-", 1.0, 1.99, 1.0, "length of the slip as a multiple of the plain one")


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    table[OVERSHOOT] = theta[0]
    table[CROSSES] = 0.0 if held else 1.0
    return table


def _guess(context: Context) -> FloatArray:
    return np.array([[1.1], [1.3], [1.6]])


EFFECT = Effect(
    name="slip-overshoot", kind="F", place=Place.FRICTION,
    summary="the stem jumps past its place and waits for the command",
    equation="at the slip u_v = u_v(k-1) + K (e - sign(e) f_d)",
    source="He and Wang 2010", parameters=(_K,), friction=_friction, guess=_guess, reach=2.0,
)
