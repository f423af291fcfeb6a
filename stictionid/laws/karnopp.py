"""Friction model of Karnopp 1985: a stem with mass, spring, viscous and Stribeck friction that sticks at zero speed.

m x'' = k (u - x) - F_v x' - F. Stuck (x' = 0): F balances the spring while k |u - x| <= F_s. Sliding:
F = sign(x') (F_c + (F_s - F_c) exp(-(x'/v_s)^2)). Equation in % of travel: laws/physical.py.

For simulation only. The integration is exact for spring, mass and viscous friction over each part of a step, with
the Stribeck force of the part's start. A stem whose speed changes its sign stops at that point, which takes the place
of Karnopp's band of zero speed. Parts are at most a twentieth of sqrt(m/k), and a coarser step is cut.

With enough damping it reproduces S and J. A lightly damped stem overshoots at a slip (He and Wang's K). A ramp slower
than about three times v_s ends every slip at rest (stick-slip). A heavily damped stem that ends a slip stops a little
early, by about F_v/k times three Stribeck velocities. It lags behind a ramp by F_v/k times its speed.

Directions, drift and travel stops of the friction table hold (a stop takes all speed away). The re-stick, overshoot
and crossing rows have no meaning, because they follow from the physics. J > S is refused.

Source: Karnopp 1985, docs/details.md, section 3. The print has not been seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..numerics.jit import kernel
from ..typing import FloatArray
from .contract import FD_DOWN, FD_DRIFT, FD_UP, FS_DOWN, FS_DRIFT, FS_UP, LOWER, TIE, UPPER, Law, rest_position
from .physical import DAMPING, HELD, INERTIA, PART, PARTS, STEM, STEM_DEFAULTS, STRIBECK_SPEED, check_forces, stem_rows

# State rows: stem position, 1 while sliding, speed in %/s, last command.
_POSITION, _MOVING, _SPEED, _COMMAND = range(4)
# Parts of an integration step per sqrt(m/k); an undamped oscillation takes 2 pi times as many. Unit: 1.
_PARTS_PER_SWING = 20.0


@kernel
def _run(command: FloatArray, friction: FloatArray, profile: FloatArray, state: FloatArray,
         position: FloatArray) -> None:
    samples = command.size
    for p in range(friction.shape[1]):
        low, high = friction[LOWER, p], friction[UPPER, p]
        stribeck = friction[STRIBECK_SPEED, p]
        h, parts, held = friction[PART, p], int(friction[PARTS, p]), friction[HELD, p] > 0.5
        # Exact propagation over one part about the point where spring and friction balance: (y, v) -> A (y, v).
        half = 0.5 * friction[DAMPING, p] / friction[INERTIA, p]
        stiff = 1.0 / friction[INERTIA, p]
        split = half * half - stiff
        if split < 0.0:
            w = math.sqrt(-split)
            even = math.exp(-half * h) * math.cos(w * h)
            odd = math.exp(-half * h) * math.sin(w * h) / w
        elif split > 1e-12 * stiff:
            w = math.sqrt(split)
            # half - w without the loss of digits that heavy damping would bring
            slow, fast = math.exp(-stiff / (half + w) * h), math.exp(-(half + w) * h)
            even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / w
        else:
            even, odd = math.exp(-half * h), h * math.exp(-half * h)
        a_yy, a_yv, a_vy, a_vv = even + half * odd, odd, -stiff * odd, even - half * odd
        x, v, u_last = state[_POSITION, p], state[_SPEED, p], state[_COMMAND, p]
        for k in range(samples):
            u_end = command[k]
            u_start = u_end if held else u_last
            fs_add, fd_add = friction[FS_DRIFT, p] * profile[k], friction[FD_DRIFT, p] * profile[k]
            fs_up, fs_down = friction[FS_UP, p] + fs_add, friction[FS_DOWN, p] + fs_add
            fd_up, fd_down = friction[FD_UP, p] + fd_add, friction[FD_DOWN, p] + fd_add
            slope = (u_end - u_start) / parts
            for j in range(parts):
                if v == 0.0:
                    e = u_start + (j + 1.0) * slope - x
                    if -fs_down - TIE <= e <= fs_up + TIE or (e > 0.0 and x >= high) or (e < 0.0 and x <= low):
                        continue
                    direction = 1.0 if e > 0.0 else -1.0
                else:
                    direction = 1.0 if v > 0.0 else -1.0
                fs, fd = (fs_up, fd_up) if direction > 0.0 else (fs_down, fd_down)
                ratio = v / stribeck
                centre = u_start + (j + 0.5) * slope - direction * (fd + (fs - fd) * math.exp(-ratio * ratio))
                y = x - centre
                x_new = centre + a_yy * y + a_yv * v
                v_new = a_vy * y + a_vv * v
                if v_new * direction <= 0.0:
                    # The stop lies inside this part: the position at which a linearly falling speed reaches zero.
                    x_new = x + (0.5 * v * h * v / (v - v_new) if v != 0.0 else 0.0)
                    v_new = 0.0
                if x_new > high or x_new < low:
                    x_new = high if x_new > high else low
                    v_new = 0.0
                x, v = x_new, v_new
            u_last = u_end
            position[k, p] = x
        state[_POSITION, p], state[_SPEED, p], state[_COMMAND, p] = x, v, u_last
        state[_MOVING, p] = 1.0 if v != 0.0 else 0.0


def _start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Stem at rest with residual force e(0) = share * f_s, within its stops."""
    state = np.zeros((4, friction.shape[1]))
    state[_POSITION] = rest_position(command0, friction, share)
    state[_COMMAND] = command0
    return state


def _supply(table: FloatArray, values: Mapping[str, float], step_s: float, held: bool) -> FloatArray:
    return stem_rows(table, values, step_s=step_s, held=held, parts_per_swing=_PARTS_PER_SWING)


LAW = Law(
    name="karnopp",
    summary="physical stem that sticks exactly at standstill (simulation only)",
    equation="m x'' = k (u - x) - F_v x' - F; stuck: |F| <= F_s; sliding: F = sign(x') (F_c + (F_s - F_c) "
             "exp(-(x'/v_s)^2))",
    source="Karnopp 1985",
    checked="reconstructed (from the description in the literature; the print has not been seen)",
    cannot="J > S; motion before break-away; friction that remembers (LuGre has both of these)",
    run=_run, start=_start, searchable=False, dynamic=True,
    parameters=STEM, defaults=STEM_DEFAULTS, check=check_forces, supply=_supply,
)
