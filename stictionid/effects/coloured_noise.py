"""Coloured noise: the output error follows an autoregression instead of being white.

It can't lower a free-run error; it lowers the one-step error. Can't be told from a random walk when a root of its
polynomial lies near 1. Source: C(q) of Shang et al., Eq. 4, here as AR(p); docs/details.md, section 5.
"""

from __future__ import annotations

import numpy as np

from ..numerics.parameters import Parameter
from ..numerics.varpro import colour_noise
from ..typing import FloatArray
from .contract import Disturbance, Effect, Place, Scales, Values

_ROOT = Parameter("root", "-", -0.999, 0.999, 0.0, "root of the first-order autoregression")
_SD = Parameter("innovation_sd", "unit of y", 0.0, 1e9, 0.0, "standard deviation of what drives it")


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    white = values["innovation_sd"] * rng.standard_normal(time_s.size)
    out = colour_noise(white, np.array([-values["root"]]))
    return out, np.zeros_like(out), {}


def _visible(scales: Scales) -> Values:
    return {"root": 0.8, "innovation_sd": scales.noise}


EFFECT = Effect(
    name="coloured-noise", kind="N", place=Place.NOISE, noise="autoregressive",
    summary="the output error is autocorrelated",
    equation="(1 + c1 q^-1 + … + cp q^-p) error(k) = white(k)",
    source="Shang et al., Eq. 4; docs/details.md, section 5", parameters=(_ROOT, _SD), searched=(),
    confused_with=("random-walk-disturbance",), disturb=_disturb,
    visible=_visible,
    leaves={"colour": 1},
    noun="coloured noise",
    sentence="Errors of successive samples hang together, with a root of {root}; {innovation_sd} is new in each "
             "sample.",
    seen_over="spectrum",
    action="Look for turbulence, mixing or a filter; this noise asks for nothing on the valve.",
    settled_by="a record with the loop in manual",
    told_apart={
        "random-walk-disturbance": "a longer record with the loop in manual: noise has a level, a walk has none",
    },
)
