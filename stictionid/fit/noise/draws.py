"""Draws of a fitted noise model.

Source: parametric bootstrap, Efron and Tibshirani 1993, chapter 6.
"""

from __future__ import annotations

import numpy as np

from ...numerics.varpro import colour_noise
from ...typing import FloatArray
from .completion import Refit


def draw_residual(done: Refit, rng: np.random.Generator) -> FloatArray:
    """A residual (n,) drawn from the innovations of a model through its noise model, linked across short gaps."""
    model = done.model
    pool = done.innovation[done.good]
    rows = np.flatnonzero(model.good()) if model.pace > 1.0 else np.arange(done.innovation.size)
    white = rng.choice(pool - pool.mean(), rows.size)
    out = np.zeros(done.innovation.size)
    out[rows] = colour_noise(white, done.white_model().taps)
    return out
