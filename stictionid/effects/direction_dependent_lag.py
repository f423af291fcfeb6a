"""Direction-dependent lag: the process follows the opening valve faster than the closing one, or the other way.

Heating is active and cooling is not; a tank fills by a pump and drains by its own head. The time constant of the base
holds while the process rises with the valve; while it falls it is `closing_ratio` times that. With a negative gain the
process value falls while the valve opens. Beside a cycle whose two halves are alike it can't be told from a gain that
changes with y, or from slip jumps that differ by direction.

Equation: T x' = u_v(t - L) - x, T = T1 where x rises, closing_ratio T1 where it falls; y = K x.
Source: bilinear lag of a heat balance, e.g. Shinskey, Process Control Systems, chapter 2.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..process.linear import Dynamics
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_RATIO = Parameter("closing_ratio", "-", 0.1, 10.0, 1.0, "time constant of closing moves, in that of opening ones",
                   log=True)


def _dynamics(dynamics: Dynamics, theta: FloatArray) -> Dynamics:
    return replace(dynamics, closing=theta[0])


def _guess(context: Context) -> FloatArray:
    return np.array([[0.4], [0.7], [1.4], [2.5]])


def _visible(scales: Scales) -> Values:
    return {"closing_ratio": 2.0}


EFFECT = Effect(
    name="direction-dependent-lag", kind="T", place=Place.PROCESS,
    summary="the process follows the opening valve faster than the closing one, or the other way",
    equation="T x' = u_v(t - L) - x, T = T1 where x rises, closing_ratio T1 where it falls; y = K x",
    source="lag of a heat balance, Shinskey, Process Control Systems, chapter 2", parameters=(_RATIO,),
    confused_with=("asymmetric-stiction", "gain-nonlinearity"), dynamics=_dynamics, guess=_guess,
    visible=_visible,
    leaves={"direction": 4, "valve": 8},
    noun="a lag that depends on direction",
    sentence="A closing move takes {closing_ratio} times as long as an opening one.",
    seen_over="direction",
    action="Tune the controller for the slower direction.",
    settled_by="a step in manual up and one down: their times differ, their sizes do not",
    told_apart={
        "asymmetric-stiction": "steps in manual both ways, far larger than S: friction then hardly matters",
        "gain-nonlinearity": "steps in manual both ways about one value: a lag differs in time, a gain in size",
    },
)
