"""Valve behind a positioner that integrates: the stem moves while the command rests.

The force on the stem is u + w - u_v, and w' = rate (u - u_v). The stem rests until the force exceeds f_s, then jumps to
where it is f_d, and rests again: w moves more slowly than a stem needs to keep sliding. So any law becomes that of He
at every instant. Between two commands the force is a straight line, so the instant of a slip is known. A position is
the mean over the part of a held command that follows a row, or over the part of a moving one that ends there. At a hard
stop w waits while the force pushes on. Wrong where the stem needs a noticeable time to move.

Source: docs/details.md, section 3 (He's law) and a PI controller of the stem, integral part alone beside a gain of 1.
"""

from __future__ import annotations

from ...numerics.jit import kernel
from ...typing import FloatArray

# Most slips in one part; then the shortest slip, and the excess over f_s that makes one, in %. Else the stem slides.
_MOST, _SHORTEST = 16, 1e-9
# States: position and w of every lane, last command.
STATES = 3


@kernel
def run_inner(command: FloatArray, forces: FloatArray, profile: FloatArray, moving: bool, state: FloatArray,
              position: FloatArray) -> None:
    """Fill position (n, P) for forces (10, P): f_s and f_d by direction, their drifts, K, stops, rate."""
    for p in range(position.shape[1]):
        v, w, last = state[0, p], state[1, p], state[2, p]
        K, low, high, rate = forces[6, p], forces[7, p], forces[8, p], forces[9, p]
        for k in range(command.size):
            u = command[k]
            fs_add, fd_add = forces[4, p] * profile[k], forces[5, p] * profile[k]
            fs_up, fs_down = forces[0, p] + fs_add, forces[1, p] + fs_add
            start = last if moving else u
            rise, pull = u - start, 0.5 * (u + start)
            e, left, total = start + w - v, 1.0, 0.0
            slips = 0
            while left > 0.0:
                slope = rise + rate * (pull - v)
                # Share of the part until the force leaves the band of static friction.
                share = left
                if e > fs_up + _SHORTEST or -e > fs_down + _SHORTEST:
                    share = 0.0
                elif slope > 0.0:
                    share = min((fs_up - e) / slope, left)
                elif slope < 0.0:
                    share = min((-fs_down - e) / slope, left)
                share = max(share, 0.0)
                total += share * v
                e += share * slope
                w += share * rate * (pull - v)
                left -= share
                if left <= 0.0:
                    break
                slips += 1
                behind = forces[2, p] + fd_add if e > 0.0 else -(forces[3, p] + fd_add)
                place = min(max(v + K * (e - behind), low), high)
                if place == v and ((place == low and e < 0.0) or (place == high and e > 0.0)):
                    total += left * v
                    break
                if slips > _MOST or abs(place - v) < _SHORTEST:
                    # The stem keeps up with the force.
                    way = min(max(left * slope, low - v), high - v)
                    total += left * (v + 0.5 * way)
                    w += left * rate * (pull - v)
                    v += way
                    break
                e -= place - v
                v = place
            last = u
            position[k, p] = total
        state[0, p], state[1, p], state[2, p] = v, w, last
