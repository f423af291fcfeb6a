"""Likelihood of a residual under a noise model, and its information criterion.

Source: docs/details.md, section 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...typing import BoolArray, FloatArray
from ..autoregression import Starts
from .exact import Record
from .family import Noise


@dataclass(frozen=True, slots=True)
class Likelihood:
    """Sum of squared scaled innovations, number of rows and sum of log f of a residual under a noise model.

    The rows are those that count as independent, where a residual is not white.
    """

    sse: float
    rows: float
    log_scale: float = 0.0

    @property
    def deviance(self) -> float:
        """-2 log L without constants, the variance of the innovations at its best value."""
        return self.rows * float(np.log(max(self.sse, 1e-300) / max(self.rows, 1))) + self.log_scale

    def bic(self, parameters: int) -> float:
        """Bayesian information criterion with so many estimated numbers."""
        return self.deviance + parameters * float(np.log(max(self.rows, 1)))


def likelihood(residual: FloatArray, noise: Noise, good: BoolArray, starts: Starts = (0,)) -> Likelihood:
    """Exact likelihood of a residual (n,) of which the `good` samples are there.

    Every segment has an unknown level, integrated out whatever the noise is. Walks and levels then have the same rows
    and one scale, and rho = 1 is the limit of rho < 1. It is 0 for noise that is not stable.
    """
    record = Record(residual, good, starts)
    innovation, deviance = record.innovations(noise)
    return Likelihood(float(innovation @ innovation) if np.isfinite(deviance) else np.inf, record.rows)
