"""Ellipse fitted to the plot of process value against controller output."""

from __future__ import annotations

import numpy as np

from ..numerics.ellipse import Ellipse, fit_ellipse
from ..typing import FloatArray
from .loop import Loop

# Pass band of the filter, in multiples of the oscillation's frequency: the third harmonic carries the corners.
_LOW, _HIGH = 0.5, 3.5
# Share of the record, from its end, that is plotted: the start-up is left out.
_PLOTTED = 0.9


def pv_op_ellipse(loop: Loop, period_s: float) -> Ellipse | None:
    """Ellipse through the plot of y against u (x is u), both reduced to the oscillation and its first harmonics.

    `period_s` is the oscillation's period. None where the points lie on a line or the record holds no whole cycle.
    """
    period = period_s / loop.step_s
    good = loop.used & np.isfinite(loop.process_value)
    # Whole cycles, so that the filter sees no jump where the record wraps round.
    rows = int(int(loop.samples * _PLOTTED / period) * period)
    if rows < 6:
        return None
    k = np.arange(loop.samples)
    u, y = (_around(np.interp(k, k[good], signal[good])[-rows:], 1.0 / period)
            for signal in (loop.output, loop.process_value))
    return fit_ellipse(u[good[-rows:]], y[good[-rows:]])


def _around(signal: FloatArray, frequency: float) -> FloatArray:
    """Signal (n,) with only the frequencies near `frequency` (per sample) and its first harmonics, without its mean."""
    spectrum = np.fft.rfft(signal - signal.mean())
    per_sample = np.fft.rfftfreq(signal.size)
    spectrum[(per_sample < _LOW * frequency) | (per_sample > _HIGH * frequency)] = 0.0
    return np.fft.irfft(spectrum, signal.size)
