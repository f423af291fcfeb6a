"""Narrow-band disturbance: an oscillation from elsewhere in the plant, with a wandering phase.

It can't lower a free-run error; it lowers the one-step error (resonant AR(2)). On a real flow loop three quarters of
the residual's power lay in one band, and no constant sinusoid removed it.

Equation: d(k) = 2 r cos(w) d(k-1) - r^2 d(k-2) + white(k), w = 2 pi step/period_s, r = exp(-step/(coherence_cycles
period_s)). Source: docs/details.md, section 5.
"""

from __future__ import annotations

import numpy as np

from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Disturbance, Effect, Place, Scales, Values

_PERIOD = Parameter("period_s", "s", 1e-3, 1e7, 60.0, "period of the band's middle", log=True)
_COHERENCE = Parameter("coherence_cycles", "-", 0.1, 1e4, 5.0, "cycles after which the phase is forgotten", log=True)
_AMPLITUDE = Parameter("amplitude", "unit of y", 0.0, 1e9, 0.0, "root mean square times the square root of two")


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    step = float(time_s[1] - time_s[0])
    w = 2.0 * np.pi * step / values["period_s"]
    r = float(np.exp(-step / (values["coherence_cycles"] * values["period_s"])))
    a1, a2 = 2.0 * r * np.cos(w), -r * r
    white = rng.standard_normal(time_s.size)
    out = np.zeros_like(white)
    for k in range(2, out.size):
        out[k] = a1 * out[k - 1] + a2 * out[k - 2] + white[k]
    # Variance of an AR(2) with unit innovations.
    variance = (1.0 - a2) / ((1.0 + a2) * ((1.0 - a2) ** 2 - a1**2))
    return out * values["amplitude"] / np.sqrt(2.0 * variance), np.zeros_like(out), {}


def _visible(scales: Scales) -> Values:
    return {"period_s": 4.0 * scales.lag_s, "coherence_cycles": 4.0, "amplitude": 0.08 * scales.swing}


EFFECT = Effect(
    name="narrow-band-disturbance", kind="N", place=Place.NOISE, noise="resonant",
    summary="an oscillation from elsewhere whose phase wanders",
    equation="resonant AR(2) with period_s and coherence_cycles", source="docs/details.md, section 5",
    parameters=(_PERIOD, _COHERENCE, _AMPLITUDE), searched=(), confused_with=("sinusoidal-disturbance",),
    disturb=_disturb,
    visible=_visible,
    leaves={"colour": 5, "line": 2},
    noun="an oscillation near {period_s} from outside",
    sentence="An oscillation near {period_s} comes from outside; its phase is forgotten after {coherence_cycles} "
             "cycles.",
    seen_over="spectrum",
    action="Look for the loop or the machine that swings every {period_s}.",
    settled_by="the loop in manual: an oscillation from elsewhere goes on",
    told_apart={
        "sinusoidal-disturbance": "a longer record, or other loops of the same time that show the oscillation",
    },
)
