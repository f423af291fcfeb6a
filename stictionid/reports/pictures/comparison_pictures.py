"""Pictures of a comparison, one for each question: the parts of the record where the model fails.

They arrange numbers that `compare` found; the renderers draw them.
"""

from __future__ import annotations

import numpy as np

from ...comparison import Comparison
from ...comparison.cells import Cell
from .. import wording
from .measures import joined, passed, stretches, thin
from .picture import Band, Line, Panel, Picture, Rule

# Bins of a trend and points of a scatter plot.
_BINS, _POINTS = 600, 1500
# A stretch is shaded where the running error of a quarter period exceeds this multiple of the record's error.
_STANDS_OUT = 1.6
_TITLES = {"time": "Error along the record", "phase": "Error while the valve sticks, slips and slides",
           "direction": "Error by direction of travel", "output": "Error over the controller output",
           "value": "Error over the process value", "cycle": "Error over the phase of the cycle",
           "setpoint": "Error around setpoint moves"}

# Titles of the small pictures, which all show the error.
_QUESTIONS = {"time": "along the record", "phase": "by phase of the valve", "direction": "by direction",
              "output": "by OP", "value": "by PV", "cycle": "over the cycle", "setpoint": "around setpoint moves"}


def comparison_pictures(c: Comparison) -> dict[str, Picture]:
    """Every picture by key, in reading order."""
    found = [_fit(c), *(_cells(c, name, cells) for name, cells in c.tables.items() if cells), _cycle(c),
             _cloud(c, "op"), _cloud(c, "pv"), _correlations(c), _bands(c)]
    return {p.key: p for p in found if p is not None}


def overview(c: Comparison) -> list[Picture]:
    """The error of each part of the record, one small picture for each question, all on one scale."""
    shown = {name: cells for name, cells in c.tables.items() if cells}
    top = max((cell.rms for cells in shown.values() for cell in cells), default=0.0)
    return [_small(c, name, cells, top) for name, cells in shown.items()]


def _small(c: Comparison, name: str, cells: tuple[Cell, ...], top: float) -> Picture:
    whole = _cells(c, name, cells)
    lines = []
    for word, role, fails in (("stands out", "optimum", True), ("error", "rule", False)):
        at = [i for i, cell in enumerate(cells) if cell.fails == fails]
        if at:
            lines.append(Line(word, role, np.array([cells[i].rms for i in at]), np.array(at, float), "bars"))
    panel = Panel("", "", tuple(lines), names=_short([cell.label for cell in cells]), x_to=top,
                  rules=(Rule("x", c.error.rmse, "all", "bound"),))
    return Picture(f"small_{name}", _QUESTIONS.get(name, name), whole.alt, "", (panel,))


def _short(labels: list[str]) -> tuple[str, ...]:
    """Labels without the words that all begin or end with."""
    words = [label.split() for label in labels]
    while len(words) > 1 and min(map(len, words)) > 2 and len({w[0] for w in words}) == 1:
        words = [w[1:] for w in words]
    while len(words) > 1 and min(map(len, words)) > 3 and len({w[-1] for w in words}) == 1:
        words = [w[:-1] for w in words]
    return tuple(wording.clean(" ".join(w), 24) for w in words)


def _unit(c: Comparison) -> str:
    return wording.clean(c.ground.loop.unit("process_value", "unit of y"), 24)


def _shading(c: Comparison) -> tuple[Band, ...]:
    g = c.ground
    width = min(int(max(0.25 * g.period_s / g.step_s, 8)), g.residual.size)
    window = np.ones(width)
    mean = np.convolve(g.residual**2, window, "same") / np.maximum(np.convolve(g.good.astype(float), window, "same"), 1)
    bad = (mean > (_STANDS_OUT * g.rmse) ** 2) & g.good
    return tuple(Band(start, end, "failing") for start, end in stretches(bad, g.step_s))


def _fit(c: Comparison) -> Picture:
    g = c.ground
    t = g.loop.time_s
    bands = _shading(c)
    model = np.where(g.good | passed(g.loop), g.evaluated.model, np.nan)
    measured, residual = (joined(g.loop, x) for x in (g.loop.process_value, np.where(g.good, g.residual, np.nan)))
    said = f"The free-run error is {wording.number(c.error.rmse)} {_unit(c)}"
    said += f", {wording.number(c.error.rmse / c.error.noise_sd)} times the noise." if c.error.noise_sd else "."
    return Picture("fit", "Model against measurement", said,
                   "Measured PV and the model's free run, their difference below; shaded where it stands out.",
                   (Panel("", f"PV, {_unit(c)}", (Line("PV measured", "pv", *thin(t, measured, _BINS)),
                                                  Line("model", "model", *thin(t, model, _BINS))), bands, height=1.5),
                    Panel("time, s", f"residual, {_unit(c)}",
                          (Line("residual", "residual", *thin(t, residual, _BINS)),), bands,
                          rules=(Rule("y", 0.0),), height=0.8)), wide=True)


