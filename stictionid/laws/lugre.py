"""Friction model LuGre (Canudas de Wit 1995): the bending z of bristles, with creep of a stuck stem before it slips.

m x'' = k (u - x) - F_v x' - (s0 z + s1 z'), z' = x' - s0 |x'| z / g(x'), g = F_c + (F_s - F_c) exp(-(x'/v_s)^2),
with s1 fading as exp(-(x'/v_s)^2), so that the bristles never push. In % of travel, with s0 and s1 divided by the
spring constant: laws/physical.py.

For simulation only. Each part of a step is implicit in speed and bending, with |x'| / g of the part's start. Stiff
bristles then need no smaller parts. A part ends where the speed changes its sign. The integration is of first order;
parts are at most a hundredth of sqrt(m/k), and a coarser step is cut.

The stem moves by f/s0 before it breaks away, and breaks away early when that motion is not slow against v_s. The
bristles often quoted (s0 = 1e8 N/m) lose 3 to 5 % of S at 2 %/s. A command in steps of 0.3 % then moves the stem at a
third of f_s. The default bristles are stiff and damped enough to keep S and J within 1 %. That was measured for S = 5,
J = 3 and ramps of 0.5 to 2 %/s. Small vibrations below break-away make the stem drift, a known fault of the law.

Directions, drift and travel stops of the friction table hold. The re-stick, overshoot and crossing rows have no
meaning, because they follow from the physics. J > S is refused. "Sliding" in the state means faster than the Stribeck
speed.

Source: Canudas de Wit, Olsson, Astrom and Lischinsky 1995, docs/details.md, section 3. The print has not been seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..errors import ModelError
from ..numerics.jit import kernel
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import FD_DOWN, FD_DRIFT, FD_UP, FS_DOWN, FS_DRIFT, FS_UP, LOWER, UPPER, Law, rest_position
from .physical import (
    DAMPING,
    HELD,
    INERTIA,
    OWN_A,
    OWN_B,
    PART,
    PARTS,
    STEM,
    STEM_DEFAULTS,
    STRIBECK,
    STRIBECK_SPEED,
    check_forces,
    stem_rows,
)

# State rows: stem position, 1 while sliding, speed in %/s, last command, bending z in %.
_POSITION, _MOVING, _SPEED, _COMMAND, _BENDING = range(5)
# Integration parts per sqrt(m/k); more than Karnopp's because the implicit step is of first order. Unit: 1.
_PARTS_PER_SWING = 100.0
# Speed below which a stem under a resting command rests, if its next speed is lower still. Unit: % of travel per s.
_AT_REST = 1e-10
# Bristles so stiff, and their bending so slow (s1/s0 = 10 ms), that a valve breaks away at F_s (module docstring).
_STIFFNESS = Parameter("bristle_stiffness", "N/m", 1e3, 1e12, 2e9, "s0: force per bending of the bristles")
_BRISTLE_DAMPING = Parameter("bristle_damping", "N s/m", 0.0, 1e10, 2e7, "s1: force per speed of their bending")
# Four times Karnopp's default, because the speed before break-away must stay below it. Unit: m/s.
_STRIBECK_DEFAULT = 1e-4


@kernel
def _run(command: FloatArray, friction: FloatArray, profile: FloatArray, state: FloatArray,
         position: FloatArray) -> None:
    samples = command.size
    for p in range(friction.shape[1]):
        low, high = friction[LOWER, p], friction[UPPER, p]
        inertia, damping, stribeck = friction[INERTIA, p], friction[DAMPING, p], friction[STRIBECK_SPEED, p]
        s0, s1_rest = friction[OWN_A, p], friction[OWN_B, p]
        h, parts, held = friction[PART, p], int(friction[PARTS, p]), friction[HELD, p] > 0.5
        x, v, z, u_last = state[_POSITION, p], state[_SPEED, p], state[_BENDING, p], state[_COMMAND, p]
        for k in range(samples):
            u_end = command[k]
            u_start = u_end if held else u_last
            fs_add, fd_add = friction[FS_DRIFT, p] * profile[k], friction[FD_DRIFT, p] * profile[k]
            slope = (u_end - u_start) / parts
            for j in range(parts):
                upward = v > 0.0 or (v == 0.0 and z > 0.0)
                fs = friction[FS_UP, p] + fs_add if upward else friction[FS_DOWN, p] + fs_add
                fd = friction[FD_UP, p] + fd_add if upward else friction[FD_DOWN, p] + fd_add
                ratio = v / stribeck
                fading = math.exp(-ratio * ratio)
                g, s1 = fd + (fs - fd) * fading, s1_rest * fading
                # Share of the bending that the bristles keep over this part; 0 without friction.
                keeps = 1.0 / (1.0 + h * s0 * abs(v) / g) if g > 0.0 else 0.0
                drive = u_start + (j + 1.0) * slope - x - (s0 * keeps - s1 * (1.0 - keeps) / h) * z
                v_new = (inertia * v / h + drive) / (inertia / h + h + damping + (s0 * h + s1) * keeps)
                way = h * v_new
                if v_new * v < 0.0:
                    # A part ends at standstill at the latest: friction is highest there and the stem may stick.
                    way, v_new = 0.5 * h * v * v / (v - v_new), 0.0
                x_new = x + way
                z = keeps * (z + way)
                if x_new > high or x_new < low:
                    x_new = high if x_new > high else low
                    v_new = 0.0
                resting = slope == 0.0 and abs(v) < _AT_REST and abs(v_new) < _AT_REST
                x, v = x_new, v_new
                if resting:
                    v = 0.0
                    break
            u_last = u_end
            position[k, p] = x
        state[_POSITION, p], state[_SPEED, p], state[_COMMAND, p], state[_BENDING, p] = x, v, u_last, z
        state[_MOVING, p] = 1.0 if abs(v) > stribeck else 0.0


def _start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Stem at rest with residual force e(0) = share * f_s carried by its bristles, within its stops."""
    state = np.zeros((5, friction.shape[1]))
    state[_POSITION] = rest_position(command0, friction, share)
    state[_BENDING] = np.clip(command0 - state[_POSITION], -friction[FS_DOWN], friction[FS_UP]) / friction[OWN_A]
    state[_COMMAND] = command0
    return state


