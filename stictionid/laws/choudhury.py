"""Stiction law of Choudhury 2005: compares the command's travel since its last change of direction with S and J.

xss is the command at the last sign change of du; I = 1 where the command rested there:
    sign(du) != sign(du_prev): xss = u(k-1), hold, and I = 1 if du = 0
    not I: |u - xss| > S -> u_v = u - sign(du) f_d, else hold
    I:     |u - xss| > J -> I = 0, u_v = u - sign(du) f_d, else hold
    u outside 0..100 %: u_v = 0 or 100

Known faults, kept because the law is historical: isolated steps never move the valve, and noise keeps it stuck. After
a rest a reversal needs only J, and the valve then holds again until S. The law looks at the command only, never at e.
It can leave the stem further from the command than friction could hold it.

S and J are taken per direction (S = f_s ahead + f_d behind). The re-stick speed makes a sliding valve rest, as du = 0
would: xss = u(k-1), I = 1, and J is tested in the same sample. The overshoot applies to the first sample of a move.
The saturation is in % of span: commands in other units must be scaled first.

Source: Choudhury, Thornhill and Shah 2005, docs/details.md, section 3. The printed flow chart has not been seen.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import LANES, LINE, kernel
from ..typing import FloatArray
from .contract import (
    FD_DOWN,
    FD_DRIFT,
    FD_UP,
    FS_DOWN,
    FS_DRIFT,
    FS_UP,
    LOWER,
    OVERSHOOT,
    RESTICK,
    TIE,
    UPPER,
    Law,
    rest_position,
)

# State rows: stem position, 1 while moving, xss, I, last command and last change of command.
_POSITION, _MOVING, _TURN, _RESTED, _COMMAND, _CHANGE = range(6)
# Rows of the working table: S, J and f_d upward, then downward, their drift, four limits, position, moving, xss, I.
_S_UP, _J_UP, _FD_UP, _S_DRIFT, _J_DRIFT, _FD_DRIFT = 0, 1, 2, 6, 7, 8
_DOWNWARD = 3  # rows from an upward constant to its downward twin
_WORK = 17


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
            work[_S_UP * LANES + p] = friction[FS_UP, q] + friction[FD_DOWN, q] + TIE
            work[_J_UP * LANES + p] = friction[FS_UP, q] - friction[FD_UP, q] + TIE
            work[_FD_UP * LANES + p] = friction[FD_UP, q]
            work[(_S_UP + _DOWNWARD) * LANES + p] = friction[FS_DOWN, q] + friction[FD_UP, q] + TIE
            work[(_J_UP + _DOWNWARD) * LANES + p] = friction[FS_DOWN, q] - friction[FD_DOWN, q] + TIE
            work[(_FD_UP + _DOWNWARD) * LANES + p] = friction[FD_DOWN, q]
            work[_S_DRIFT * LANES + p] = friction[FS_DRIFT, q] + friction[FD_DRIFT, q]
            work[_J_DRIFT * LANES + p] = friction[FS_DRIFT, q] - friction[FD_DRIFT, q]
            work[_FD_DRIFT * LANES + p] = friction[FD_DRIFT, q]
            work[9 * LANES + p] = friction[RESTICK, q]
            work[10 * LANES + p] = friction[OVERSHOOT, q] - 1.0
            work[11 * LANES + p] = friction[LOWER, q]
            work[12 * LANES + p] = friction[UPPER, q]
            work[13 * LANES + p] = state[_POSITION, q]
            work[14 * LANES + p] = state[_MOVING, q]
            work[15 * LANES + p] = state[_TURN, q]
            work[16 * LANES + p] = state[_RESTED, q]
        last = first + width
        u_last = state[_COMMAND, first]
        du_last = state[_CHANGE, first]
        for k in range(samples):
            u = command[k]
            du = u - u_last
            drift = profile[k]
            if u < 0.0 or u > 100.0:
                end = 0.0 if u < 0.0 else 100.0
                for p in range(padded):
                    held = work[11 * LANES + p] if end < work[11 * LANES + p] else end
                    work[13 * LANES + p] = work[12 * LANES + p] if held > work[12 * LANES + p] else held
                    work[14 * LANES + p] = 0.0
            elif (du > 0.0) != (du_last > 0.0) or (du < 0.0) != (du_last < 0.0):
                for p in range(padded):
                    work[14 * LANES + p] = 0.0
                    work[15 * LANES + p] = u_last
                    work[16 * LANES + p] = 1.0 if du == 0.0 else work[16 * LANES + p]
            else:
                sign = 1.0 if du > 0.0 else (-1.0 if du < 0.0 else 0.0)
                speed = abs(du)
                base = _DOWNWARD * LANES if du < 0.0 else 0
                for p in range(padded):
                    v = work[13 * LANES + p]
                    moving = work[14 * LANES + p] > 0.5
                    low = work[11 * LANES + p]
                    high = work[12 * LANES + p]
                    rests = moving & (speed < work[9 * LANES + p])
                    turn = u_last if rests else work[15 * LANES + p]
                    rested = 1.0 if rests else work[16 * LANES + p]
                    S = work[base + _S_UP * LANES + p] + work[_S_DRIFT * LANES + p] * drift
                    J = work[base + _J_UP * LANES + p] + work[_J_DRIFT * LANES + p] * drift
                    fd = work[base + _FD_UP * LANES + p] + work[_FD_DRIFT * LANES + p] * drift
                    far = abs(u - turn)
                    goes = far > (J if rested > 0.5 else S)
                    target = u - sign * fd
                    # The first sample of a move jumps; later ones never move the stem backwards.
                    ahead = target if sign * (target - v) > 0.0 else v
                    jump = target + work[10 * LANES + p] * (target - v)
                    new = ahead if moving & (not rests) else jump
                    new = new if goes else v
                    held = low if new < low else new
                    held = high if held > high else held
                    work[13 * LANES + p] = held
                    work[14 * LANES + p] = 1.0 if goes & (held == new) else 0.0
                    work[15 * LANES + p] = turn
                    work[16 * LANES + p] = 0.0 if goes else rested
            row = position[k, first:last]
            for p in range(width):
                row[p] = work[13 * LANES + p]
            u_last = u
            du_last = du
        for p in range(width):
            state[_POSITION, first + p] = work[13 * LANES + p]
            state[_MOVING, first + p] = work[14 * LANES + p]
            state[_TURN, first + p] = work[15 * LANES + p]
            state[_RESTED, first + p] = work[16 * LANES + p]
            state[_COMMAND, first + p] = u_last
            state[_CHANGE, first + p] = du_last


def _start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Valve at rest (I = 1) with e(0) = share * f_s; the law itself never looks at e."""
    state = np.zeros((6, friction.shape[1]))
    state[_POSITION] = rest_position(command0, friction, share)
    state[_TURN] = state[_COMMAND] = command0
    state[_RESTED] = 1.0
    return state


LAW = Law(
    name="choudhury",
    summary="counts the command's way since it last turned; a historical law with known faults",
    equation="sign(du) changed -> xss = u(k-1), hold, I = 1 if du = 0; else |u-xss| > (J if I else S) -> I = 0, "
             "u_v = u - sign(du) f_d; else hold",
    source="Choudhury, Thornhill and Shah 2005",
    checked="reconstructed (from the description in the literature; the printed flow chart has not been seen)",
    cannot="isolated steps (they never move it), noisy commands (they keep it stuck), a reversal after a rest "
           "(needs only J, then freezes until S)",
    run=_run, start=_start,
)
