"""One model run over one record for all questions: residual, innovations, and the residual's autocovariance.

Residuals are tested with the autocovariance of an autoregression fitted to them, so that coloured noise does not look
like a failing stretch. Source: docs/details.md, sections 7 and 11; variance of a mean of correlated samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.model import Model
from ..model.spec import Evaluated
from ..numerics.autoregression import autoregression, filter_residual, pace_of, whole_past
from ..record.loop import Loop
from ..record.study import Range
from ..typing import BoolArray, FloatArray

# Largest order of the autoregression behind the standard errors. Unit: samples.
_ORDER = 10
# Most lags of its autocovariance, in samples and as a share of the record.
_MOST_LAGS, _LAG_SHARE = 400, 0.1


@dataclass(frozen=True, slots=True)
class Ground:
    """One comparison's arrays (n,): `good` are the samples that count, `covariance` (k,) of the residual at lags 0….

    `taps` are those of the autoregression of the free-run residual; `innovation` what it and the model leave. From one
    sample that counts to the next, a lag of it, are `pace` samples.
    """

    loop: Loop
    model: Model
    found: Range
    evaluated: Evaluated
    good: BoolArray
    residual: FloatArray
    innovation: FloatArray
    taps: FloatArray
    covariance: FloatArray
    pace: float = 1.0

    @property
    def step_s(self) -> float:
        """Sampling time in seconds."""
        return self.loop.step_s

    @property
    def period_s(self) -> float:
        """Typical period of the oscillation in seconds."""
        return self.found.period_median_s or self.model.period_s

    @property
    def cycle_phase(self) -> FloatArray:
        """Share (n,) of its limit cycle at which each sample lies; not a number outside the cycles."""
        phase, t = np.full(self.residual.size, np.nan), self.loop.time_s
        for cycle in self.found.cycles:
            inside = (t >= cycle.start_s) & (t < cycle.start_s + cycle.period_s)
            phase[inside] = (t[inside] - cycle.start_s) / cycle.period_s
        return phase

    @property
    def rmse(self) -> float:
        """Root mean square of the residual over the samples that count."""
        return float(np.sqrt(np.mean(self.residual[self.good] ** 2)))

    @property
    def effective_rows(self) -> float:
        """Number of independent samples that the residual is worth: n over the sum of its correlations."""
        c = self.covariance
        total = (c[0] + 2.0 * c[1:].sum() / self.pace) / c[0] if c[0] > 0 else 1.0
        n = float(self.good.sum())
        return float(np.clip(n / max(total, 1.0), 1.0, n))

    def spread_of_mean(self, weight: FloatArray, squared: bool = False) -> float:
        """Standard deviation of sum(weight * residual), or of the squared residual, by its covariance; weights (n,)."""
        c = 2.0 * self.covariance**2 if squared else self.covariance
        n = weight.size
        size = 1 << (2 * n - 1).bit_length()
        spectrum = np.abs(np.fft.rfft(weight, size)) ** 2
        overlap = np.fft.irfft(spectrum, size)[:c.size]
        return float(np.sqrt(max(c[0] * overlap[0] + 2.0 * float(c[1:] @ overlap[1:]), 1e-300)))


def prepare(loop: Loop, model: Model, found: Range, evaluated: Evaluated) -> Ground:
    """The arrays for all questions about one evaluated model on one record."""
    good = evaluated.counted > 0
    residual = np.where(good, np.nan_to_num(evaluated.residual), 0.0)
    taps = autoregression(residual, good, _ORDER, loop.starts)
    polynomial = np.concatenate([[1.0], model.taps]) if model.taps.size else np.concatenate([[1.0], taps])
    pace = pace_of(good, loop.starts)
    if pace > 1.0:
        innovation, sure = filter_residual(residual, good, polynomial, loop.starts)
    else:
        innovation = np.convolve(np.nan_to_num(evaluated.residual), polynomial)[:residual.size]
        sure = whole_past(good, polynomial.size - 1)
    sure[:polynomial.size] = False
    lags = int(max(1, min(_MOST_LAGS, _LAG_SHARE * residual.size)))
    mean_square = float(np.mean(residual[good] ** 2)) if good.any() else 0.0
    covariance = mean_square * correlation_of(taps, lags)
    if pace > 1.0:
        covariance = np.interp(np.arange(lags + 1) / pace, np.arange(lags + 1), covariance)
    return Ground(loop, model, found, evaluated, good, residual, np.where(sure, innovation, 0.0), taps, covariance,
                  pace)


def impulse_of(taps: FloatArray, length: int) -> FloatArray:
    """Impulse response (length,) of an autoregression with `taps` after the leading 1."""
    response = np.zeros(length)
    response[0] = 1.0
    for k in range(1, length):
        back = response[max(k - taps.size, 0):k][::-1]
        response[k] = -taps[:back.size] @ back
    return response


def correlation_of(taps: FloatArray, lags: int) -> FloatArray:
    """Autocorrelation (lags + 1,) of an autoregression with `taps` after the leading 1, by its impulse response."""
    if taps.size == 0:
        return np.concatenate([[1.0], np.zeros(lags)])
    length = 8 * lags + 64
    size = 1 << (2 * length - 1).bit_length()
    full = np.fft.irfft(np.abs(np.fft.rfft(impulse_of(taps, length), size)) ** 2, size)[:lags + 1]
    return full / full[0]
