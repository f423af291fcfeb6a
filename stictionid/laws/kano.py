"""Stiction law of Kano 2004: keeps the command at the last stop, u_s, and the direction d of friction.

The valve stops when du*du_prev <= 0: u_s = u(k-1). It then moves again in the other direction when -d (u-u_s) > S,
and in the same one when d (u-u_s) > J. While not stopped, u_v = u - d f_d. In this file u_s is the command that would
hold the stem where it is, u_v + d f_d. That is u(k-1) at every plain stop, and stays right after an overshoot or at a
hard stop.

Every row of the friction table has its meaning: S and J are taken per direction (S = f_s ahead + f_d behind), and the
re-stick speed stops the valve as a resting command does. Under drift this law takes the present S and J, where Chen's
law compares with the position of the stem. The two then differ by the drift of f_d since the stop.

Cannot be told from Chen's law: both give the same positions on every test signal when they start alike. Wrong, like
Chen's, where the stem comes to rest between scans. The printed 2004 flow chart has not been seen.

Source: Kano, Maruta, Kugemoto and Shimizu 2004; docs/details.md, section 3.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import LANES, LINE, kernel
from ..typing import FloatArray
from .contract import FD_UP, OVERSHOOT, RESTICK, TIE, UPPER, Law, rest_position

# State rows: stem position, 1 while moving (stp = 0), u_s, d, last command and last change of command.
_POSITION, _MOVING, _STOPPED, _DIRECTION, _COMMAND, _CHANGE = range(6)
# Rows of the working table: the friction rows up to UPPER, position, re-stick speed while moving (infinite while
# stopped), u_s, d.
_WORK = 14


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
            work[OVERSHOOT * LANES + p] -= 1.0
            work[10 * LANES + p] = state[_POSITION, q]
            work[11 * LANES + p] = friction[RESTICK, q] if state[_MOVING, q] > 0.5 else np.inf
            work[12 * LANES + p] = state[_STOPPED, q]
            work[13 * LANES + p] = state[_DIRECTION, q]
        last = first + width
        u_last = state[_COMMAND, first]
        du_last = state[_CHANGE, first]
        for k in range(samples):
            u = command[k]
            du = u - u_last
            # Speed of a command that kept its direction; -1 after a reversal or a rest, so that the valve stops.
            speed = abs(du) if du * du_last > 0.0 else -1.0
            drift = profile[k]
            for p in range(padded):
                v = work[10 * LANES + p]
                restick = work[6 * LANES + p]
                spare = work[7 * LANES + p]
                low = work[8 * LANES + p]
                high = work[9 * LANES + p]
                u_s = work[12 * LANES + p]
                d = work[13 * LANES + p]
                fs_add = work[4 * LANES + p] * drift
                fd_add = work[5 * LANES + p] * drift
                fs_up = work[p] + fs_add
                fs_down = work[LANES + p] + fs_add
                fd_up = work[2 * LANES + p] + fd_add
                fd_down = work[3 * LANES + p] + fd_add
                to_up = u - fd_up
                to_down = u + fd_down
                upward = d > 0.0
                # Contribution of friction behind the stem to the threshold: J in direction d, S against it.
                behind = -fd_up if upward else fd_down
                move = u - u_s
                rises = move > fs_up + behind + TIE
                falls = -move > fs_down - behind + TIE
                new = to_up + spare * (to_up - v) if rises else v
                new = to_down + spare * (to_down - v) if falls else new
                turned = 1.0 if rises else d
                turned = -1.0 if falls else turned
                # Not stopped: u_v = u - d f_d; after an overshoot the stem waits until the command has reached it.
                ahead_up = to_up if to_up > v else v
                ahead_down = to_down if to_down < v else v
                ahead = ahead_up if upward else ahead_down
                slides = speed >= work[11 * LANES + p]
                new = ahead if slides else new
                turned = d if slides else turned
                held = low if new < low else new
                held = high if held > high else held
                moved = rises | falls | slides
                carried = fd_up if turned > 0.0 else -fd_down
                work[10 * LANES + p] = held
                work[11 * LANES + p] = restick if moved & (held == new) else np.inf
                work[12 * LANES + p] = held + carried if moved else u_s
                work[13 * LANES + p] = turned
            row = position[k, first:last]
            for p in range(width):
                row[p] = work[10 * LANES + p]
            u_last = u
            du_last = du
        for p in range(width):
            state[_POSITION, first + p] = work[10 * LANES + p]
            state[_MOVING, first + p] = 1.0 if work[11 * LANES + p] < np.inf else 0.0
            state[_STOPPED, first + p] = work[12 * LANES + p]
            state[_DIRECTION, first + p] = work[13 * LANES + p]
            state[_COMMAND, first + p] = u_last
            state[_CHANGE, first + p] = du_last


def _start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Valve at rest with residual force e(0) = share * f_s; u_s is consistent with friction, u_v(0) = u_s - d f_d."""
    state = np.zeros((6, friction.shape[1]))
    state[_POSITION] = rest_position(command0, friction, share)
    state[_DIRECTION] = 1.0
    state[_STOPPED] = state[_POSITION] + friction[FD_UP]
    state[_COMMAND] = command0
    return state


LAW = Law(
    name="kano",
    summary="stopped or moving, with the command at the last stop and the direction of friction",
    equation="stop when du*du_prev <= 0: u_s = u(k-1); stopped: -d (u-u_s) > S -> d = -d, move; d (u-u_s) > J -> move; "
             "moving: u_v = u - d f_d",
    source="Kano, Maruta, Kugemoto and Shimizu 2004",
    checked="reconstructed (the printed flow chart has not been seen)",
    cannot="a stem that comes to rest between scans of a held command; inertia; viscous friction; cannot be told "
           "from Chen's law",
    run=_run, start=_start, slips="slides",
)