def _cells(c: Comparison, name: str, cells: tuple[Cell, ...]) -> Picture:
    at = np.arange(len(cells), dtype=float)
    failing = [cell for cell in cells if cell.fails]
    names = tuple(wording.clean(cell.label, 30) + (" (fails)" if cell.fails else "") for cell in cells)
    alt = ("No part stands out." if not failing else
           f"The model fails in {len(failing)} of {len(cells)} parts, most at "
           f"{wording.clean(max(failing, key=lambda x: x.weight).label, 30)}.")
    return Picture(f"by_{name}", _TITLES.get(name, name), alt,
                   "Bars: free-run error of each part; dots: its mean; dashed: the error of the whole record.",
                   (Panel(f"error, {_unit(c)}", "",
                          (Line("error", "residual", np.array([x.rms for x in cells]), at, "bars"),
                           Line("mean", "model", np.array([x.mean for x in cells]), at, "points")),
                          rules=(Rule("x", c.error.rmse, "all", "bound"),), names=names),))


def _cycle(c: Comparison) -> Picture | None:
    """Residual against the phase of the cycle, all cycles overlaid."""
    g = c.ground
    phase = g.cycle_phase
    keep = np.flatnonzero(np.isfinite(phase) & g.good)
    if keep.size < 30:
        return None
    keep = keep[::max(1, keep.size // _POINTS)]
    return Picture("over_cycle", "Residual over the phase of the cycle",
                   f"The residual of {len(g.found.cycles)} cycles laid on top of each other.",
                   "Each dot is a sample; a band that leaves zero is an error that every cycle repeats.",
                   (Panel("phase of the cycle", f"residual, {_unit(c)}",
                          (Line("residual", "residual", phase[keep], g.residual[keep], "points"),),
                          rules=(Rule("y", 0.0),)),))


def _cloud(c: Comparison, what: str) -> Picture:
    g = c.ground
    keep = np.flatnonzero(g.good)
    keep = keep[::max(1, keep.size // _POINTS)]
    x = g.loop.output if what == "op" else g.evaluated.model
    label = f"OP, {wording.name(c.ground.loop.unit('output', '%'))}" if what == "op" else f"PV of the model, {_unit(c)}"
    return Picture(f"over_{what}", f"Residual over {what.upper()}", f"Residual of {keep.size} samples over "
                   f"{what.upper()}.", "Each dot is a sample; a slope or a bend is a gain that changes.",
                   (Panel(label, f"residual, {_unit(c)}", (Line("residual", "residual", x[keep], g.residual[keep],
                                                               "points"),), rules=(Rule("y", 0.0),)),))


def _correlations(c: Comparison) -> Picture:
    s = c.spectra
    bounds = (Rule("y", 0.0), Rule("y", s.bound, "99 %", "bound"), Rule("y", -s.bound, "", "bound"))
    outside = float((np.abs(s.autocorrelation) > s.bound).mean()) if s.lag_s.size else 0.0
    return Picture("correlation", "Correlation of the one-step errors",
                   f"{wording.number(100 * outside, 2)} % of the lags lie outside the 99 % bounds.",
                   "Above with their own past, below with past moves of the valve; dashed: 99 % bounds of one lag.",
                   (Panel("", "autocorrelation", (Line("errors", "residual", s.lag_s, s.autocorrelation, "stems"),),
                          rules=bounds),
                    Panel("lag, s", "with valve moves", (Line("valve", "position", s.lag_s, s.cross, "stems"),),
                          rules=bounds)), wide=True)


def _bands(c: Comparison) -> Picture | None:
    bands = c.spectra.bands
    if not bands:
        return None
    at = np.arange(len(bands), dtype=float)
    names = tuple(f"{wording.number(b[0])} to {wording.number(b[1])} s" for b in bands)
    top = max(range(len(bands)), key=lambda i: bands[i][2])
    return Picture("by_frequency", "Power of the residual by period",
                   f"Most of the power, {wording.percent(100 * bands[top][2])}, lies at periods of {names[top]}.",
                   "Bars: share of the residual's power in each band of periods; dots: its share of all lines, which "
                   "white noise would fill.",
                   (Panel("share", "", (Line("power", "residual", np.array([b[2] for b in bands]), at, "bars"),
                                        Line("white noise", "model", np.array([b[3] for b in bands]), at, "points")),
                          names=names),))
