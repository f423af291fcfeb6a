"""Noise: autoregressive models of a residual, and the estimate of the error that no model could remove."""

from __future__ import annotations

import numpy as np

from ..typing import BoolArray, FloatArray

# First samples of the segments of a record: nothing is a pair across them.
Starts = tuple[int, ...]
# Lags of the free model that estimates the irreducible noise (CRITICISM.md section 7, step 9).
CEILING_LAGS = 20
# Rows that are brought to triangular form at once.
PIECE = 50_000


def autocovariance(signal: FloatArray, good: BoolArray, lags: int, starts: Starts = (0,)) -> FloatArray:
    """Autocovariances at 0..lags from the pairs of which both samples are good, divided by all good samples.

    Pairs lie in one segment; `starts` are the segments' first samples.
    """
    parts = np.split(np.where(good, signal, 0.0), starts[1:])
    count = max(int(good.sum()), 1)
    return np.array([sum(float(x[lag:] @ x[:x.size - lag]) for x in parts if x.size > lag) / count
                     for lag in range(lags + 1)])


def chi_square_z(value: float, freedom: float) -> float:
    """Wilson and Hilferty's normal value of a χ² with so many degrees of freedom."""
    a = 2.0 / (9.0 * freedom)
    return float(((max(value, 0.0) / freedom) ** (1.0 / 3.0) - (1.0 - a)) / np.sqrt(a))


def ljung_box(rho: FloatArray, rows: int, fitted: int) -> tuple[float, float]:
    """Joint test of autocorrelations (k,) at lags 1…k of so many rows: Q and its normal value; `fitted` taps made them.

    Source: Ljung and Box 1978.
    """
    q = rows * (rows + 2.0) * float(np.sum(rho**2 / (rows - np.arange(1, rho.size + 1))))
    return q, chi_square_z(q, max(rho.size - fitted, 1))


def filtered(residual: FloatArray, counted: BoolArray, polynomial: FloatArray) -> tuple[FloatArray, BoolArray]:
    """A residual (n,) passed through a polynomial in the lag, and where all the samples behind a value count.

    NaN counts as 0; where it stands no sample may count.
    """
    good = counted.copy()
    for lag in range(1, polynomial.size):
        good[lag:] &= counted[:-lag]
        good[:lag] = False
    return np.convolve(np.nan_to_num(residual), polynomial)[:residual.size], good


def first_rows(taps: FloatArray) -> FloatArray:
    """What the first p samples of an autoregression (p,) are multiplied by (p, p) to be white like the later ones.

    Sample k is predicted by the best predictor of order k and scaled to the innovations of the whole (Prais and
    Winsten for p = 1). Of an autoregression that is not stable the first samples say nothing: zeros.
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


def autoregression(residual: FloatArray, good: BoolArray, largest: int = 10, starts: Starts = (0,),
                   missing: FloatArray | float = 0.0) -> FloatArray:
    """Taps of an AR model (coefficients after the leading 1) whose order 0..largest BIC chooses (Levinson-Durbin).

    `starts` are the first samples of the segments; `missing` are autocovariances (largest + 1,) to be added.
    """
    r = autocovariance(residual, good, largest, starts) + missing
    n = float(good.sum())
    if r[0] <= 0.0 or n < 10 * largest:
        return np.empty(0)
    best, best_bic = np.empty(0), n * np.log(r[0])
    a, error = np.empty(0), r[0]
    for order in range(1, largest + 1):
        reflection = -(r[order] + a @ r[order - 1:0:-1][:a.size] if a.size else r[1]) / error
        a = np.concatenate([a + reflection * a[::-1], [reflection]])
        error *= 1.0 - reflection**2
        if error <= 0.0:
            break
        score = n * np.log(error) + order * np.log(n)
        if score < best_bic - 1e-9:
            best, best_bic = a.copy(), score
    return best


def irreducible(process_value: FloatArray, position: FloatArray, good: BoolArray, delay: int,
                starts: Starts = (0,)) -> float | None:
    """Standard deviation of the error that a free linear model of y and valve position leaves, in the unit of y.

    Regresses y on CEILING_LAGS of its own past and of the position (n,) shifted by `delay` samples; corrected for the
    fitted numbers. None where the record is too short. Too low where the noise is coloured: it is an innovation.
    Every segment (`starts`) has a level of its own, and no row reaches back across a gap.
    """
    lags = CEILING_LAGS
    first = lags + delay + 1
    n = process_value.size
    if n - first < 6 * lags:
        return None
    rows = np.concatenate([np.arange(a + first, b) for a, b in zip(starts, (*starts[1:], n), strict=True)])
    keep = good[rows].copy()
    for lag in range(1, lags + 1):
        keep &= good[rows - lag]
    rows = rows[keep]
    if rows.size < 6 * lags:
        return None
    # Centred, so that the constant costs nothing; triangular factors of pieces are those of the whole (its size would
    # count in memory: 40 columns of a long record).
    y_mean, v_mean = float(process_value[rows].mean()), float(position[rows - delay].mean())
    y, v = process_value - y_mean, position - v_mean
    further = range(1, len(starts))
    factor = np.empty((0, 2 * lags + 2 + len(further)))
    for part in np.array_split(rows, -(-rows.size // PIECE)):
        columns = [y[part - lag] for lag in range(1, lags + 1)]
        columns += [v[part - delay - lag] for lag in range(1, lags + 1)]
        segment = np.searchsorted(starts, part, side="right") - 1
        levels = [np.ones(part.size), *((segment == s).astype(np.float64) for s in further)]
        piece = np.stack([*columns, *levels, y[part]], axis=1)
        factor = np.linalg.qr(np.concatenate([factor, piece]), mode="r")
    solution, *_ = np.linalg.lstsq(factor[:, :-1], factor[:, -1], rcond=1e-10)
    error = factor[:, -1] - factor[:, :-1] @ solution
    return float(np.sqrt(error @ error / max(rows.size - solution.size, 1)))
