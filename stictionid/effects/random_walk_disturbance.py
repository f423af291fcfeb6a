"""Random-walk disturbance: a non-stationary load without a constant level.

It can't lower a free-run error; it lowers the one-step error. Differences of the error are stationary, so model and
data are fitted in differences, with an autoregression for the measurement noise on top. Can't be told from coloured
noise with a root near 1.

Equation: d(k) = d(k-1) + white(k) with standard deviation innovation_sd a sample. Source: extended ARMAX of Karra and
Karim, docs/details.md, section 5.
"""

from __future__ import annotations

import numpy as np

from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Disturbance, Effect, Place, Scales, Values

_SD = Parameter("innovation_sd", "unit of y", 0.0, 1e9, 0.0, "standard deviation of one step of the walk")


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    walk = np.cumsum(values["innovation_sd"] * rng.standard_normal(time_s.size))
    return walk, np.zeros_like(walk), {}


def _visible(scales: Scales) -> Values:
    return {"innovation_sd": scales.noise}


EFFECT = Effect(
    name="random-walk-disturbance", kind="N", place=Place.NOISE, noise="random-walk",
    summary="a load that wanders without a level",
    equation="d(k) = d(k-1) + white(k)", source="Karra and Karim; docs/details.md, section 5", parameters=(_SD,),
    searched=(), confused_with=("coloured-noise",), disturb=_disturb,
    visible=_visible,
    leaves={"level": 3, "stretch": 4, "colour": 2},
    noun="a load that wanders",
    sentence="The load wanders by {innovation_sd} from sample to sample.",
    seen_over="time",
    action="Find the load that wanders, or let the controller act faster.",
    settled_by="a tag of the suspected load, read with --extra",
    told_apart={
        "step-disturbance": "a longer record, or the loop in manual for a while",
    },
)
