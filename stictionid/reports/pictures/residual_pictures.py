"""Pictures of the residual: its autocorrelation with bounds and its spectrum over the period."""

from __future__ import annotations

import numpy as np

from ...model.spec import Curves
from ...numerics.noise.normal import POINT_99
from ...record.loop import Loop
from ...record.study import Study
from .. import wording
from . import measures
from .picture import Line, Panel, Picture, Rule

# Fewest residuals for a picture of their correlation. Unit: samples.
_FEWEST = 32
# Harmonics of the oscillation marked in the spectrum. Unit: 1.
_HARMONICS = 3
# Bins of the thinned spectrum. Unit: 1.
_SPECTRUM_BINS = 300


def both(study: Study, loop: Loop, last: Curves) -> tuple[Picture, ...]:
    """Autocorrelation and spectrum of the residual on its longest stretch; none where that is too short."""
    run = measures.longest_run(np.isfinite(last.residual) & loop.used)
    residual = last.residual[run]
    if residual.size < _FEWEST or float(np.ptp(residual)) == 0.0:
        return ()
    return autocorrelation(study, loop, residual), spectrum(study, loop, residual, loop.process_value[run])


def autocorrelation(study: Study, loop: Loop, residual: np.ndarray) -> Picture:
    """Autocorrelation of the residual (k,): the part that its own past predicts."""
    period = study.range.period_median_s
    most = measures.lags_for(residual.size, period / loop.step_s if period else None)
    r = measures.autocorrelation(residual, most)[1:]
    lag = np.asarray(np.arange(1, most + 1) * loop.step_s, float)
    bound = POINT_99 / np.sqrt(residual.size)
    outside = float((np.abs(r) > bound).mean())
    word = ("looks like white noise" if outside <= 0.03 else
            "is coloured: its past predicts part of it" if outside < 0.5 else "still holds a pattern")
    peak = int(np.abs(r).argmax())
    return Picture("acf", "Autocorrelation of the residual",
                   f"{wording.number(100 * outside, 2)} % of the lags lie outside the 99 % bounds: the residual {word}."
                   f" The largest is {wording.number(float(r[peak]), 2)} at {wording.number(float(lag[peak]))} s.",
                   f"The residual {word}. Dashed: 99 % bounds of white noise.",
                   (Panel("lag, s", "autocorrelation", (Line("residual", "residual", lag, r, "stems"),),
                          rules=(Rule("y", 0.0), Rule("y", float(bound), "99 %", "bound"),
                                 Rule("y", -float(bound), "", "bound"))),))


def spectrum(study: Study, loop: Loop, residual: np.ndarray, measured: np.ndarray) -> Picture:
    """Power over the period for residual and PV, with the oscillation and its harmonics marked."""
    period, power = measures.spectrum(residual, loop.step_s)
    _, power_pv = measures.spectrum(measured, loop.step_s)
    share = float(residual.var() / measured.var()) if measured.var() > 0 else 0.0
    cycle = study.range.period_median_s
    rules = tuple(Rule("x", cycle / h, "T" if h == 1 else f"T/{h}", "guide") for h in range(1, _HARMONICS + 1)
                  if cycle / h >= 2 * loop.step_s) if cycle else ()
    strongest = float(period[int(power.argmax())])
    # log10, so that both renderers draw plain numbers; the axis label says so.
    floor = max(float(power_pv.max()) * 1e-8, 1e-300)

    def decades(p: np.ndarray) -> np.ndarray:
        return np.asarray(np.log10(np.maximum(p, floor)), float)

    lines = tuple(Line(name, role, *measures.thin(period[::-1], decades(p)[::-1], _SPECTRUM_BINS))
                  for name, role, p in (("PV", "pv", power_pv), ("residual", "residual", power * share)))
    return Picture("spectrum", "Spectrum of PV and residual",
                   f"The residual holds {wording.percent(100 * share)} of PV's variance, most at a period of "
                   f"{wording.number(strongest)} s.",
                   "Power of PV and of what the model leaves, over the period; T is the oscillation, T/2 and T/3 its "
                   "harmonics.",
                   (Panel("period, s", "log10 of power", lines, rules=rules, log_x=True),))


