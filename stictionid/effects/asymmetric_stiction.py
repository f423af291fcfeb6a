"""Asymmetric stiction: the slip jump differs between the two directions of travel.

f_s and f_d per direction are four numbers; beside a free bias in the linear part only three are identifiable. So S
stays the mean of both reversals, and each direction has its own slip jump. J is the mean of both jumps. The search
moves their difference, which vanishes for a symmetric valve.

Equation: f_s = (S + J_dir)/2, f_d = (S - J_dir)/2 with J_dir = jump_up or jump_down. Source: Shang et al., Eq. 1 per
direction; docs/details.md, sections 3 and 5.
"""

from __future__ import annotations

import numpy as np

from ..laws.contract import FD_DOWN, FD_UP, FS_DOWN, FS_UP
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_UP = Parameter("jump_up", "%", 0.0, 100.0, 0.0, "slip jump of the opening valve")
_DOWN = Parameter("jump_down", "%", 0.0, 100.0, 0.0, "slip jump of the closing valve")


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    # Neither jump is negative.
    most = 2.0 * (table[FS_UP] - table[FD_UP])
    half = 0.25 * np.clip(theta[0], -most, most)
    table[FS_UP] += half
    table[FD_UP] -= half
    table[FS_DOWN] -= half
    table[FD_DOWN] += half
    return table


def _limits(context: Context) -> tuple[Parameter, ...]:
    reach = 1.2 * context.s_max
    return (Parameter("jump_difference", "%", -reach, reach, 0.0, "slip jump up minus slip jump down"),)


def _guess(context: Context) -> FloatArray:
    return context.s_max * np.array([[-0.4], [-0.15], [0.15], [0.4]])


def _report(searched: Values, sizes: FloatArray, base: Values) -> dict[str, float]:
    half = float(np.clip(0.5 * searched["jump_difference"], -base["J"], base["J"]))
    return {"jump_up": base["J"] + half, "jump_down": base["J"] - half}


def _setting(values: Values, S: float, J: float) -> tuple[FloatArray, float, float]:
    up, down = values["jump_up"], values["jump_down"]
    return np.array([[up - down]]), S, 0.5 * (up + down)


def _visible(scales: Scales) -> Values:
    return {"jump_up": 1.4 * scales.J, "jump_down": 0.6 * scales.J}


EFFECT = Effect(
    name="asymmetric-stiction", kind="F", place=Place.FRICTION,
    summary="the valve jumps further one way than the other",
    equation="f_s = (S + J_dir)/2, f_d = (S - J_dir)/2, J_dir = jump_up or jump_down",
    source="Shang et al., Eq. 1 per direction; docs/details.md, section 5", parameters=(_UP, _DOWN), limits=_limits,
    friction=_friction, guess=_guess, report=_report, setting=_setting,
    visible=_visible, known_as={"jump_difference": "jump_up - jump_down"},
    leaves={"slip": 4, "direction": 1, "cycle": 4, "own line": 2},
    noun="slip jumps that differ by direction",
    sentence="The valve jumps by {jump_up} when it opens and by {jump_down} when it closes.",
    seen_over="direction",
    action="Look for what loads the stem one way: spring range, packing or an unbalanced plug.",
    settled_by="the measured valve position, or a slow ramp in manual both ways",
    told_apart={
        "re-sticking": "the measured valve position, or a slow ramp in manual both ways",
        "stiction-drift": "a second record some hours later: asymmetry stays, a drift goes on",
    },
)
