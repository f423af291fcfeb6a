"""Autoregressive noise models of a residual, the Ljung-Box test, and an estimate of the irreducible error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from ..typing import BoolArray, FloatArray, IntArray

# First samples of the segments of a record; no pair of samples crosses them.
Starts = tuple[int, ...]
# Lags of the free model that estimates the irreducible noise (docs/details.md, section 10.1).
CEILING_LAGS = 20
# Samples for every tap of an autoregression, at least.
_ROWS_A_TAP = 25
# Rows that are brought to triangular form at once.
PIECE = 50_000
# A filter starts anew behind a gap of more than this many usual distances between samples that count. Unit: 1.
_FARTHEST = 5.0


@dataclass(frozen=True, slots=True)
class Links:
    """The samples that a filter passes, each tied to the one measured before it, across short gaps.

    `rows` (m,) are the samples that count and `depth` (m,) how many a filter can look back on from each. `before` (n,)
    is the sample before each, -1 where there is none or the sample does not count. `pace` is the mean distance.
    """

    rows: IntArray
    depth: IntArray
    before: IntArray
    pace: float

    def gap_samples(self) -> BoolArray:
        """Samples (n,) that count and are tied to a later one, and all that are missing before that one."""
        tied = self.rows[self.depth > 0]
        steps = np.zeros(self.before.size)
        steps[self.before[tied]] += 1.0
        steps[tied] -= 1.0
        return np.cumsum(steps) > 0.5

    def samples_in_reach(self, lags: int) -> BoolArray:
        """Samples (n,) from which a filter can look back on so many others."""
        out = np.zeros(self.before.size, np.bool_)
        out[self.rows[self.depth >= lags]] = True
        return out


def link_samples(good: BoolArray, starts: Starts = (0,)) -> Links | None:
    """The links between the samples (n,) that are good; None where no segment has a gap between two of them.

    A gap much longer than usual, such as a stretch in manual, ends a chain.
    """
    rows = np.flatnonzero(good)
    if rows.size < 2 or (len(starts) == 1 and rows.size == rows[-1] - rows[0] + 1):
        return None
    apart = np.diff(rows)
    same = np.diff(np.searchsorted(starts, rows, side="right")) == 0
    if not (same & (apart > 1)).any():
        return None
    near = same & (apart <= _FARTHEST * float(apart[same].mean()))
    at = np.arange(rows.size)
    depth = at - np.maximum.accumulate(np.where(np.concatenate([[True], ~near]), at, 0))
    before = np.full(good.size, -1, np.int64)
    before[rows[1:][near]] = rows[:-1][near]
    return Links(rows, depth, before, float(apart[near].mean()) if near.any() else 1.0)


def pace_of(good: BoolArray, starts: Starts = (0,)) -> float:
    """Mean distance in samples between one good sample (n,) and the next, long gaps left out: 1 without gaps."""
    links = link_samples(good, starts)
    return 1.0 if links is None else links.pace


def autocovariance(signal: FloatArray, good: BoolArray, lags: int, starts: Starts = (0,)) -> FloatArray:
    """Autocovariances at lags 0..lags from the pairs whose samples both count, divided by the number that counts.

    Pairs lie in one segment; `starts` are the segments' first samples. Across a short gap the lag counts the samples
    that are there.
    """
    parts, count = _chains(signal, good, starts), max(int(good.sum()), 1)
    return np.array([sum(float(x[lag:] @ x[:x.size - lag]) for x in parts if x.size > lag) / count
                     for lag in range(lags + 1)])


def _chains(signal: FloatArray, good: BoolArray, starts: Starts) -> list[FloatArray]:
    """The samples of a signal (n,) that count, in chains of which each follows on the one before."""
    links = link_samples(good, starts)
    if links is not None:
        return np.split(signal[links.rows], np.flatnonzero(links.depth == 0)[1:])
    return [x[keep] for x, keep in zip(np.split(signal, starts[1:]), np.split(good, starts[1:]), strict=True)]


def predicted_covariance(signal: FloatArray, good: BoolArray, lags: int, starts: Starts = (0,)) -> FloatArray:
    """Autocovariances at lags 0..lags of the autoregression that predicts a signal (n,) best forwards and backwards.

    Products of samples alone take the ends of a smooth signal for noise: its roots near 1 come out too small, and
    its innovations too large. Source: Burg 1975.
    """
    parts = _chains(signal, good, starts)
    ahead, behind = [x[1:] for x in parts], [x[:-1] for x in parts]
    found = np.zeros(lags + 1)
    found[0] = variance = sum(float(x @ x) for x in parts) / max(int(good.sum()), 1)
    taps = np.empty(0)
    for order in range(1, lags + 1):
        power = sum(float(f @ f) + float(b @ b) for f, b in zip(ahead, behind, strict=True))
        reflection = -2.0 * sum(float(f @ b) for f, b in zip(ahead, behind, strict=True)) / power if power else 0.0
        found[order] = -reflection * variance - taps @ found[order - 1:0:-1]
        taps = np.concatenate([taps + reflection * taps[::-1], [reflection]])
        variance *= 1.0 - reflection**2
        ahead, behind = ([(f + reflection * b)[1:] for f, b in zip(ahead, behind, strict=True)],
                         [(b + reflection * f)[:-1] for f, b in zip(ahead, behind, strict=True)])
    return found


def chi_square_z(value: float, freedom: float) -> float:
    """Normal value of a χ² with `freedom` degrees of freedom, by Wilson and Hilferty."""
    a = 2.0 / (9.0 * freedom)
    return float(((max(value, 0.0) / freedom) ** (1.0 / 3.0) - (1.0 - a)) / np.sqrt(a))


def ljung_box(rho: FloatArray, rows: int, fitted: int) -> tuple[float, float]:
    """Joint test of autocorrelations (k,) at lags 1…k over `rows` rows: Q and its normal value.

    `fitted` is the number of taps that were fitted; it lowers the degrees of freedom.
    Source: Ljung and Box 1978.
    """
    q = rows * (rows + 2.0) * float(np.sum(rho**2 / (rows - np.arange(1, rho.size + 1))))
    return q, chi_square_z(q, max(rho.size - fitted, 1))


def filter_residual(residual: FloatArray, counted: BoolArray, polynomial: FloatArray,
                    starts: Starts = (0,)) -> tuple[FloatArray, BoolArray]:
    """A residual (n,) passed through a polynomial in the lag, and where all the samples behind a value count.

    NaN counts as 0; where it stands no sample may count. Across a short gap the filter goes from one sample that counts
    to the next (see `link_samples`), and is 0 elsewhere.
    """
    links = link_samples(counted, starts)
    if links is not None:
        good = links.samples_in_reach(polynomial.size - 1)
        out, at = np.zeros(residual.size), np.flatnonzero(good)
        source = at
        for weight in polynomial.tolist():
            out[at] += weight * residual[source]
            source = links.before[source]
        return out, good
    return np.convolve(np.nan_to_num(residual), polynomial)[:residual.size], whole_past(counted, polynomial.size - 1)


def whole_past(counted: BoolArray, lags: int) -> BoolArray:
    """Samples (n,) that count, as do so many before each of them."""
    good = counted.copy()
    for lag in range(1, lags + 1):
        good[lag:] &= counted[:-lag]
        good[:lag] = False
    return good


def first_rows(taps: FloatArray) -> FloatArray:
    """Factor (p, p) that whitens the first p samples of an autoregression (p,) to the innovations of the later ones.

    Sample k is predicted by the best predictor of order k and scaled to the innovations of the whole (Prais and
    Winsten for p = 1). For an autoregression that is not stable the factor is zero.
    """
    p = taps.size
    out, predictor, scale = np.zeros((p, p)), np.asarray(taps, dtype=np.float64), 1.0
    for k in range(p - 1, -1, -1):
        reflection = predictor[k]
        if not abs(reflection) < 1.0:
            return np.zeros((p, p))
        scale *= 1.0 - reflection**2
        predictor = (predictor[:k] - reflection * predictor[:k][::-1]) / (1.0 - reflection**2)
        out[k, :k + 1] = np.sqrt(scale) * np.concatenate([predictor[::-1], [1.0]])
    return out


def levinson(covariance: FloatArray) -> Iterator[tuple[FloatArray, float]]:
    """Taps (k,) of the autoregressions of order k = 1, 2, … with these autocovariances, and their innovation variances.

    Source: Levinson 1947; Durbin 1960.
    """
    taps, variance = np.empty(0), covariance[0]
    for order in range(1, covariance.size):
        reflection = -(covariance[order] + taps @ covariance[order - 1:0:-1]) / variance
        taps = np.concatenate([taps + reflection * taps[::-1], [reflection]])
        variance *= 1.0 - reflection**2
        yield taps, variance


def autoregression(residual: FloatArray, good: BoolArray, largest: int = 10, starts: Starts = (0,),
                   missing: FloatArray | float = 0.0, *, long: bool = False) -> FloatArray:
    """Taps of an AR model (coefficients after the leading 1) whose order 0..largest BIC chooses.

    `starts` are the first samples of the segments; `missing` are autocovariances (largest + 1,) to be added. With
    `long` AIC chooses the order where BIC chooses any: no autoregression of finite order is the noise of a plant.
    """
    n = float(good.sum())
    lags = min(largest, int(n / _ROWS_A_TAP))
    r = predicted_covariance(residual, good, lags, starts) + np.resize(missing, lags + 1)
    if r[0] <= 0.0:
        return np.empty(0)
    orders = [(np.empty(0), float(r[0])), *takewhile(lambda o: o[1] > 0.0, levinson(r))]
    for price in (np.log(n), 2.0)[:1 + long]:
        best = min(orders, key=lambda o: n * np.log(o[1]) + price * o[0].size + 1e-9 * o[0].size)[0]
        if not best.size:
            break
    return best


def irreducible_error(process_value: FloatArray, position: FloatArray, good: BoolArray, delay: int,
                      starts: Starts = (0,), nearest: int = 1, past: BoolArray | None = None) -> float | None:
    """Standard deviation of the error that a free linear model of y and valve position leaves, in the unit of y.

    Regresses y on CEILING_LAGS of its own past and of the position (n,) shifted by `delay` samples; corrected for the
    fitted numbers. None where the record is too short. Too low where the noise is coloured: it is an innovation.
    Every segment (`starts`) has a level of its own, and no row reaches back across a gap. Where y is missing regularly
    its past is taken at the shortest distance at which it is there, and not before `nearest` samples: between values
    that a historian joined by straight lines, y predicts itself. `past` (n,) are the samples that may stand in the past
    of those that count (`good`), where these are more.
    """
    first, past = min(nearest, CEILING_LAGS), good if past is None else past
    apart = range(first, first + 1 if link_samples(past, starts) is None else CEILING_LAGS + 1)
    floors = (_free_model_error(process_value, position, good, past, delay, starts, k) for k in apart)
    return next((floor for floor in floors if floor is not None), None)


def _free_model_error(process_value: FloatArray, position: FloatArray, good: BoolArray, known: BoolArray, delay: int,
                      starts: Starts, apart: int) -> float | None:
    """The same with the past of y every so many samples, as far back as CEILING_LAGS samples and four at least."""
    lags = CEILING_LAGS
    past = range(apart, max(lags, 4 * apart) + 1, apart)
    first = max(past[-1], lags) + delay + 1
    ends = (*starts[1:], process_value.size)
    rows = np.concatenate([np.arange(a + first, b) for a, b in zip(starts, ends, strict=True)])
    keep = good[rows].copy()
    for lag in past:
        keep &= known[rows - lag]
    rows = rows[keep]
    if rows.size < 6 * lags:
        return None
    # Centred, so that the constant costs nothing. The record is factored in pieces, which gives the factor of the
    # whole: 40 columns of a long record would take much memory.
    y_mean, v_mean = float(process_value[rows].mean()), float(position[rows - delay].mean())
    y, v = process_value - y_mean, position - v_mean
    further = range(1, len(starts))
    factor = np.empty((0, lags + len(past) + 2 + len(further)))
    for part in np.array_split(rows, -(-rows.size // PIECE)):
        columns = [y[part - lag] for lag in past]
        columns += [v[part - delay - lag] for lag in range(1, lags + 1)]
        segment = np.searchsorted(starts, part, side="right") - 1
        levels = [np.ones(part.size), *((segment == s).astype(np.float64) for s in further)]
        piece = np.stack([*columns, *levels, y[part]], axis=1)
        factor = np.asarray(np.linalg.qr(np.concatenate([factor, piece]), mode="r"))
    solution, *_ = np.linalg.lstsq(factor[:, :-1], factor[:, -1], rcond=1e-10)
    error = factor[:, -1] - factor[:, :-1] @ solution
    return float(np.sqrt(error @ error / max(rows.size - solution.size, 1)))
