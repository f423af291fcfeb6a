"""Load noise: random disturbances enter before the process, which smooths them, as a feed or a supply pressure does.

The noise of y is then coloured by the process, whose roots it shows beside its own. A load with a root of 1 is a random
walk. Noise at the output with the same roots would look alike, at the price of more numbers. So this noise is named
where it needs fewer numbers by a margin (benchmarks/load_noise.py). Within the margin nobody can tell the two.

Equation: y gets G(s) d, d(k) = root d(k-1) + white(k), in % of travel.
Source: stochastic load disturbance, e.g. Box, Jenkins, Reinsel, Time Series Analysis, section 13.
"""

from __future__ import annotations

import numpy as np

from ..numerics.parameters import Parameter
from ..numerics.varpro import colour_noise
from ..typing import FloatArray
from .contract import Disturbance, Effect, Place, Scales, Values

_ROOT = Parameter("root", "-", -0.999, 1.0, 0.0, "root of the first-order autoregression, 1 for a random walk")
_SD = Parameter("innovation_sd", "%", 0.0, 1e9, 0.0, "standard deviation of what drives it")


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    white = values["innovation_sd"] * rng.standard_normal(time_s.size)
    load = colour_noise(white, np.array([-values["root"]]))
    return np.zeros_like(load), load, {}


def _visible(scales: Scales) -> Values:
    return {"root": 0.8, "innovation_sd": 0.1 * scales.J}


EFFECT = Effect(
    name="load-noise", kind="N", place=Place.NOISE, noise="load",
    summary="random disturbances enter before the process",
    equation="y gets G(s) d, d(k) = root d(k-1) + white(k)",
    source="stochastic load disturbance, Box, Jenkins, Reinsel, section 13", parameters=(_ROOT, _SD), searched=(),
    confused_with=("coloured-noise", "random-walk-disturbance"), disturb=_disturb,
    visible=_visible,
    noun="random disturbances of the load",
    sentence="Random disturbances enter before the process, {innovation_sd} new in each sample.",
    seen_over="spectrum",
    action="Look at what feeds the process; this noise asks for nothing on the valve.",
    settled_by="a tag of the suspected load, read with --extra",
    told_apart={
        "coloured-noise": "a tag of the suspected load, read with --extra",
        "random-walk-disturbance": "a tag of the suspected load, read with --extra",
    },
)
