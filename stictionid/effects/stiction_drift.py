"""Stiction drift: stickband and slip jump grow along the record (packing heats up, lubrication is lost).

`estimate.S` and `estimate.J` are the values at the start. Wrong where stiction changes in jumps.

Under a held command a sliding stem whose kinetic friction grows comes to rest between two scans. It then sticks at
every sample, as in He's law. Where the friction falls it slides on slowly. Under a moving command neither happens.

Equation: S(t) = S + stickband_growth t/1000 s, J(t) = J + jump_growth t/1000 s. Source: docs/details.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..laws.contract import FD_DRIFT, FS_DRIFT, RESTICK
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_SPAN_S = 1000.0
_S = Parameter("stickband_growth", "% / 1000 s", -100.0, 100.0, 0.0, "growth of S")
_J = Parameter("jump_growth", "% / 1000 s", -100.0, 100.0, 0.0, "growth of J")


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    table[FS_DRIFT] += 0.5 * (theta[0] + theta[1])
    table[FD_DRIFT] += 0.5 * (theta[0] - theta[1])
    if held:
        table[RESTICK] = np.where(table[FD_DRIFT] > 0.0, np.inf, table[RESTICK])
    return table


def _profile(time_s: FloatArray) -> FloatArray:
    return time_s / _SPAN_S


def _limits(context: Context) -> tuple[Parameter, ...]:
    reach = context.s_max * _SPAN_S / context.length_s
    return replace(_S, low=-reach, high=reach), replace(_J, low=-0.6 * reach, high=0.6 * reach)


def _guess(context: Context) -> FloatArray:
    return context.s_max * _SPAN_S / context.length_s * np.array([[-0.3, 0.0], [-0.1, 0.0], [0.1, 0.0], [0.3, 0.0]])


def _visible(scales: Scales) -> Values:
    return {"stickband_growth": 300.0 * scales.S / scales.length_s, "jump_growth": 100.0 * scales.J / scales.length_s}


EFFECT = Effect(
    name="stiction-drift", kind="F", place=Place.FRICTION,
    summary="stickband and slip jump grow along the record",
    equation="S(t) = S + g_S t/1000 s, J(t) = J + g_J t/1000 s",
    source="docs/details.md, section 5", parameters=(_S, _J), limits=_limits, friction=_friction, profile=_profile,
    guess=_guess,
    visible=_visible,
    leaves={"stretch": 1, "drift": 2, "slide": 3},
    noun="friction that changes along the record",
    sentence="Along the record [the stickband grows by {stickband_growth}|the slip jump by {jump_growth}].",
    seen_over="time",
    action="Record the loop again some hours later: friction that goes on growing needs maintenance soon.",
    settled_by="a second record some hours later",
)
