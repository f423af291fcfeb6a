"""Logarithms of chances under the normal distribution, far into its tails, without scipy.

Source: asymptotic series of the error function, Abramowitz and Stegun 1964, 7.1.23.
"""

from __future__ import annotations

import math

import numpy as np

from ...typing import FloatArray
from ..jit import kernel

# From here on the upper tail is taken from its asymptotic series; erfc still has digits.
_FAR = 25.0
# Width below which the ends of an interval nearly meet.
_NARROW = 1e-6
# Ends farther out than this many widths count as none; their squares are still finite.
_END = 1e100
# Least logarithm that is told apart from none at all.
_NONE = -1e5
ROOT_TWO_PI = math.sqrt(2.0 * math.pi)
"""Square root of 2 pi, by which the density of the normal distribution is divided."""
POINT_99 = 2.576
"""Standard errors that a normal number exceeds, either way, with a chance of 1 %."""


@kernel
def _log_between(low: FloatArray, high: FloatArray, out: FloatArray) -> None:
    for i in range(low.size):
        a, b = low[i], high[i]
        if b < -a:
            # the mirror image, so that the upper tail is the smaller one
            a, b = -b, -a
        if a < _FAR:
            chance = 0.5 * (math.erfc(a / math.sqrt(2.0)) - math.erfc(b / math.sqrt(2.0)))
            out[i] = math.log(chance) if chance > 0.0 else _NONE
        else:
            tail = -0.5 * a * a - math.log(a * math.sqrt(2.0 * math.pi)) - 1.0 / (a * a)
            less = math.exp(-min(0.5 * (b - a) * (b + a), 700.0))
            out[i] = tail + math.log1p(-less) if less < 1.0 else _NONE
        out[i] = max(out[i], _NONE)


def log_upper(x: FloatArray) -> FloatArray:
    """Logarithm of the chance that a standard normal number exceeds x, of any shape; nan where x is nan."""
    return np.where(np.isnan(x), x, log_between(x, np.full(np.shape(x), np.inf)))


def log_between(low: FloatArray, high: FloatArray) -> FloatArray:
    """Logarithm of the chance that a standard normal number lies between low and high, of one shape."""
    low, high = np.ascontiguousarray(low, dtype=np.float64), np.ascontiguousarray(high, dtype=np.float64)
    out = np.empty_like(low)
    _log_between(low.ravel(), high.ravel(), out.ravel())
    return out


def moments_between(low: FloatArray, high: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """Mean and mean square of N(0, width^2) between low and high, which is above; nan where an end is nan."""
    a, b = np.clip((low / width, np.maximum(high, low + 1e-9 * width) / width), -_END, _END)
    # Far into a tail, and between ends that nearly meet, the density falls exponentially from the end next to 0.
    near = np.where(a > 0.0, a, np.minimum(b, 0.0))
    steep = (np.abs(near) > _FAR) | (b - a < _NARROW)
    with np.errstate(divide="ignore"):
        inward = np.minimum(1.0 / np.abs(near), 0.5 * (b - a))
    tail = near + np.where(a > 0.0, inward, -inward)
    low_a, high_b = np.where(steep, -1.0, a), np.where(steep, 1.0, b)
    share = log_between(low_a, high_b)
    with np.errstate(under="ignore", over="ignore"):  # (no chance is known beside an end that is nan)
        at_a, at_b = (np.exp(-0.5 * end**2 - share) / ROOT_TWO_PI for end in (low_a, high_b))
    mean = np.where(steep, tail, np.clip(at_a - at_b, a, b))
    second = 1.0 + low_a * at_a - high_b * at_b
    return width * mean, width**2 * np.maximum(np.where(steep, 0.0, second), mean**2)
