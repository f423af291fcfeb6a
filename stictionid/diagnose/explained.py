"""Whether an autoregression explains all that a model leaves, so that nothing is left for another base or an effect.

An autoregression imitates a slow disturbance by a root near 1, and what valve and process do it leaves where it
happens: in innovations that follow past positions, are larger after moves or in some stretches, or have heavy tails. A
noise of short memory whose innovations pass joint tests for all that asks for no hunting. Wrong where an effect moves y
by less than the tests see: some 2 per cent of the innovations' variance in 1500 samples, less than names an effect.

Source: CRITICISM.md section 7, steps 1 and 2; Ljung and Box 1978; Engle 1982 (squares of innovations).
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from ..compare.linear import chi_square_z
from ..loop import BoolArray, FloatArray
from ..noise import autocovariance
from ..refit import Refit

# Level of all four tests together, of one-sided normal values.
_LIMIT = NormalDist().inv_cdf(1.0 - 0.01 / 4.0)
# A noise with a root beyond this remembers so long that it may be a disturbance: a step, a ramp or a sine needs one
# near 1. Unit: 1.
_SHORT = 0.9
# Lags of the autocorrelation at least, and at most (one period between them); lagged positions; lagged moves; stretches
# of the record whose variance may differ.
_FEWEST, _MOST, _POSITIONS, _MOVES, _STRETCHES = 20, 200, 12, 8, 10
# Directions of columns below this share of the largest are taken for dependent.
_DEPENDENT = 1e-8


def noise_alone(done: Refit) -> bool:
    """Whether a model completed with an autoregression leaves nothing but noise of short memory.

    False, too, where it is fitted in changes of y, which hide whatever is slow, and where there is no autoregression.
    """
    taps = done.taps
    if not taps.size or done.increments or done.own:
        return False
    if np.abs(np.roots(np.concatenate([[1.0], taps]))).max() > _SHORT:
        return False
    good = done.good
    e = np.where(good, done.innovation, 0.0)
    rows = float(good.sum())
    if rows < 10 * (_POSITIONS + 2 * _MOVES + _STRETCHES) or not e.any():
        return False
    return max(_correlated(done, e, good), _explained(e, good, _known(done)), _uneven(done, e, good),
               _heavy(e[good])) < _LIMIT


def _correlated(done: Refit, e: FloatArray, good: BoolArray) -> float:
    """Ljung and Box's joint test of the autocorrelations over one period, as a normal value."""
    model, rows = done.model, float(good.sum())
    lags = int(np.clip(model.period_s / model.step_s, _FEWEST, min(_MOST, rows // 10)))
    c = autocovariance(e, good, lags, model.loop.starts)
    rho = c[1:] / c[0]
    q = rows * (rows + 2.0) * float(np.sum(rho**2 / (rows - np.arange(1, lags + 1))))
    return chi_square_z(q, max(lags - done.taps.size, 1))


def _known(done: Refit) -> FloatArray:
    """Columns (n, q) of what came before each sample: positions as the noise filters them, moves either way, curvature
    and products, and the course of time."""
    model, position = done.model, done.evaluated.position
    x, y = position - position.mean(), model.loop.process_value - np.nanmean(model.loop.process_value)
    white = np.convolve(x, np.concatenate([[1.0], done.taps]))[:x.size]
    longest = max(int(np.clip(model.period_s / model.step_s, 2, 60)), 2)
    back = np.unique(np.round(np.linspace(1, longest, _POSITIONS)).astype(int))
    before, level = _later(x, 1), _later(np.nan_to_num(y), 1)
    t = np.linspace(-1.0, 1.0, x.size)
    return np.stack([*(_later(white, int(k)) for k in back), *_moves(done, 1.0), *_moves(done, 0.0), before**2,
                     before * level, level**2, t, t**2, t**3, before * t], axis=1)


def _moves(done: Refit, signed: float) -> list[FloatArray]:
    """The moves of the valve at a few lags, with their direction or without."""
    position = done.evaluated.position
    move = np.diff(position, prepend=position[0])
    move[list(done.model.loop.starts)] = 0.0
    return [_later(move if signed else np.abs(move), k) for k in range(1, _MOVES + 1)]


def _uneven(done: Refit, e: FloatArray, good: BoolArray) -> float:
    """Whether the squares of the innovations follow the moves or the stretch of the record, as a normal value."""
    stretch = np.minimum(np.arange(e.size) * _STRETCHES // e.size, _STRETCHES - 1)
    blocks = [(stretch == s).astype(np.float64) for s in range(1, _STRETCHES)]
    return _explained(e**2, good, np.stack([*_moves(done, 0.0), *blocks], axis=1))


def _heavy(e: FloatArray) -> float:
    """Kurtosis beyond a normal distribution's, as a normal value."""
    return (float(np.mean(e**4)) / float(np.mean(e**2)) ** 2 - 3.0) / float(np.sqrt(24.0 / e.size))


def _explained(signal: FloatArray, good: BoolArray, columns: FloatArray) -> float:
    """What columns (n, q) explain of a signal (n,), as a normal value: rows times the share is χ² under chance."""
    x, y = columns[good], signal[good]
    x, y = x - x.mean(axis=0), y - y.mean()
    scale = np.linalg.norm(x, axis=0)
    u, s, _ = np.linalg.svd(x[:, scale > 0.0] / scale[scale > 0.0], full_matrices=False)
    u = u[:, s > _DEPENDENT * s.max(initial=0.0)]
    if not u.shape[1]:
        return 0.0
    share = float(np.sum((u.T @ y) ** 2)) / max(float(y @ y), 1e-300)
    return chi_square_z(y.size * share, float(u.shape[1]))


def _later(x: FloatArray, lag: int) -> FloatArray:
    """A signal (n,) so many samples later."""
    return np.concatenate([np.full(lag, x[0]), x[:-lag]])
