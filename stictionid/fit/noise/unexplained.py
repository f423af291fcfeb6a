"""The shape of what a model misses: the past signals on which its innovations depend, and the response to each.

Columns pass the filter that whitens the residual, so that least squares on the innovations is generalised least squares
on the residual. Four groups of columns are tested, each jointly: valve moves, their direction, the process value of the
model, and time, alone and with the process value. Wrong where the noise model has taken most of what is missing: the
shares are then too small, the responses are not.

Source: Ljung, System Identification, section 16.6; docs/details.md, sections 10 and 11.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import TypeVar

import numpy as np

from ...effects import get, leaving, parse
from ...model.spec import INTEGRATOR
from ...numerics.autoregression import chi_square_z, filter_residual
from ...numerics.noise.normal import POINT_99
from ...numerics.spectrum import bands_of, lines_of
from ...record.study import BUT_FOR
from ...record.unexplained import Answer, Curve, Unexplained
from ...typing import FloatArray
from .completion import Refit

# Level of the joint tests (four of them), and the least share of the innovations' variance that asks for another model.
LEVEL, SHARE = 0.01, 0.05
_LIMIT = NormalDist().inv_cdf(1.0 - LEVEL / 4.0)
# Knots of a response, fewest and most lags in samples; a curve by value or time has so many pieces.
_KNOTS, _FEWEST, _MOST, _PIECES = 14, 8, 400, 8
# Directions of columns below this share of the largest count as dependent.
_DEPENDENT = 1e-4
# Words of the groups, and the trace (effects/contract) that each leaves beside those of the valve's lobes.
VALVE, DIRECTION, VALUE = "valve moves", "the direction of valve moves", "the process value"
TIME, DRIFT = "time", "valve moves, late ones otherwise than early ones"
T = TypeVar("T")
_TRACE = {DIRECTION: "direction", VALUE: "value", TIME: "level", DRIFT: "drift"}


@dataclass(frozen=True, slots=True)
class _Group:
    """Least squares of the innovations on one group of columns: coefficients (k,), their covariance, share and z."""

    values: FloatArray
    covariance: FloatArray
    share: float
    z: float

    def curve(self, at: FloatArray, of: FloatArray | None = None) -> Curve:
        """Combinations `of` (m, k) the coefficients, with bounds; the coefficients themselves without it."""
        of = np.eye(self.values.size) if of is None else of
        value = of @ self.values
        wide = POINT_99 * np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", of, self.covariance, of), 0.0))
        return Curve(*(tuple(x.tolist()) for x in (at, value, value - wide, value + wide)))


def unexplained_shape(done: Refit, tried: Collection[str] = ()) -> Unexplained | None:
    """The shape of what a completed model misses; None where its innovations are white, or answer next to nothing.

    A group of past signals must explain SHARE of the innovations' variance, beyond chance at LEVEL over all groups.
    Of effects that were `tried` beside the model the sentence says that they do not help enough.
    """
    if done.white:
        return None
    e, model = done.evaluated, done.model
    position, step_s = np.nan_to_num(e.position_means), model.step_s
    moves = np.diff(position, prepend=position[0])
    moves[list(model.loop.starts)] = 0.0
    longest = min(int(np.clip(model.period_s / step_s, _FEWEST, _MOST)), position.size // 4)
    lags = np.unique(np.round(np.concatenate([[0, 1, 2], np.geomspace(3, max(longest, 4), _KNOTS - 3)]))).astype(int)
    rows = done.good.copy()
    for start in model.loop.starts[1:]:
        rows[start:start + longest + 1] = False  # moves before these samples lie beyond the gap
    if rows.sum() < 10 * _KNOTS or not done.innovation[rows].any():
        return None
    level = np.nan_to_num(e.model - np.nanmean(e.model))
    unit = level / max(float(level.std()), 1e-300)
    t, place = np.linspace(-1.0, 1.0, level.size), (position - position.mean()) / max(float(position.std()), 1e-300)
    level_of, gain_of = [t, t**2, t**3], [t * unit, t**2 * unit]
    found = {VALVE: _regress_innovations(done, rows, _responses(moves, lags)),
             DIRECTION: _regress_innovations(done, rows, _responses(np.abs(moves), lags[::2])),
             VALUE: _regress_innovations(done, rows, [unit**2, unit**3, unit * place]),
             TIME: _regress_innovations(done, rows, [*level_of, *gain_of])}
    telling = {to: g for to, g in found.items() if g.z > _LIMIT and g.share >= SHARE}
    if not telling:
        return None
    named = max(telling, key=lambda to: telling[to].share)
    share = telling[named].share
    if named == TIME and \
            _regress_innovations(done, rows, gain_of).share > _regress_innovations(done, rows, level_of).share:
        named = DRIFT
    seconds = lags * step_s
    step = found[VALVE].curve(seconds)
    two = _regress_innovations(done, rows,
                               [*_responses(np.maximum(moves, 0.0), lags), *_responses(np.minimum(moves, 0.0), lags)])
    up, down = np.split(np.eye(2 * lags.size), 2)
    slope = (np.eye(lags.size)[1:] - np.eye(lags.size)[:-1]) / np.diff(lags)[:, None]
    f, power = lines_of(e.residual[model.loop.longest], (e.counted > 0)[model.loop.longest], step_s)
    trace, words = _words(named, step, done, share)
    have = {parse(name)[0].name for name in model.spec.effects}
    suggests = tuple(name for name in leaving(trace) if name not in have)
    names = sorted(suggests, key=lambda name: name in tried)[:2]
    said = "no effect of the catalogue is known to leave that"
    if names:
        names = names[:1] if named == VALVE else names
        said = " or ".join(names) + " would do that"
        said += f" ({get(names[0]).summary})" if len(names) == 1 else ""
        said += ", but was tried and does not help enough" if set(names) <= set(tried) else ""
    return Unexplained(
        named, f"the residual answers {words}: {said}", suggests,
        tuple(Answer(to, g.share, g.z) for to, g in found.items()),
        found[VALVE].curve(0.5 * (seconds[1:] + seconds[:-1]), slope), step, two.curve(seconds, up),
        two.curve(seconds, down), _pieces(done, rows, level + float(np.nanmean(e.model)), quantiles=True),
        _pieces(done, rows, model.loop.time_s, quantiles=False), bands_of(f, power))


def missing_words(shape: Unexplained) -> str:
    """The sentence about a model that leaves this shape."""
    return (f"none of the models tried explains this record: {shape.statement}; the innovations of the best one fail "
            f"the joint test at {100.0 * LEVEL:g} %")


def judged_by(shape: Unexplained | None, adequate: T, reason: str) -> tuple[T | bool, str]:
    """Adequacy and its reason beside the shape of what is missing: with one no model is adequate.

    A model that is not adequate anyway keeps its reason, except one that only a noise completes.
    """
    if shape is None or (adequate is False and BUT_FOR not in reason):
        return adequate, reason
    return False, f"however small its error, {shape.statement}"


def _regress_innovations(done: Refit, rows: np.ndarray, columns: Sequence[FloatArray]) -> _Group:
    """The innovations on columns (n,) that passed the same filter; the mean is taken out of both."""
    counted, starts = done.evaluated.counted > 0, done.model.loop.starts
    x = np.stack([filter_residual(c, counted, done.polynomial, starts)[0] for c in columns], axis=1)[rows]
    x, y = x - x.mean(axis=0), done.innovation[rows] - done.innovation[rows].mean()
    scale = np.linalg.norm(x, axis=0)
    scale[scale == 0.0] = 1.0
    u, s, vt = np.linalg.svd(x / scale, full_matrices=False)
    keep = s > max(_DEPENDENT * s.max(initial=0.0), 1e-300)
    u, back = u[:, keep], vt[keep].T / s[keep] / scale[:, None]
    if not keep.any():
        return _Group(np.zeros(len(columns)), np.zeros((len(columns), len(columns))), 0.0, 0.0)
    along, energy = u.T @ y, float(y @ y)
    share = float(along @ along) / energy
    left = energy * (1.0 - share) / max(y.size - int(keep.sum()), 1)
    return _Group(back @ along, left * (back @ back.T), share, chi_square_z(y.size * share, float(keep.sum())))


def _responses(moves: FloatArray, lags: np.ndarray) -> list[FloatArray]:
    """One column (n,) for each knot of a step response that is linear between its lags and constant after the last."""
    at, tail = np.arange(lags[-1] + 1), np.cumsum(moves)
    out = []
    for j in range(lags.size):
        hat = np.interp(at, lags, np.eye(lags.size)[j])
        column = np.convolve(moves, hat)[:moves.size]
        if j == lags.size - 1:
            column[hat.size:] += tail[:-hat.size]
        out.append(column)
    return out


def _pieces(done: Refit, rows: np.ndarray, signal: FloatArray, *, quantiles: bool) -> Curve:
    """Level of the residual over pieces of a signal (n,), against the mean of all pieces."""
    among = signal[rows]
    edges = np.quantile(among, np.linspace(0.0, 1.0, _PIECES + 1)) if quantiles else \
        np.linspace(among.min(), among.max(), _PIECES + 1)
    which = np.clip(np.searchsorted(edges, signal, side="right") - 1, 0, _PIECES - 1)
    have = [k for k in range(_PIECES) if (which[rows] == k).any()]
    group = _regress_innovations(done, rows, [(which == k).astype(np.float64) for k in have])
    at = np.array([float(among[which[rows] == k].mean()) for k in have])
    return group.curve(at, np.eye(len(have)) - 1.0 / len(have))


def _words(named: str, step: Curve, done: Refit, share: float) -> tuple[str, str]:
    """The trace of what is named, and the words for it: lobes of the response where it is the valve's."""
    much = f"{named} ({100.0 * share:.0f} % of the one-step errors)"
    if named != VALVE:
        return _TRACE[named], much
    lobes = _lobes(step, 1.0 if done.evaluated.gain >= 0.0 else -1.0)
    if not lobes:
        return "valve", much
    trace = "swing" if len(lobes) > 1 else "dip" if lobes[0][0] < 0.0 else "bump"
    size, begin, end = max(lobes, key=lambda lobe: abs(lobe[0]))
    integrates = done.model.spec.process == INTEGRATOR
    unit = done.model.loop.unit("process_value", "")
    how = f"{abs(size):.3g} {unit} for a move of 1 %".replace("  ", " ") if integrates else \
        f"{100.0 * abs(size / done.evaluated.gain):.2g} % of the gain"
    kind = {"dip": "a dip", "bump": "a bump", "swing": f"{len(lobes)} lobes in turn, the largest"}[trace]
    return trace, f"{named} with {kind} of {how} for {end - begin:.2g} s, {begin:.2g} s after the move"


