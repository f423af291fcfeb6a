"""Likelihood of innovations under a Student distribution: real disturbances jump more often than a normal one does.

A normal likelihood ratio of two models is then that of the few samples where one of them meets a jump by chance.
Source: Lange, Little and Taylor 1989.
"""

from __future__ import annotations

from math import lgamma

import numpy as np

from ...typing import FloatArray

FREEDOMS = (2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 20.0, 100.0)
"""Degrees of freedom looked at; beyond the last one a Student distribution is a normal one."""
# Rounds of the scale's fixed point; each halves its distance at least.
_ROUNDS = 40


def log_likelihood(innovation: FloatArray, freedom: float) -> float:
    """Greatest log-likelihood of innovations (n,) over the scale; infinite `freedom` is the normal distribution."""
    return float(log_densities(innovation, freedom).sum())


def log_densities(innovation: FloatArray, freedom: float) -> FloatArray:
    """Log-density (n,) of each innovation at the scale of the greatest likelihood."""
    squares = innovation**2
    variance = max(float(squares.mean()), 1e-300)
    if not np.isfinite(freedom):
        return -0.5 * (float(np.log(2.0 * np.pi * variance)) + squares / variance)
    for _ in range(_ROUNDS):
        variance = max(float(np.mean((freedom + 1.0) * squares / (freedom + squares / variance))), 1e-300)
    peak = lgamma(0.5 * freedom + 0.5) - lgamma(0.5 * freedom) - 0.5 * float(np.log(np.pi * freedom))
    return peak - 0.5 * float(np.log(variance)) - 0.5 * (freedom + 1.0) * np.log1p(squares / (freedom * variance))


def likelihood_ratios(fuller: FloatArray, plainer: FloatArray) -> FloatArray:
    """Twice the log-likelihood (n,) by which a fuller model predicts each sample better than a plainer one.

    The degrees of freedom are those of the fuller model's innovations: jumps that only it explains are no tails.
    """
    freedom = max((np.inf, *FREEDOMS), key=lambda f: log_likelihood(fuller, f))
    return 2.0 * (log_densities(fuller, freedom) - log_densities(plainer, freedom))
