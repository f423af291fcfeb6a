"""Stiction law of Stenman 2003: one parameter; the valve jumps to the command once it is further away than d.

|e| > d: u_v = u, else hold, with e = u(k) - u_v(k-1) and d = S = J, so f_s = S and f_d = 0.

J is ignored: d = f_s + f_d of its direction, which is S whatever J the friction table carries. So this is He's law with
f_s = d and f_d = 0. The valve has no deadband beyond the jump and never slides. The re-stick row has no meaning (the
stem rests at every sample). Drift, directions, overshoot and travel stops act as in every law.

Wrong wherever J differs from S: the jump and the band can't be told apart with one number.

Source: Stenman, Gustafsson and Forsman 2003; docs/details.md, section 3.
"""

from __future__ import annotations

import numpy as np

from ..typing import FloatArray
from .contract import FD_DOWN, FD_DRIFT, FD_UP, FS_DOWN, FS_DRIFT, FS_UP, Law, check_size
from .he import LAW as HE


def _as_he(friction: FloatArray) -> FloatArray:
    """The friction table (ROWS, P) of He's law that jumps to the command."""
    table, sliding = friction.copy(), [FD_UP, FD_DOWN, FD_DRIFT]
    table[[FS_UP, FS_DOWN, FS_DRIFT]] += friction[sliding]
    table[sliding] = 0.0
    return table


def _run(command: FloatArray, friction: FloatArray, profile: FloatArray, state: FloatArray,
         position: FloatArray) -> None:
    HE.run(command, _as_he(friction), profile, state, position)


def _start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Valve at rest with e(0) = share * d, within its stops."""
    return HE.start(command0, _as_he(friction), share)


def _check(stickband: FloatArray | float, slip_jump: FloatArray | float) -> None:
    check_size(np.asarray(stickband, dtype=np.float64), "Stenman's band d = S")


LAW = Law(
    name="stenman",
    summary="one parameter d = S = J: hold within d of the command, else jump to it",
    equation="|e| > d -> u_v = u, else hold",
    source="Stenman, Gustafsson and Forsman 2003",
    checked="reconstructed (from the description in the literature; the print has not been seen)",
    cannot="a deadband other than the jump (J is ignored); sliding; inertia; viscous friction",
    run=_run, start=_start, one_parameter=True, sliding_state=None, check=_check,
)
