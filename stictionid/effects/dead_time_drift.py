"""Dead-time drift: the transport delay grows or shrinks along the record, as in a pipe or on a belt that slows down.

The dead time of the study is that at the start of the record; the drift is relative to it. A delay that follows the
flow through its pipe drifts as that flow does. An analyser with a long line is the usual place. Beside a dead time
that is short against the sampling step nothing shows. A stickband that grows makes slips late as well: on a loop whose
dead time grew by 80 % it left 1.3 times the noise, the base 2.0 times. A lag that grows is in no model here; it looks
alike where the lag is short.

Equation: y answers u_v(t - L(t)), L(t) = L (1 + drift t / 100,000), drift in % per 1000 s.
Source: variable transport delay, Shinskey, Process Control Systems, chapter 2; process/directional.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..process.linear import Dynamics
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

_DRIFT = Parameter("drift", "% / 1000 s", -1e6, 1e6, 0.0, "change of the dead time, relative to that at the start")
# Largest fall and rise of the dead time over a record. Unit: 1.
_FALL, _RISE = -0.9, 4.0


def _dynamics(dynamics: Dynamics, theta: FloatArray) -> Dynamics:
    return replace(dynamics, dead_time_drift=1e-5 * theta[0])


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_DRIFT, low=_FALL * 1e5 / context.length_s, high=_RISE * 1e5 / context.length_s),)


def _guess(context: Context) -> FloatArray:
    return np.array([[-0.5], [-0.25], [0.5], [1.2]]) * 1e5 / context.length_s


def _visible(scales: Scales) -> Values:
    return {"drift": 80_000.0 / scales.length_s}


EFFECT = Effect(
    name="dead-time-drift", kind="T", place=Place.PROCESS,
    summary="the transport delay grows or shrinks along the record",
    equation="y answers u_v(t - L(t)), L(t) = L (1 + drift t / 100,000)",
    source="variable transport delay, Shinskey, Process Control Systems, chapter 2", parameters=(_DRIFT,),
    confused_with=("stiction-drift",), limits=_limits, dynamics=_dynamics, guess=_guess,
    visible=_visible,
    leaves={"stretch": 6, "valve": 9, "drift": 3},
    noun="a dead time that drifts",
    sentence="The dead time changes by {drift}.",
    seen_over="time",
    action="Compare flow, belt speed or sample line at both ends of the record; tune for the longest dead time.",
    settled_by="the same step in manual at the start and at the end of a shift: the first answer comes later or sooner",
    told_apart={
        "stiction-drift": "the measured valve position, or a large step in manual early and late: only a delay moves "
                          "its first answer",
    },
)
