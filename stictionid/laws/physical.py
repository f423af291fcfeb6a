"""Stem of a physical valve in SI units: conversion of its forces to S and J and back, and rows for the kernels.

A stem of `mass` m (kg) on a `spring` k (N/m) over its `travel` (m) with viscous friction F_v (N s/m) moves, in % of
travel, by

    (m/k) x'' = u - x - (F_v/k) x' - F,    |F| = f_d + (f_s - f_d) exp(-(x'/v_s)^2) while it slides,

with f_s = 100 F_s / (k travel), f_d = 100 F_c / (k travel) and S = f_s + f_d, J = f_s - f_d (docs/details.md, section
1). The friction table carries f_s and f_d as for every law. Rows after ROWS carry numbers derived from the SI values
and the time between two commands. J can't exceed S, because Coulomb friction is not negative.

The default valve has m = 3 lb, k = 300 lbf/in, travel 4 in and F_v = 3.5 lbf s/in. The literature on friction models
of control valves has used it since Kayihan and Doyle 2000; quoted, not checked in print. Only v_s differs: it is a
tenth of theirs (2.54e-4 m/s). With theirs a stem sticks and slips on every ramp slower than 0.7 % of travel per
second, and most loops' commands are slower. Both are valves one may meet. The first slides under a continuous command,
as in Chen's law; the second rests after each slip, as in He's law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..errors import ModelError
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import ROWS, check_stiction

MASS = Parameter("mass", "kg", 1e-3, 1e3, 1.36, "stem, plug and diaphragm plate")
SPRING = Parameter("spring", "N/m", 1.0, 1e8, 52500.0, "actuator spring")
TRAVEL = Parameter("travel", "m", 1e-4, 10.0, 0.1016, "full stroke")
VISCOUS = Parameter("viscous", "N s/m", 0.0, 1e8, 613.0, "viscous friction F_v")
STRIBECK = Parameter("stribeck_velocity", "m/s", 1e-7, 10.0, 2.54e-5, "speed v_s at which static friction fades")
STEM = (MASS, SPRING, TRAVEL, VISCOUS, STRIBECK)
STEM_DEFAULTS = {p.name: p.neutral for p in STEM}

# Rows after ROWS: m/k (s^2), F_v/k (s), v_s (% of travel per s), integration step (s), steps between two commands.
# Then 1 where the command is held between samples, and two more that each law uses as it needs.
INERTIA, DAMPING, STRIBECK_SPEED, PART, PARTS, HELD, OWN_A, OWN_B = range(ROWS, ROWS + 8)
PHYSICAL_ROWS = ROWS + 8
# Largest number of parts between two commands; more take seconds for one sample and are refused. Unit: 1.
MOST_PARTS = 2_000_000


def forces_of(stickband: float, slip_jump: float, *, spring: float, travel: float) -> tuple[float, float]:
    """Static and Coulomb friction (F_s, F_c) in N of a valve with S and J in %, spring in N/m and travel in m.

    Raises ModelError for J > S (F_c would be negative) and for a spring or travel that is not above 0.
    """
    check_forces(stickband, slip_jump)
    _positive("spring", spring, "N/m")
    _positive("travel", travel, "m")
    newton = spring * travel / 100.0
    return 0.5 * (stickband + slip_jump) * newton, 0.5 * (stickband - slip_jump) * newton


def stiction_of(static_force: float, coulomb_force: float, *, spring: float, travel: float) -> tuple[float, float]:
    """S and J in % of a valve with static and Coulomb friction in N: the inverse of `forces_of`.

    Raises ModelError for F_s < F_c, F_c < 0 and for a spring or travel that is not above 0.
    """
    _positive("spring", spring, "N/m")
    _positive("travel", travel, "m")
    if not (math.isfinite(coulomb_force) and coulomb_force >= 0):
        raise ModelError(f"Coulomb friction F_c = {coulomb_force:g} N must not be negative", "give F_c >= 0")
    if not (math.isfinite(static_force) and static_force >= coulomb_force):
        raise ModelError(f"static friction F_s = {static_force:g} N is below Coulomb friction F_c = "
                         f"{coulomb_force:g} N, so the stem would never stick", f"give F_s >= {coulomb_force:g}")
    percent = 100.0 / (spring * travel)
    return (static_force + coulomb_force) * percent, (static_force - coulomb_force) * percent


def check_forces(stickband: FloatArray | float, slip_jump: FloatArray | float) -> None:
    """Refuse S and J as `check_stiction` does, and J > S: Coulomb friction f_d = (S-J)/2 would be negative."""
    check_stiction(stickband, slip_jump)
    S, J = np.broadcast_arrays(np.atleast_1d(stickband), np.atleast_1d(slip_jump))
    over = J > S * (1 + 1e-12)
    if over.any():
        raise ModelError(f"a physical valve can't have J = {J[over][0]:g} % above S = {S[over][0]:g} %: its Coulomb "
                         "friction would be negative", f"give J <= {S[over][0]:g}, or a data-driven law")


def stem_rows(table: FloatArray, values: Mapping[str, float], *, step_s: float, held: bool,
              parts_per_swing: float) -> FloatArray:
    """The friction table (ROWS, P) with the stem's rows appended: (PHYSICAL_ROWS, P).

    A `step_s` is cut into equal parts, at least `parts_per_swing` in a time of sqrt(m/k). Raises
    ModelError for a mass, spring, travel or Stribeck velocity not above 0, negative viscous friction, and where
    more than MOST_PARTS parts would be needed.
    """
    for p in STEM:
        if p is not VISCOUS:
            _positive(p.name.replace("_", " "), values[p.name], p.unit)
    viscous, spring = values["viscous"], values["spring"]
    if not (math.isfinite(viscous) and viscous >= 0):
        raise ModelError(f"viscous friction F_v = {viscous:g} N s/m must not be negative", "give F_v >= 0")
    _positive("time between two commands", step_s, "s")
    part_s = max(math.sqrt(values["mass"] / spring) / parts_per_swing, 1e-300)
    parts = max(1, math.ceil(step_s / part_s - 1e-9))
    if parts > MOST_PARTS:
        raise ModelError(f"a step of {step_s:g} s is too coarse for this stem: it would take {parts:.3g} parts of "
                         f"{part_s:.3g} s", f"give a step of at most {MOST_PARTS * part_s:.3g} s, or a larger mass")
    rows = np.zeros((PHYSICAL_ROWS, table.shape[1]))
    rows[:ROWS] = table
    rows[INERTIA] = values["mass"] / spring
    rows[DAMPING] = viscous / spring
    rows[STRIBECK_SPEED] = 100.0 * values["stribeck_velocity"] / values["travel"]
    rows[PART], rows[PARTS], rows[HELD] = step_s / parts, parts, float(held)
    return rows


def _positive(what: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ModelError(f"the {what} of the valve is {value:g} {unit}, it must be above 0", f"give a {what} above 0")
