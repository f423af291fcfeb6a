"""Stiction law of Chen 2008: a two-layer binary tree (the paper's law).

Layer 1 asks whether the valve is stuck or moving. Layer 2 asks whether |e| > f_s (stuck), or whether the command kept
its direction (moving). The four leaves are keep sticking, slip, keep sliding, and stop. After a stop |e| > f_s is
tested again in the same sample.

The printed 2008 flow chart has not been seen. This form is reconstructed from Shang et al., Eq. 1, from He's law and
from the description in the paper. It equals Kano's law on every test signal when both start alike. Wrong where the stem
comes to rest between scans (then He's law holds; see the effect re-sticking).

Source: Chen et al. 2008, docs/details.md, section 3.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import LANES, LINE, kernel
from ..typing import FloatArray
from .contract import CROSSES, FS_DOWN, FS_UP, LOWER, OVERSHOOT, RESTICK, TIE, UPPER, Law

# State rows: stem position, 1 while moving, last command and last change of command (equal in all lanes).
_POSITION, _MOVING, _COMMAND, _CHANGE = 0, 1, 2, 3
# Rows of the working table: the friction rows up to UPPER, the position, the restick speed while moving (infinite while
# stuck), and CROSSES.
_WORK = 13
# Smallest slip of a valve that rests behind each, in %; with smaller ones it slides.
_LEAST = 1e-3


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
            work[10 * LANES + p] = state[_POSITION, q]
            work[11 * LANES + p] = friction[RESTICK, q] if state[_MOVING, q] > 0.5 else np.inf
            work[12 * LANES + p] = friction[CROSSES, q]
        last = first + width
        # The plain law has no drift, overshoot or stops, and rests under a held command at most; it is faster, and most
        # searches need no other.
        plain, crossing = True, False
        for p in range(padded):
            plain &= work[4 * LANES + p] == 0.0 and work[5 * LANES + p] == 0.0
            plain &= work[6 * LANES + p] == 0.0 or work[12 * LANES + p] == 0.0
            plain &= work[7 * LANES + p] == 0.0 and work[8 * LANES + p] == -np.inf and work[9 * LANES + p] == np.inf
            crossing |= work[12 * LANES + p] > 0.0
        u_last = state[_COMMAND, first]
        du_last = state[_CHANGE, first]
        for k in range(samples):
            u = command[k]
            du = u - u_last
            # Speed of a command that kept its direction; -1 after a reversal or a rest, so that nothing slides.
            speed = abs(du) if du * du_last > 0.0 else -1.0
            rising = du > 0.0
            drift = profile[k]
            for p in range(padded if plain else 0):
                v, restick = work[10 * LANES + p], work[6 * LANES + p]
                to_up, to_down = u - work[2 * LANES + p], u + work[3 * LANES + p]
                e = u - v
                rises, falls = e > work[p], -e > work[LANES + p]
                new = to_up if rises else v
                new = to_down if falls else new
                ahead_up = to_up if to_up > v else v
                ahead_down = to_down if to_down < v else v
                ahead = ahead_up if rising else ahead_down
                slides = speed >= work[11 * LANES + p]
                work[10 * LANES + p] = ahead if slides else new
                work[11 * LANES + p] = restick if rises | falls | slides else np.inf
            for p in range(0 if plain else padded):
                v, moving_from, restick = work[10 * LANES + p], work[11 * LANES + p], work[6 * LANES + p]
                spare, low, high = work[7 * LANES + p], work[8 * LANES + p], work[9 * LANES + p]
                fs_add, fd_add = work[4 * LANES + p] * drift, work[5 * LANES + p] * drift
                fs_up, fs_down = work[p] + fs_add, work[LANES + p] + fs_add
                fd_up, fd_down = work[2 * LANES + p] + fd_add, work[3 * LANES + p] + fd_add
                to_up, to_down = u - fd_up, u + fd_down
                e = u - v
                rises, falls = e > fs_up, -e > fs_down
                # stuck: keep sticking, or slip and overshoot by `spare` = K - 1
                up, down = to_up + spare * (to_up - v), to_down + spare * (to_down - v)
                rests = False
                if crossing:
                    # (a command that moves within the sample: from where it crosses f_s, and slide on from there)
                    jump_up, jump_down = (1.0 + spare) * (fs_up - fd_up), (1.0 + spare) * (fs_down - fd_down)
                    least = jump_up if jump_up < jump_down else jump_down
                    rests = (abs(du) < restick) & (least > _LEAST)
                    # it comes to rest behind each slip, and slips again where the command crosses f_s again
                    slips_up, slips_down = np.ceil((e - fs_up) / jump_up), np.ceil((-e - fs_down) / jump_down)
                    up = v + jump_up if v + jump_up > to_up else to_up
                    down = v - jump_down if v - jump_down < to_down else to_down
                    up = v + jump_up * (slips_up if slips_up > 1.0 else 1.0) if rests else up
                    down = v - jump_down * (slips_down if slips_down > 1.0 else 1.0) if rests else down
                new = up if rises else v
                new = down if falls else new
                # moving: keep sliding; after an overshoot the stem waits until the command has caught up
                ahead_up = to_up if to_up > v else v
                ahead_down = to_down if to_down < v else v
                ahead = ahead_up if rising else ahead_down
                slides = speed >= moving_from
                new = ahead if slides else new
                held = low if new < low else new
                held = high if held > high else held
                work[10 * LANES + p] = held
                work[11 * LANES + p] = restick if (((rises | falls) & (not rests)) | slides) & (held == new) else np.inf
            row = position[k, first:last]
            for p in range(width):
                row[p] = work[10 * LANES + p]
            u_last = u
            du_last = du
        for p in range(width):
            state[_POSITION, first + p] = work[10 * LANES + p]
            state[_MOVING, first + p] = 1.0 if work[11 * LANES + p] < np.inf else 0.0
            state[_COMMAND, first + p] = u_last
            state[_CHANGE, first + p] = du_last


def _start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Valve at rest with residual force e(0) = share * f_s, within its stops."""
    state = np.empty((4, friction.shape[1]))
    _rest(command0, friction, share, state)
    return state


@kernel
def _rest(command0: float, friction: FloatArray, share: FloatArray, state: FloatArray) -> None:
    for p in range(share.size):
        fs = friction[FS_UP, p] if share[p] > 0.0 else friction[FS_DOWN, p]
        state[_POSITION, p] = min(max(command0 - share[p] * fs, friction[LOWER, p]), friction[UPPER, p])
        state[_MOVING, p] = 0.0
        state[_COMMAND, p] = command0
        state[_CHANGE, p] = 0.0


LAW = Law(
    name="chen",
    summary="two-layer binary tree: keep sticking, slip, keep sliding, stop",
    equation="stuck: |e| > f_s -> moving, u_v = u - sign(e) f_d, else hold; moving: du*du_prev > 0 -> "
             "u_v = u - sign(du) f_d, else stop and re-test",
    source="Chen et al. 2008",
    checked="reconstructed (the printed flow chart has not been seen)",
    cannot="a stem that comes to rest between scans of a held command; inertia; viscous friction",
    run=_run, start=_start, slips="slides",
)
