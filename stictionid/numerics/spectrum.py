"""Power of a signal by bands of the period, for tables and pictures of a residual."""

from __future__ import annotations

import itertools

import numpy as np

from ..typing import BoolArray, FloatArray

# Bands of equal ratio, and the fewest samples of a spectrum.
BANDS, FEWEST = 8, 64
Band = tuple[float, float, float, float]


def lines_of(signal: FloatArray, good: BoolArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies (k,) in Hz and power (k,) of a signal (n,) without its mean; samples that are not good count as 0.

    Both are empty where the signal is too short or holds nothing.
    """
    if signal.size < FEWEST or not good.any():
        return np.empty(0), np.empty(0)
    x = np.where(good, signal, 0.0)
    power = np.abs(np.fft.rfft(x - x[good].mean() * good)) ** 2
    if not power[1:].sum() > 0.0:
        return np.empty(0), np.empty(0)
    return np.asarray(np.fft.rfftfreq(x.size, step_s)[1:], np.float64), np.asarray(power[1:], np.float64)


def bands_of(f: FloatArray, power: FloatArray) -> tuple[Band, ...]:
    """Bands as period from and to in s, share of the power, and share of the lines; empty without lines."""
    if not f.size:
        return ()
    edges, total = np.geomspace(f[0], f[-1] * (1 + 1e-9), BANDS + 1), float(power.sum())
    inside = [(a, b, (f >= a) & (f < b)) for a, b in itertools.pairwise(edges.tolist())]
    return tuple((1.0 / b, 1.0 / a, float(power[m].sum()) / total, float(m.mean())) for a, b, m in inside)