def _supply(table: FloatArray, values: Mapping[str, float], step_s: float, held: bool) -> FloatArray:
    rows = stem_rows(table, values, step_s=step_s, held=held, parts_per_swing=_PARTS_PER_SWING)
    s0, s1 = values["bristle_stiffness"], values["bristle_damping"]
    if not (math.isfinite(s0) and s0 > 0):
        raise ModelError(f"the bristle stiffness s0 = {s0:g} N/m must be above 0", "give s0 above the spring, 1000 k")
    if not (math.isfinite(s1) and s1 >= 0):
        raise ModelError(f"the bristle damping s1 = {s1:g} N s/m must not be negative", "give s1 >= 0")
    rows[OWN_A], rows[OWN_B] = s0 / values["spring"], s1 / values["spring"]
    return rows


LAW = Law(
    name="lugre",
    summary="physical stem on bristles that bend before they slip (simulation only)",
    equation="m x'' = k (u - x) - F_v x' - s0 z - s1 exp(-(x'/v_s)^2) z'; z' = x' - s0 |x'| z / g(x'); "
             "g = F_c + (F_s - F_c) exp(-(x'/v_s)^2)",
    source="Canudas de Wit, Olsson, Astrom and Lischinsky 1995",
    checked="reconstructed (from the description in the literature; the print has not been seen)",
    cannot="J > S; an exact standstill: it creeps under vibration below break-away",
    run=_run, start=_start, searchable=False, dynamic=True,
    parameters=(*STEM, _STIFFNESS, _BRISTLE_DAMPING),
    defaults={**STEM_DEFAULTS, STRIBECK.name: _STRIBECK_DEFAULT,
              _STIFFNESS.name: _STIFFNESS.neutral, _BRISTLE_DAMPING.name: _BRISTLE_DAMPING.neutral},
    check=check_forces, supply=_supply,
)
