"""Power of a signal by bands of the period, for tables and pictures; first looks at what a residual follows."""

from __future__ import annotations

import itertools

import numpy as np

from ..typing import BoolArray, FloatArray
from .autoregression import autoregression, filter_residual

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


def whiten_signals(residual: FloatArray, others: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A residual (n,) and other signals (n, k) through the autoregression that whitens it; NaN counts as the mean.

    Divided by a smooth spectrum of the residual instead, two walks would follow each other.
    """
    signals = np.column_stack([residual, others])
    known = np.isfinite(signals)
    mean = np.where(known, signals, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    signals = np.where(known, signals - mean, 0.0)
    good = known[:, 0]
    taps = autoregression(signals[:, 0], good)
    polynomial = np.concatenate([[1.0], taps])
    out = np.stack([filter_residual(x, np.ones_like(good), polynomial)[0] for x in signals.T], axis=1)
    out[:taps.size] = 0.0
    out[~good, 0] = 0.0
    return out[:, 0], out[:, 1:]


def lagged_gains(white: FloatArray, signal: FloatArray, lags: FloatArray, most: int) -> FloatArray:
    """Gain in 2 log L of a white residual (n,) by a signal (n,), (k, most + 1): lags (k,) by delays of 0..most.

    Lags and delays are in samples. The Fourier transform gives all delays at once.
    """
    n = white.size
    power = float(white @ white)
    if not power > 0.0:
        return np.zeros((lags.size, most + 1))
    z = np.exp(-2j * np.pi * np.fft.rfftfreq(2 * n))
    keep = np.exp(-1.0 / np.maximum(lags, 1e-3))[:, None]
    x = np.fft.rfft(signal, 2 * n) * (1.0 - keep) / (1.0 - keep * z)
    energy = np.sum(np.fft.irfft(x, 2 * n, axis=1)[:, :n] ** 2, axis=1)[:, None]
    cross = np.fft.irfft(np.conj(x) * np.fft.rfft(white, 2 * n), 2 * n, axis=1)[:, :most + 1]
    share = cross**2 / np.maximum(energy * power, np.finfo(float).tiny)
    return np.asarray(-n * np.log1p(-np.minimum(share, 1.0 - 1e-9)), np.float64)
