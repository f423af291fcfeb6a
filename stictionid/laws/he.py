"""Stiction law of He 2007: the valve stops at every sample and jumps when the force exceeds static friction.

|e| > f_s: u_v = u - sign(e) f_d, else hold, with e = u(k) - u_v(k-1).

A slow ramp of the command gives a staircase with steps of J, where a real stem driven by a continuous command slides.
Right where a held (scanned) command lets a fast stem come to rest between two scans.

The re-stick row has no meaning here: this law is Chen's with an infinite re-stick speed. With the overshoot row off
its neutral 1, this is the law of He and Wang (he-wang); the other rows act as in every law.

Source: He et al. 2007, docs/method.md, section 3 (their u_r and cum_u are u - u_v and e). The print has not been seen.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import LANES, LINE, kernel
from ..typing import FloatArray
from .contract import FD_DOWN, FD_DRIFT, FD_UP, FS_DOWN, FS_DRIFT, FS_UP, LOWER, OVERSHOOT, TIE, UPPER, Law

# Rows of the working table: nine constants and the position, which is the only state.
_WORK = 10


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
            work[p] = friction[FS_UP, q] + TIE
            work[LANES + p] = friction[FS_DOWN, q] + TIE
            work[2 * LANES + p] = friction[FD_UP, q]
            work[3 * LANES + p] = friction[FD_DOWN, q]
            work[4 * LANES + p] = friction[FS_DRIFT, q]
            work[5 * LANES + p] = friction[FD_DRIFT, q]
            work[6 * LANES + p] = friction[OVERSHOOT, q] - 1.0
            work[7 * LANES + p] = friction[LOWER, q]
            work[8 * LANES + p] = friction[UPPER, q]
            work[9 * LANES + p] = state[0, q]
        last = first + width
        for k in range(samples):
            u = command[k]
            drift = profile[k]
            for p in range(padded):
                v = work[9 * LANES + p]
                spare = work[6 * LANES + p]
                low = work[7 * LANES + p]
                high = work[8 * LANES + p]
                fs_add = work[4 * LANES + p] * drift
                fd_add = work[5 * LANES + p] * drift
                to_up = u - (work[2 * LANES + p] + fd_add)
                to_down = u + (work[3 * LANES + p] + fd_add)
                e = u - v
                # v + K (e - sign(e) f_d), written so that K = 1 leaves u - sign(e) f_d to the last bit
                new = to_up + spare * (to_up - v) if e > work[p] + fs_add else v
                new = to_down + spare * (to_down - v) if -e > work[LANES + p] + fs_add else new
                new = low if new < low else new
                work[9 * LANES + p] = high if new > high else new
            row = position[k, first:last]
            for p in range(width):
                row[p] = work[9 * LANES + p]
        for p in range(width):
            state[0, first + p] = work[9 * LANES + p]


def _start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Valve at rest with residual force e(0) = share * f_s, within its stops."""
    fs = np.where(share > 0, friction[FS_UP], friction[FS_DOWN])
    place: FloatArray = np.clip(command0 - share * fs, friction[LOWER], friction[UPPER])
    return place[None, :].copy()


LAW = Law(
    name="he",
    summary="the valve rests at every sample and jumps when the force exceeds static friction",
    equation="|e| > f_s -> u_v = u - sign(e) f_d, else hold",
    source="He et al. 2007",
    checked="reconstructed (from the description in Shang et al.; the print has not been seen)",
    cannot="sliding: a slow ramp gives a staircase of steps J; inertia; viscous friction",
    run=_run, start=_start, states=1, sliding_state=None, slips="rests",
)
