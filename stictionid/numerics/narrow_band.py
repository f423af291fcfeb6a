"""Narrow-band noise model: white noise plus a band of wandering phase, fitted to the spectrum of a residual.

    f(w) = level (1 + strength g(w) / mean g),    g the spectrum of an AR(2) with poles r exp(±i w0)

Whittle's likelihood gives the parameters. The model is returned as a long autoregression, so that it prewhitens like
any other noise model. It has three numbers and a level, where a free autoregression would need many. Source:
docs/details.md, section 5; Whittle 1953.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import BoolArray, FloatArray
from .autoregression import levinson
from .population import refine

# Order of the autoregression that approximates the spectrum. A band of coherence 4 under white noise needs some 50: of
# order 24 its innovations are 1.2 % larger, of order 96 as large (2,893 samples). Unit: samples.
_ORDER = 48
# Limits of the coherence in cycles and of the band's power relative to the white noise; searched as logarithms.
_COHERENCE, _STRENGTH = (0.3, 60.0), (0.02, 100.0)
_PEAKS = 6
NUMBERS = 4


@dataclass(frozen=True, slots=True)
class Resonance:
    """A fitted band: period and coherence, share of the residual's variance in the band (0..1), and taps (k,)."""

    period: float
    coherence: float
    share: float
    taps: FloatArray


def shape(w: FloatArray, w0: FloatArray, coherence: FloatArray, strength: FloatArray) -> FloatArray:
    """Spectrum (k, P) with white level 1 at angular frequencies (k,) per sample, for P bands."""
    r = np.exp(-w0 / (2.0 * np.pi * coherence))
    a1, a2 = 2.0 * r * np.cos(w0), -r * r
    z = np.exp(-1j * w)[:, None]
    g = 1.0 / np.abs(1.0 - a1 * z - a2 * z * z) ** 2
    # Mean over all frequencies: the variance of an AR(2) with unit innovations.
    mean = (1.0 - a2) / ((1.0 + a2) * ((1.0 - a2) ** 2 - a1**2))
    return np.asarray(1.0 + strength * g / mean)


def resonance(residual: FloatArray, good: BoolArray, rng: np.random.Generator) -> Resonance | None:
    """The band that fits a residual (n,) best, None where the record is too short; periods in samples."""
    n = residual.size
    if good.sum() < 100:
        return None
    x = np.where(good, residual - residual[good].mean(), 0.0)
    power = np.abs(np.fft.rfft(x)[1:]) ** 2 / n
    w = 2.0 * np.pi * np.arange(1, power.size + 1) / n
    low, high = 2.0 * np.pi * 4.0 / n, 0.8 * np.pi

    def bands(cube: FloatArray) -> list[FloatArray]:
        """Angular frequencies, coherences and strengths (P,) of points (P, 3) of the unit cube."""
        return [np.exp(np.log(a) + part * np.log(b / a))
                for part, (a, b) in zip(cube.T, ((low, high), _COHERENCE, _STRENGTH), strict=True)]

    def costs(cube: FloatArray) -> FloatArray:
        f = shape(w, *bands(cube))
        return np.asarray(w.size * np.log(np.mean(power[:, None] / f, axis=0)) + np.log(f).sum(axis=0) + 1e6)

    smooth = np.convolve(power, np.ones(5) / 5, "same")
    smooth[(w < low) | (w > high)] = 0.0
    starts = []
    for _ in range(_PEAKS):
        k = int(smooth.argmax())
        at = np.clip(np.log(max(w[k], low) / low) / np.log(high / low), 0.0, 1.0)
        starts += [[at, c, s] for c in (0.3, 0.6, 0.9) for s in (0.3, 0.6, 0.85)]
        smooth[max(k - 8, 0):k + 9] = 0.0
    grid = np.array(starts)
    best = grid[np.argsort(costs(grid), kind="stable")[:3]]
    found = bands(refine(costs, best, rng, spread=0.03, rounds=40, population=12).points[:1])
    size = 1 << max(12, (8 * n - 1).bit_length())
    f = shape(2.0 * np.pi * np.arange(size // 2 + 1) / size, *found)[:, 0]
    *_, (taps, _) = levinson(np.fft.irfft(f, size)[:_ORDER + 1])
    w0, q, s = (float(v[0]) for v in found)
    return Resonance(2.0 * np.pi / w0, q, s / (1.0 + s), taps)
