"""Measurement filter of a known time constant: the transmitter or the historian smooths the process value.

In u and y a filter is one more lag, wherever it stands, so a free one is the effect extra-lag. This one is for a filter
whose time constant is known: `measurement-filter:5` is one of 5 s, which is held. The time constants of the study are
then those of the process alone.

Equation: y = x / (time_constant_s s + 1), x the process value before the filter.
Source: first-order filter of a transmitter; exact discretisation in process/state_space.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..process.linear import Dynamics
from ..process.state_space import element_of
from ..typing import FloatArray
from .contract import BY_HAND, Effect, Place, Scales, Values, known_value

_PARAMETER = Parameter("time_constant_s", "s", 0.0, 1e5, 0.0, "time constant of the filter, known")


def _dynamics(dynamics: Dynamics, theta: FloatArray) -> Dynamics:
    if not theta[0].any():
        return dynamics
    one = np.ones_like(dynamics.time_constant_s)
    element = element_of(np.stack([0.0 * one, one]), np.stack([theta[0] * one, one]))
    return replace(dynamics, elements=(*dynamics.elements, element))


def _known(option: str) -> Effect:
    """The effect with the time constant that its name gives."""
    given = np.array([known_value("measurement-filter", option, _PARAMETER)])

    def dynamics(before: Dynamics, theta: FloatArray) -> Dynamics:
        return _dynamics(before, given[:, None])

    def report(searched: Mapping[str, float], sizes: FloatArray, base: Mapping[str, float]) -> dict[str, float]:
        return {_PARAMETER.name: float(given[0])}

    return replace(EFFECT, searched=(), dynamics=dynamics, report=report)


def _visible(scales: Scales) -> Values:
    return {"time_constant_s": 0.5 * scales.lag_s}


EFFECT = Effect(
    name="measurement-filter", kind="T", place=Place.PROCESS,
    summary="a filter of known time constant smooths the process value",
    equation="y = x / (time_constant_s s + 1), x the process value before the filter",
    source="first-order filter of a transmitter", parameters=(_PARAMETER,), confused_with=("extra-lag",),
    needs=("value",), asked=BY_HAND, dynamics=_dynamics, known=_known,
    visible=_visible,
    noun="a filter of {time_constant_s}",
    sentence="A filter of {time_constant_s} smooths PV before it is recorded.",
    seen_over="direction",
    action="Shorten the filter where the controller needs PV sooner.",
    settled_by="the transmitter's own setting, or a record without the filter",
    told_apart={
        "extra-lag": "the transmitter's own setting, or a record without the filter",
    },
)
