"""Tests of the residual: whiteness, correlation with the valve, lines in the spectrum. Joint tests at 1 %.

Point-wise 99 % bounds are shown but never decide: 22 % of perfectly white residuals leave one lag of 25 outside.
Source: Ljung and Box 1978; docs/details.md, sections 7, 10 and 11.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ..effects import leaving
from ..numerics.autoregression import autocovariance, chi_square_z, ljung_box
from ..numerics.noise.normal import POINT_99
from ..numerics.spectrum import bands_of, lines_of
from ..record.loop import Finding
from ..typing import FloatArray
from .model_run import Ground
from .suspects import Clue

# Level of each joint test. Unit: 1.
LEVEL = 0.01 / 3.0
_FEWEST_LAGS, _MOST_LAGS, _MOST_RESPONSE = 20, 200, 12
# A correlation that would lower the one-step error by less than this share is no fault, however significant.
_MATTERS = 0.005
# Weight of coloured errors, which every missing effect leaves. Unit: standard deviations.
_UNSPECIFIC = 2.0
# Share of the residual's power that a line must hold.
_LINE_SHARE = 0.05
# The slowest lines are drift, not oscillation; neighbours on either side that set a line's floor. Unit: lines.
_SLOWEST, _NEIGHBOURS = 4, 6


@dataclass(frozen=True, slots=True)
class Spectra:
    """Correlations and spectrum as numbers: lags (k,) in s with both correlations and their 99 % bound; bands."""

    lag_s: FloatArray
    autocorrelation: FloatArray
    cross: FloatArray
    bound: float
    bands: tuple[tuple[float, float, float, float], ...]


def whiteness(ground: Ground) -> tuple[FloatArray, Clue | None]:
    """Autocorrelation (k,) of the model's own one-step errors at lags 1…k, and a finding where they are coloured."""
    e, good = own_innovation(ground)
    n = int(good.sum())
    lag_s = ground.step_s * ground.pace
    lags = int(np.clip(ground.period_s / lag_s, _FEWEST_LAGS, min(_MOST_LAGS, max(n // 10, 2))))
    r = autocovariance(e, good, lags, ground.loop.starts)
    if r[0] <= 0.0 or n < 5 * _FEWEST_LAGS:
        return np.zeros(lags), None
    rho = r[1:] / r[0]
    q, z = ljung_box(rho, n, len(ground.model.spec.taps))
    left = np.mean(ground.innovation[ground.innovation != 0.0] ** 2) / r[0] \
        if ground.taps.size and not ground.model.taps.size else max(1.0 - float(np.abs(rho).max()) ** 2, 0.0)
    gain = 1.0 - float(np.sqrt(left))
    if z < NormalDist().inv_cdf(1.0 - LEVEL) or gain < _MATTERS:
        return rho, None
    outside = float((np.abs(rho) > POINT_99 / np.sqrt(n)).mean())
    worst = int(np.abs(rho).argmax())
    statement = (f"the one-step errors are not white: {100 * outside:.0f} % of {lags} lags lie outside the 99 % bounds "
                 f"(1 % would by chance), the largest correlation is {rho[worst]:.2f} at "
                 f"{(worst + 1) * lag_s:.3g} s; {n} samples are worth {ground.effective_rows:.0f}; the past "
                 f"of the error would lower it by {100 * gain:.1f} %")
    evidence = {"ljung_box": q, "lags": lags, "z": z, "outside_99": outside, "largest": float(rho[worst]),
                "at_s": float((worst + 1) * lag_s), "effective_rows": ground.effective_rows,
                "one_step_drop": gain}
    suggests = leaving("colour")
    found = Finding("residual-coloured", "serious" if gain > 0.2 else "warning", statement, evidence, suggests,
                    "Ljung and Box's joint test")
    return rho, Clue(found, _UNSPECIFIC, f"its own past would lower the error by {100 * gain:.0f} %")


def own_innovation(ground: Ground) -> tuple[FloatArray, np.ndarray]:
    """The complete model's one-step errors (n,) and where they count; without a noise model they are the residual."""
    if ground.model.taps.size:
        return ground.innovation, ground.innovation != 0.0
    return ground.residual, ground.good


def follows_valve(ground: Ground) -> tuple[FloatArray, Clue | None]:
    """Correlation (k,) of the one-step errors with past valve moves, and a finding where they follow the valve.

    The errors are regressed on a dozen lagged positions together: single correlations of a slow position say little.
    """
    e = ground.innovation
    good = e != 0.0
    v = ground.evaluated.position
    # What the errors are: residuals passed through the whitening filter. The position passes it too, unless the filter
    # goes from one PV to the next over samples that are missing.
    taps = ground.model.taps if ground.model.taps.size else ground.taps
    v = v - v.mean()
    if ground.pace == 1.0:
        v = np.convolve(v, np.concatenate([[1.0], taps]))[:v.size]
    moves = np.diff(v, prepend=v[0])
    moves[list(ground.loop.starts)] = 0.0
    # A short record (a second one, compared with an old study) may hold less than one period.
    longest = min(int(np.clip(ground.period_s / ground.step_s, 2, 60)), v.size - 1)
    for start in ground.loop.starts[1:]:
        good[start:start + longest + taps.size + 1] = False  # the valve's moves before these samples lie beyond the gap
    n = int(good.sum())
    cross = np.array([_correlation(e, _shifted(moves, k), good) for k in range(longest + 1)])
    lags = np.unique(np.round(np.linspace(0, longest, _MOST_RESPONSE)).astype(int))
    design = np.stack([_shifted(v, int(k)) for k in lags] + [np.ones(v.size)], axis=1)[good]
    if n < 10 * design.shape[1] or float(np.sum(e[good] ** 2)) == 0.0:
        return cross, None
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0.0] = 1.0
    solution, *_ = np.linalg.lstsq(design / scale, e[good], rcond=1e-10)
    explained = float(np.sum((design / scale @ solution) ** 2) / np.sum(e[good] ** 2))
    z = chi_square_z(n * explained, float(lags.size))
    if z < NormalDist().inv_cdf(1.0 - LEVEL) or explained < 2.0 * _MATTERS:
        return cross, None
    at = int(np.abs(cross).argmax())
    statement = (f"the one-step errors follow the valve: past positions explain {100 * explained:.1f} % of them, the "
                 f"largest correlation with its moves is {cross[at]:.2f} after {at * ground.step_s:.3g} s "
                 f"(99 % bound {POINT_99 / np.sqrt(n):.3f}): the way from valve to PV is not modelled right")
    evidence = {"explained": explained, "z": z, "lags": lags.tolist(), "largest": float(cross[at]),
                "at_s": float(at * ground.step_s)}
    found = Finding("residual-follows-valve", "serious" if explained > 0.2 else "warning", statement, evidence,
                    leaving("valve"), "joint test of lagged positions, docs/details.md, section 10")
    return cross, Clue(found, abs(z), f"past valve positions explain {100 * explained:.0f} % of the one-step error")


def _shifted(x: FloatArray, lag: int) -> FloatArray:
    return np.concatenate([np.full(lag, x[0]), x[:x.size - lag]]) if lag else x


def _correlation(a: FloatArray, b: FloatArray, good: np.ndarray) -> float:
    x, y = a[good] - a[good].mean(), b[good] - b[good].mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 0 else 0.0


def frequencies(ground: Ground) -> tuple[tuple[tuple[float, float, float, float], ...], Clue | None]:
    """Residual power by bands (period from, to, share of the power, share of the lines), and a line that stands out.

    The largest line is compared with the median of its neighbours, so that coloured noise has none. Of several segments
    the longest is used: a spectrum knows no gaps.
    """
    part = ground.loop.longest
    f, power = lines_of(ground.residual[part], ground.good[part], ground.step_s)
    bands = bands_of(f, power)
    if not bands:
        return (), None
    total = float(power.sum())
    floor = _floor(power)
    ratio = np.where(np.arange(power.size) < _SLOWEST, 0.0, power / floor)
    k = int(ratio.argmax())
    held = float(power[max(k - 1, 0):k + 2].sum()) / total
    # Chance of the largest of m exponential lines.
    chance = -float(np.expm1(ratio.size * np.log1p(-np.exp(-min(float(ratio[k]), 700.0)))))
    if chance > LEVEL or held < _LINE_SHARE:
        return bands, None
    period = 1.0 / float(f[k])
    near = [h for h in range(1, 6) if abs(ground.period_s / h / period - 1.0) < 0.05]
    statement = f"{100 * held:.0f} % of the residual's power lies at a period of {period:.4g} s"
    if near:
        harmonic = f" harmonic {near[0]}" if near[0] > 1 else ""
        statement += f", the oscillation's own{harmonic}: the cycle's shape, or a disturbance of its period"
        suggests = leaving("own line")
    else:
        statement += f", which is not the oscillation's ({ground.period_s:.4g} s)"
        suggests = leaving("line")
    found = Finding("residual-line", "serious" if held > 0.3 else "warning", statement,
                    {"period_s": period, "share": held, "chance": float(chance)}, suggests,
                    "largest of many exponential lines over their local median")
    return bands, Clue(found, float(np.sqrt(-2.0 * np.log(max(chance, 1e-300)))),
                       f"{100 * held:.0f} % of the residual's power has a period of {period:.3g} s")


def _floor(power: FloatArray) -> FloatArray:
    """Local mean (k,) of a spectrum from medians over neighbours, which a line does not raise."""
    out = np.empty_like(power)
    for k in range(power.size):
        half = max(_NEIGHBOURS, k // 8)
        out[k] = np.median(power[max(k - half, 0):k + half + 1])
    return np.maximum(out / np.log(2.0), 1e-300)