def _lobes(step: Curve, sign: float) -> list[tuple[float, float, float]]:
    """Stretches of a response on one side of zero, beyond its bounds somewhere: peak, first and last zero in s.

    The peak is positive where the residual moves as the process does.
    """
    at, value = np.array(step.at), sign * np.array(step.value)
    sure = (np.array(step.low) > 0.0) | (np.array(step.high) < 0.0)
    out: list[tuple[float, float, float]] = []
    for part in np.split(np.arange(at.size), np.flatnonzero(np.diff(np.sign(value))) + 1):
        if not sure[part].any():
            continue
        best = part[sure[part]][np.abs(value[part[sure[part]]]).argmax()]
        begin, end = (_crossing(at, value, part[0] - 1, part[0]), _crossing(at, value, part[-1], part[-1] + 1))
        out.append((float(value[best]), begin, end))
    # A lobe far below the largest is what the noise model and the knots leave.
    top = max((abs(lobe[0]) for lobe in out), default=0.0)
    return [lobe for lobe in out if abs(lobe[0]) > 0.4 * top]


def _crossing(at: FloatArray, value: FloatArray, i: int, j: int) -> float:
    """Time at which a line between two knots crosses zero; the knot at either end of the response."""
    if i < 0 or j >= at.size:
        return float(at[max(i, 0) if j >= at.size else j])
    return float(at[i] + (at[j] - at[i]) * value[i] / (value[i] - value[j]))
