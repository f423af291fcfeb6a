"""Stiction law of Stenman 2003: one parameter; the valve jumps to the command once it is further away than d.

|e| > d: u_v = u, else hold, with e = u(k) - u_v(k-1) and d = S = J, so f_s = S and f_d = 0.

J is ignored: the kernel takes d = f_s + f_d of its direction, which is S whatever J the friction table carries. The
valve has no deadband beyond the jump and never slides. The re-stick row has no meaning (the stem rests at every
sample). Drift, directions, overshoot and travel stops act as in every law.

Wrong wherever J differs from S: the jump and the band can't be told apart with one number.

Source: Stenman, Gustafsson and Forsman 2003; docs/details.md, section 3.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import LANES, LINE, kernel
from ..typing import FloatArray
from .contract import FD_DOWN, FD_DRIFT, FD_UP, FS_DOWN, FS_DRIFT, FS_UP, LOWER, OVERSHOOT, TIE, UPPER, Law, check_size

# Rows of the working table: six constants and the position, which is the only state.
_WORK = 7


@kernel
def _run(command: FloatArray, friction: FloatArray, profile: FloatArray, state: FloatArray,
         position: FloatArray) -> None:
    lanes = friction.shape[1]
    samples = command.size
    work = np.empty(_WORK * LANES + LINE)
    work = work[-(work.ctypes.data // 8) % LINE:]
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        padded = (width + 3) // 4 * 4
        for p in range(padded):
            q = first + min(p, width - 1)
            work[p] = friction[FS_UP, q] + friction[FD_UP, q] + TIE
            work[LANES + p] = friction[FS_DOWN, q] + friction[FD_DOWN, q] + TIE
            work[2 * LANES + p] = friction[FS_DRIFT, q] + friction[FD_DRIFT, q]
            work[3 * LANES + p] = friction[OVERSHOOT, q] - 1.0
            work[4 * LANES + p] = friction[LOWER, q]
            work[5 * LANES + p] = friction[UPPER, q]
            work[6 * LANES + p] = state[0, q]
        last = first + width
        for k in range(samples):
            u = command[k]
            drift = profile[k]
            for p in range(padded):
                v = work[6 * LANES + p]
                low = work[4 * LANES + p]
                high = work[5 * LANES + p]
                d_add = work[2 * LANES + p] * drift
                e = u - v
                jumps = (e > work[p] + d_add) | (-e > work[LANES + p] + d_add)
                new = u + work[3 * LANES + p] * e if jumps else v
                new = low if new < low else new
                work[6 * LANES + p] = high if new > high else new
            row = position[k, first:last]
            for p in range(width):
                row[p] = work[6 * LANES + p]
        for p in range(width):
            state[0, first + p] = work[6 * LANES + p]


def _start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Valve at rest with e(0) = share * d, within its stops."""
    band = np.where(share > 0, friction[FS_UP] + friction[FD_UP], friction[FS_DOWN] + friction[FD_DOWN])
    place: FloatArray = np.clip(command0 - share * band, friction[LOWER], friction[UPPER])
    return place[None, :].copy()


def _check(stickband: FloatArray | float, slip_jump: FloatArray | float) -> None:
    check_size(np.asarray(stickband, dtype=np.float64), "Stenman's band d = S")


LAW = Law(
    name="stenman",
    summary="one parameter d = S = J: hold within d of the command, else jump to it",
    equation="|e| > d -> u_v = u, else hold",
    source="Stenman, Gustafsson and Forsman 2003",
    checked="reconstructed (from the description in the literature; the print has not been seen)",
    cannot="a deadband other than the jump (J is ignored); sliding; inertia; viscous friction",
    run=_run, start=_start, states=1, one_parameter=True, sliding_state=None, check=_check,
)
