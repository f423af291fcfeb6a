"""Stiction law of He 2007: the valve stops at every sample and jumps when the force exceeds static friction.

|e| > f_s: u_v = u - sign(e) f_d, else hold, with e = u(k) - u_v(k-1).

A slow ramp of the command gives a staircase with steps of J, where a real stem driven by a continuous command slides.
Right where a held (scanned) command lets a fast stem come to rest between two scans.

The re-stick row has no meaning here: this law is Chen's with an infinite re-stick speed. With the overshoot row off
its neutral 1, this is the law of He and Wang (he-wang); the other rows act as in every law.

Source: He et al. 2007, docs/details.md, section 3 (their u_r and cum_u are u - u_v and e). The print has not been seen.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import LANES, LINE, kernel
from ..typing import FloatArray
from .contract import FS_DOWN, FS_UP, OVERSHOOT, TIE, UPPER, Law, rest_position

# Rows of the working table: the friction rows up to UPPER, and the position, which is the only state.
_WORK = 11


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
            for i in range(UPPER + 1):
                work[i * LANES + p] = friction[i, q]
            work[FS_UP * LANES + p] += TIE
            work[FS_DOWN * LANES + p] += TIE
            work[OVERSHOOT * LANES + p] -= 1.0
            work[10 * LANES + p] = state[0, q]
        last = first + width
        for k in range(samples):
            u = command[k]
            drift = profile[k]
            for p in range(padded):
                v = work[10 * LANES + p]
                spare = work[7 * LANES + p]
                low = work[8 * LANES + p]
                high = work[9 * LANES + p]
                fs_add = work[4 * LANES + p] * drift
                fd_add = work[5 * LANES + p] * drift
                to_up = u - (work[2 * LANES + p] + fd_add)
                to_down = u + (work[3 * LANES + p] + fd_add)
                e = u - v
                # v + K (e - sign(e) f_d), written so that K = 1 leaves u - sign(e) f_d to the last bit
                new = to_up + spare * (to_up - v) if e > work[p] + fs_add else v
                new = to_down + spare * (to_down - v) if -e > work[LANES + p] + fs_add else new
                new = low if new < low else new
                work[10 * LANES + p] = high if new > high else new
            row = position[k, first:last]
            for p in range(width):
                row[p] = work[10 * LANES + p]
        for p in range(width):
            state[0, first + p] = work[10 * LANES + p]


def _start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Valve at rest with residual force e(0) = share * f_s, within its stops."""
    return rest_position(command0, friction, share)[None]


LAW = Law(
    name="he",
    summary="the valve rests at every sample and jumps when the force exceeds static friction",
    equation="|e| > f_s -> u_v = u - sign(e) f_d, else hold",
    source="He et al. 2007",
    checked="reconstructed (from the description in Shang et al.; the print has not been seen)",
    cannot="sliding: a slow ramp gives a staircase of steps J; inertia; viscous friction",
    run=_run, start=_start, states=1, sliding_state=None, slips="rests",
)
