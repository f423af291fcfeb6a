"""Noise that enters ahead of a known process, beside white noise at the output: root, ratio, and an autoregression.

    v = G(q) d + w,    d(k) = root d(k-1) + white(k),    w white

G is known, so v has one or two numbers, and the rest of its spectrum is that of the process. Any noise of the family
imitates v at the price of more numbers. So BIC prefers v only where the process shows in the noise. Wrong where samples
are missing, and where G is far off.
Source: Box, Jenkins and Reinsel, section 13 (noise ahead of the process); Levinson 1947.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...typing import FloatArray
from .survey import levinson_lanes

# Largest order of the autoregression, and the innovation variance beyond its least that a shorter one may have.
LARGEST_ORDER, _NEAR = 48, 1e-3
# Roots of the load, and variances of w over the innovations of G(q) d: a coarse grid, and points between two of it.
ROOTS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99)
WALK = (1.0,)
_RATIOS, _BETWEEN = (0.0, *np.geomspace(1e-2, 1e4, 13).tolist()), 5


@dataclass(frozen=True, slots=True)
class LoadNoise:
    """Noise ahead of a process: `root` of the load, `ratio` of the white noise, and `taps` that whiten both together.

    `numbers` are estimated; `scale` is the standard deviation of y's innovations while that of the load's is 1.
    """

    root: float
    ratio: float
    taps: FloatArray
    numbers: int
    scale: float


def fit_load(covariance: FloatArray, rows: float, power: FloatArray, own: FloatArray,
             roots: tuple[float, ...] = ROOTS) -> LoadNoise | None:
    """The load noise of a signal with autocovariances (lags + 1,) of so many rows, by BIC; None where there is none.

    `power` (m/2 + 1,) is the squared response of the signal to white noise ahead of the process, on the frequencies of
    an FFT; `own` is the polynomial through which white noise at the output came. A root of 1 is in `power` already.
    """
    orders = min(LARGEST_ORDER, covariance.size - 1)
    if orders < 1 or not covariance[0] > 0.0:
        return None
    white = np.correlate(own, own, "full")[own.size - 1:][:orders + 1]
    white = np.pad(white, (0, orders + 1 - white.size))
    toeplitz = covariance[np.abs(np.subtract.outer(np.arange(orders + 1), np.arange(orders + 1)))]
    found, grid, ratios = None, np.array(roots), np.array(_RATIOS)
    for _ in range(2):
        found = _best_of(grid, ratios, toeplitz, rows, power, white)
        if found is None:
            return None
        grid, ratios = _beside(grid, found.root, np.linspace), _beside(ratios, found.ratio, _steps)
    return found


def _steps(low: float, high: float, count: int) -> FloatArray:
    """Ratios between two of the grid; 0 has no logarithm and stays apart."""
    return np.linspace(low, high, count) if low == 0.0 else np.geomspace(low, high, count)


def _beside(grid: FloatArray, best: float, between: Callable[[float, float, int], FloatArray]) -> FloatArray:
    """The best point of a grid, and points between it and its neighbours."""
    at = int(np.argmin(np.abs(grid - best)))
    low, high = grid[max(at - 1, 0)], grid[min(at + 1, grid.size - 1)]
    return np.unique(np.concatenate([between(low, best, _BETWEEN), between(best, high, _BETWEEN)]))


def _best_of(roots: FloatArray, ratios: FloatArray, toeplitz: FloatArray, rows: float, power: FloatArray,
             white: FloatArray) -> LoadNoise | None:
    """The best of a grid of roots and ratios."""
    w = np.exp(-1j * np.linspace(0.0, np.pi, power.size))
    sums, numbers, size = [], [], []
    for root in roots.tolist():
        spectrum = power / np.abs(1.0 - root * w) ** 2 if root < 1.0 else power
        unit = float(np.exp(np.mean(np.log(np.maximum(spectrum, 1e-300)))))
        of_load = np.fft.irfft(spectrum)[:white.size]
        sums += [of_load / unit + ratio * white for ratio in ratios.tolist()]
        numbers += [int(0.0 < root < 1.0) + int(ratio > 0.0) for ratio in ratios.tolist()]
        size += [unit] * ratios.size
    lanes, orders = len(sums), white.size - 1
    taps, variance = np.zeros((orders + 1, orders, lanes)), np.full((orders + 1, lanes), np.inf)
    levinson_lanes(np.array(sums).T.copy(), taps, variance)
    whole = np.concatenate([np.ones((1, lanes)), taps[orders]])
    left = np.einsum("il,ij,jl->l", whole, toeplitz, whole)
    score = np.where(np.isfinite(variance[orders]), rows * np.log(np.maximum(left, 1e-300)), np.inf) \
        + np.log(rows) * np.array(numbers)
    lane = int(np.argmin(score))
    if not np.isfinite(score[lane]):
        return None
    order = int(np.flatnonzero(variance[:, lane] <= (1.0 + _NEAR) * variance[orders, lane])[0])
    root, ratio = float(roots[lane // ratios.size]), float(ratios[lane % ratios.size])
    return LoadNoise(root, ratio, taps[order, :order, lane].copy(), numbers[lane],
                     float(np.sqrt(size[lane] * variance[order, lane])))
