"""Tests for whiteness: does a noise model explain all of a residual, so that no effect or other base is needed.

An autoregression imitates a slow disturbance by a root near 1. It leaves traces of valve and process in the
innovations. They follow past positions or past values of a further tag, are larger after moves or in some stretches, or
have heavy tails. If the noise has a short memory and its innovations pass joint tests for all that, no search for
effects is needed. Wrong where an effect moves y by less than the tests see: some 2 per cent of the innovations'
variance in 1500 samples, less than names an effect.

Source: docs/details.md, sections 10.1 and 10.2; Ljung and Box 1978; Fisher 1929 (a line); Engle 1982 (squares).
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from ...effects import parse
from ...model.model import Model
from ...numerics.autoregression import autocovariance, chi_square_z, filter_residual, link_samples, ljung_box
from ...record.loop import bridged
from ...typing import BoolArray, FloatArray

# Level of each of six tests, 1 % for all together (a further tag adds one), and its one-sided normal quantile.
_LEVEL = 0.01 / 6.0
_LIMIT = NormalDist().inv_cdf(1.0 - _LEVEL)
# Noise with a root beyond this has so long a memory that it may be a disturbance: a step, a ramp or a sine needs one
# near 1.
_SHORT = 0.9
# Least and largest number of autocorrelation lags (one period between them), then numbers of lagged positions, lagged
# moves, and stretches of the record whose variance may differ.
_FEWEST, _MOST, _POSITIONS, _MOVES, _STRETCHES = 20, 200, 12, 8, 10
# Samples that the tests need: ten for each column.
NEEDED = 10 * (_POSITIONS + 2 * _MOVES + _STRETCHES)
# Directions of columns below this share of the largest count as dependent.
_DEPENDENT = 1e-8


def noise_alone(model: Model, taps: FloatArray, position: FloatArray, innovation: FloatArray,
                good: BoolArray) -> bool:
    """True where the `innovation` (n,) left by an autoregression (p,) of the errors is noise, and of short memory.

    `position` (n,) is the valve's; `good` (n,) says where innovations count. Without taps the errors are tested.
    """
    return not has_long_memory(taps) and passes_tests(model, np.concatenate([[1.0], taps]), taps.size, position,
                                                      innovation, good)


def has_long_memory(taps: FloatArray) -> bool:
    """True for an autoregression (p,) of so long a memory that it may be a disturbance."""
    return bool(np.abs(np.roots(np.concatenate([[1.0], taps]))).max(initial=0.0) > _SHORT)


def of_arithmetic(model: Model, errors: FloatArray) -> bool:
    """True where errors (n,) are no larger than arithmetic makes them, as in a simulated record without noise."""
    return float(np.abs(errors).max()) <= model.loop.arithmetic_error


def passes_tests(model: Model, polynomial: FloatArray, order: int, position: FloatArray, innovation: FloatArray,
                 good: BoolArray) -> bool:
    """True where an `innovation` (n,) passes all tests, however long the memory of the noise model that left it.

    `polynomial` in the lag turned errors into innovations, differences included; `order` of its coefficients were
    fitted. Errors of arithmetic ask for no test.
    """
    e, rows = np.where(good, innovation, 0.0), int(good.sum())
    if of_arithmetic(model, e):
        return True
    if rows < NEEDED or not e.any():
        return False
    move = np.diff(position, prepend=position[0])
    move[list(model.loop.starts)] = 0.0
    before = [_delay_signal(move, k) for k in range(1, _MOVES + 1)]
    curved = [*_curved_terms(model, position), *before, *(np.abs(m) for m in before)]
    stretch = np.minimum(np.arange(e.size) * _STRETCHES // e.size, _STRETCHES - 1)
    loud = [*(np.abs(m) for m in before), *((stretch == s).astype(np.float64) for s in range(1, _STRETCHES))]
    found = (_autocorrelation_test(model, order, e, good),
             _explained_share(e, good, _positions(model, polynomial, position)),
             _explained_share(e, good, curved), _explained_share(e**2, good, loud), _excess_kurtosis(e[good]),
             *_tags(model, polynomial, e, good))
    return max(found) < _LIMIT and not _line(e)


def _autocorrelation_test(model: Model, order: int, e: FloatArray, good: BoolArray) -> float:
    """Joint test of the autocorrelations over one period, as a normal value."""
    rows = int(good.sum())
    lags = int(np.clip(model.period_s / (model.step_s * model.pace), _FEWEST, min(_MOST, rows // 10)))
    c = autocovariance(e, good, lags, model.loop.starts)
    return ljung_box(c[1:] / c[0], rows, order)[1]


def _tags(model: Model, polynomial: FloatArray, e: FloatArray, good: BoolArray) -> list[float]:
    """The test of past positions for every further tag that moves and is not in the model."""
    loop = model.loop
    known = {option for name in model.names for effect, option in (parse(name),) if "extra" in effect.needs}
    tags = (loop.extras[tag] for tag in loop.moving_extras if tag not in known)
    filled = (np.where(np.isfinite(x), x, np.nanmean(x)) for x in tags)
    found = [_explained_share(e, good, _positions(model, polynomial, x)) for x in filled]
    if len(found) < 2:
        return found
    # One test for all tags, by the chance that the best of so many comes as far.
    chance = -float(np.expm1(len(found) * np.log1p(-NormalDist().cdf(-max(found)))))
    return [-NormalDist().inv_cdf(min(max(chance, 1e-300), 1.0 - 1e-16))]


def _positions(model: Model, polynomial: FloatArray, position: FloatArray) -> list[FloatArray]:
    """Past positions over one period, passed through the filter that made the errors innovations."""
    links = link_samples(model.good(), model.loop.starts)
    white = (np.convolve(position - position.mean(), polynomial)[:position.size] if links is None else
             position - position.mean())
    longest = max(int(np.clip(model.period_s / model.step_s, 2, 60)), 2)
    lags = np.unique(np.round(np.linspace(1, longest, _POSITIONS)).astype(int))
    found = [_delay_signal(white, k) for k in lags.tolist()]
    # Beside missing PV a filter goes from one sample that counts to the next, and so must what it is compared with.
    if links is None:
        return found
    return [filter_residual(x, model.good(), polynomial, model.loop.starts)[0] for x in found]


def _curved_terms(model: Model, position: FloatArray) -> list[FloatArray]:
    """Squares and products of the position and y before, and the course of time."""
    y = bridged(model.loop.process_value - np.nanmean(model.loop.process_value))
    before, level, t = _delay_signal(position - position.mean(), 1), _delay_signal(y, 1), np.linspace(-1.0, 1.0, y.size)
    return [before**2, before * level, level**2, t, t**2, t**3, before * t]


def _line(e: FloatArray) -> bool:
    """True where one line of the spectrum stands out, by the largest of so many exponential values."""
    power = np.abs(np.fft.rfft(e)[1:]) ** 2
    chance = -float(np.expm1(power.size * np.log1p(-np.exp(-power.max() / power.mean()))))
    return chance < _LEVEL


def _excess_kurtosis(e: FloatArray) -> float:
    """Kurtosis beyond a normal distribution's, as a normal value."""
    return (float(np.mean(e**4)) / float(np.mean(e**2)) ** 2 - 3.0) / float(np.sqrt(24.0 / e.size))


def _explained_share(signal: FloatArray, good: BoolArray, columns: list[FloatArray]) -> float:
    """The share of a signal (n,) that columns (n,) explain, as a normal value: rows times the share is χ² under chance.
    """
    x, y = np.stack(columns, axis=1)[good], signal[good]
    x, y = x - x.mean(axis=0), y - y.mean()
    scale = np.linalg.norm(x, axis=0)
    u, s, _ = np.linalg.svd(x[:, scale > 0.0] / scale[scale > 0.0], full_matrices=False)
    u = u[:, s > _DEPENDENT * s.max(initial=0.0)]
    if not u.shape[1]:
        return 0.0
    share = float(np.sum((u.T @ y) ** 2)) / max(float(y @ y), 1e-300)
    return chi_square_z(y.size * share, float(u.shape[1]))


def _delay_signal(x: FloatArray, lag: int) -> FloatArray:
    """A signal (n,) delayed by `lag` samples."""
    return np.concatenate([np.full(lag, x[0]), x[:-lag]])
