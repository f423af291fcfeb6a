"""Pictures of a study as numbers: Figures 8 to 11 of Shang et al., and others that engineers use.

Each function makes one picture, or None where the case has no numbers for it. Source: Shang et al., Fig. 8 to 11; the
other pictures from the conventions in docs/details.md, section 13.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ...model.spec import Curves
from ...record.loop import Loop
from ...record.study import Study
from ...record.swing import BANDS
from ...system.plurals import counted
from ...typing import FloatArray
from .. import ranking, wording
from ..sections import added_later, mapped_step
from . import measures
from .picture import Band, Box, Cells, Line, Mark, Panel, Picture, Rule

# Bins of the min-max thinning of a static trend: about two per 3 pixels of a page-wide picture.
TREND_BINS = 600
# Periods drawn in phase plots and close-ups, and the most points of such a plot. Unit: periods, points.
CLOSE_PERIODS = 6
_CLOSE_POINTS = 1500
# Records longer than this many periods get a close-up beside the whole record. Unit: periods.
_CLOSE_FROM = 12
# Most effects in the picture of those tried.
_MOST_CANDIDATES = 12
# Most gaps of a record that are marked on its trend; more would be a hatching.
_MOST_GAPS = 20


def time_unit(span_s: float) -> tuple[float, str]:
    """Seconds per unit and the unit that keeps a time axis of `span_s` seconds readable."""
    for limit, size, unit in ((3 * 86400, 86400.0, "days"), (3 * 3600, 3600.0, "h"), (600, 60.0, "min")):
        if span_s > limit:
            return size, unit
    return 1.0, "s"


def shading(study: Study, loop: Loop, last: Curves | None, per: float) -> tuple[Band, ...]:
    """Bands of unused samples and failing stretches, in units of `per` seconds."""
    bad = measures.failing(study, loop, last.residual) if last is not None else ()
    return (*(Band(start / per, end / per, "unused") for start, end in measures.unused(loop)),
            *(Band(start / per, end / per, "failing") for start, end in bad))


def thin_line(name: str, role: str, x: FloatArray, y: FloatArray) -> Line:
    """A curve (n,) with as few points as a trend shows."""
    return Line(name, role, *measures.thin(x, y, TREND_BINS))


def trend(study: Study, loop: Loop, last: Curves | None) -> Picture:
    """Fig. 8 and 9: r and y above, u below, over the whole record, with the model and the valve positions."""
    per, unit = time_unit(loop.samples * loop.step_s)
    t = loop.time_s / per
    upper = [thin_line("PV", "pv", t, measures.joined(loop, loop.process_value))]
    if loop.setpoint is not None:
        upper.insert(0, thin_line("SP", "sp", t, loop.setpoint))
    if last is not None:
        upper.append(thin_line("model", "model", t, last.model))
    lower = [thin_line("OP", "op", t, loop.output)]
    if loop.position is not None:
        lower.append(thin_line("measured position", "position", t, loop.position))
    if last is not None and np.isfinite(last.position).any():
        lower.append(thin_line("inferred position", "bound", t, last.position))
    bands = shading(study, loop, last, per)
    gaps = tuple(Rule("x", start * loop.step_s / per, "gap" if k == 0 else "")
                 for k, start in enumerate(loop.starts[1:_MOST_GAPS + 1]))
    failing = [b for b in bands if b.role == "failing"]
    finding = ("" if last is None else " No stretch stands out with a larger error." if not failing else
               f" The model fails on {len(failing)} stretch{'es' if len(failing) > 1 else ''}, the first from "
               f"{wording.number(failing[0].start)} to {wording.number(failing[0].end)} {unit}.")
    return Picture("trend", "Trends of SP, PV and OP",
                   f"PV runs from {_extent(loop.process_value, loop, 'process_value')}, OP from "
                   f"{_extent(loop.output, loop, 'output', '%')} over {wording.duration(loop.samples * loop.step_s)}."
                   + finding, f"{wording.listed([line.name for line in upper])} above, "
                   f"{wording.listed([line.name for line in lower])} below." + _shaded_words(bands),
                   (Panel("", axis_label("PV", loop, "process_value"), tuple(upper), bands, rules=gaps, height=1.2),
                    Panel(f"time, {unit}", axis_label("OP", loop, "output", "%"), tuple(lower), bands, rules=gaps)),
                   wide=True)


def _shaded_words(bands: Sequence[Band]) -> str:
    """The meaning of the shading, where there is any."""
    roles = {b.role for b in bands}
    said = [word for role, word in (("failing", "shaded: where the model fails"), ("unused", "hatched: samples not "
                                    "used")) if role in roles]
    return f" {'; '.join(said).capitalize()}." if said else ""


def _extent(values: FloatArray, loop: Loop, role: str, default: str = "") -> str:
    good = values[np.isfinite(values)]
    if not good.size:
        return "nothing finite"
    unit = wording.name(loop.unit(role, default))
    return f"{wording.number(float(good.min()), 4)} to {wording.number(float(good.max()), 4)} {unit}".rstrip()


def unit_of(loop: Loop, role: str, default: str = "") -> str:
    """The unit of one signal, short enough for an axis."""
    return wording.clean(loop.unit(role, default), 24)


def axis_label(what: str, loop: Loop, role: str, default: str = "") -> str:
    """The name of an axis with the unit of the signal on it, where it has one."""
    unit = unit_of(loop, role, default)
    return f"{what}, {unit}" if unit else what


def window(study: Study, loop: Loop) -> slice:
    """The last CLOSE_PERIODS periods of the longest used stretch, or its last points where there is no period."""
    good = loop.used & np.isfinite(loop.process_value) & np.isfinite(loop.output) | measures.passed(loop)
    runs = [(part.start, measures.longest_run(good[part])) for part in loop.segments]
    run = max((slice(at + r.start, at + r.stop) for at, r in runs), key=lambda r: r.stop - r.start)
    period = study.range.period_median_s
    size = round(CLOSE_PERIODS * period / loop.step_s) + 1 if period else _CLOSE_POINTS
    return slice(max(run.start, run.stop - max(size, 16)), run.stop)


def _both_ways(part: slice, loop: Loop, position: FloatArray) -> slice:
    """The last window as long as `part` in which the valve (n,) breaks away both ways; else the one it moves most in.
    """
    size, moves = part.stop - part.start, np.diff(position, prepend=position[:1])
    rest = 1e-6 * max(float(np.ptp(position[np.isfinite(position)])), 1e-12)
    # From the last window backwards by halves, inside one segment.
    starts = [s for s in range(part.start, -1, -max(size // 2, 1))
              if any(g.start <= s and s + size <= g.stop for g in loop.segments)] or [part.start]

    def least(start: int) -> float:
        inside = moves[start + 1:start + size]
        return min(float(np.nansum(np.where(sign * inside > rest, np.abs(inside), 0.0))) for sign in (1.0, -1.0))

    found = next((s for s in starts if least(s) > 0.0), max(starts, key=least))
    return slice(found, found + size)


def _every(part: slice) -> slice:
    """`part` with a stride that keeps at most _CLOSE_POINTS points."""
    return slice(part.start, part.stop, max(1, -(-(part.stop - part.start) // _CLOSE_POINTS)))


def _when(part: slice, loop: Loop) -> str:
    return f"{wording.number(part.start * loop.step_s)} s to {wording.number(part.stop * loop.step_s)} s"


def characteristic(study: Study, loop: Loop, last: Curves) -> Picture | None:
    """Fig. 10: controller output against valve position, inferred and measured, with the sliding lines."""
    e = study.estimate
    if e is None or not np.isfinite(last.position).any():
        return None
    part = _both_ways(window(study, loop), loop, last.position)
    k = _every(part)
    u, v = last.output[k], last.position[k]
    lines = []
    ends = np.array([float(np.nanmin(u)), float(np.nanmax(u))]) if u.size else np.array([0.0, 1.0])
    half = (e.S - e.J) / 2
    lines += [Line("sliding, OP ± f_d", "guide", ends, ends - half), Line("", "guide", ends, ends + half)]
    if loop.position is not None:
        lines.append(Line("measured position", "position", u, _as_travel(study, loop.position[k])))
    lines.append(Line("inferred position", "model", u, v, "arrows"))
    size = (f"S {wording.estimate(e.S, e.S_interval, e.unit, e.S_pieces)}, "
            f"J {wording.jump(e.J, e.J_interval, e.unit, e.J_pieces, known=e.J_known)}")
    beside = ""
    if e.from_position is not None:
        beside = (f" Read from the measured position: S {wording.number(e.from_position.S)}, "
                  f"J {wording.number(e.from_position.J)} {wording.name(e.unit)}.")
    return Picture("characteristic", "Valve characteristic",
                   f"Controller output against valve position: {size}.{beside}",
                   f"Inferred valve position over OP, {_when(part, loop)}, arrows in the direction of time; dashed: "
                   f"where the stem slides. {size}.{beside}",
                   (Panel(axis_label("OP", loop, "output", "%"), axis_label("valve position", loop, "output", "%"),
                          tuple(lines)),))


def _as_travel(study: Study, position: FloatArray) -> FloatArray:
    """Measured position (k,) on the scale of the inferred one: gain, offset and direction of its fit removed."""
    p = study.estimate.from_position if study.estimate else None
    if p is None or not p.gain or p.offset is None:
        return position
    return (position - p.offset) / p.gain


def phase(study: Study, loop: Loop) -> Picture:
    """OP against PV with the direction of time: an ellipse is linear, sharp corners are friction."""
    part = window(study, loop)
    k = _every(part)
    return Picture("phase", "Phase plot OP-PV",
                   f"Process value against controller output from {_when(part, loop)}.",
                   f"PV over OP, {_when(part, loop)}, arrows in the direction of time. A smooth ellipse is a linear "
                   "loop, sharp corners or a parallelogram point to friction.",
                   (Panel(axis_label("OP", loop, "output", "%"), axis_label("PV", loop, "process_value"),
                          (Line("PV over OP", "pv", loop.output[k], measures.joined(loop, loop.process_value)[k],
                                "arrows"),)),))


def fit(study: Study, loop: Loop, last: Curves) -> Picture | None:
    """Fig. 11: free-run model output and measurement over the whole record, residual below."""
    return _fit(study, loop, last, slice(0, loop.samples), "fit", "Model against measurement")


def closeup(study: Study, loop: Loop, last: Curves) -> Picture | None:
    """The fit picture over a few periods, where the record is too long to show them."""
    period = study.range.period_median_s
    if not period or loop.samples * loop.step_s < _CLOSE_FROM * period:
        return None
    return _fit(study, loop, last, window(study, loop), "closeup", "Close-up of the last periods")


def _fit(study: Study, loop: Loop, last: Curves, part: slice, key: str, title: str) -> Picture | None:
    if not np.isfinite(last.model[part]).any():
        return None
    per, unit = time_unit(loop.samples * loop.step_s if key == "fit" else (part.stop - part.start) * loop.step_s)
    t = loop.time_s[part] / per
    bands = tuple(b for b in shading(study, loop, last, per)
                  if key == "fit" or (b.end > t[0] and b.start < t[-1]))
    error = study.steps[-1].error
    residual = measures.joined(loop, last.residual)[part]
    good = residual[np.isfinite(residual)]
    pv_unit = loop.unit("process_value")
    alt = (f"The model follows PV with a free-run error of {wording.with_unit(error.best, pv_unit)}"
           + (f", {wording.number(error.best / error.noise_sd)} times the noise" if error.noise_sd else "")
           + (f"; the largest residual here is {wording.with_unit(float(np.abs(good).max()), pv_unit)}."
              if good.size else "."))
    rules, measured = [Rule("y", 0.0)], measures.joined(loop, loop.process_value)
    if error.noise_sd:
        rules += [Rule("y", s * 2 * error.noise_sd, "±2 noise" if s > 0 else "", "bound") for s in (1, -1)]
    return Picture(key, title, alt, "Measured PV and the model's free run; below, their difference with twice the "
                   "noise either way." if error.noise_sd else "Measured PV and the model's free run; below, their "
                   "difference.",
                   (Panel("", axis_label("PV", loop, "process_value"),
                          (thin_line("PV measured", "pv", t, measured[part]),
                           thin_line("model", "model", t, last.model[part])), bands, height=1.5),
                    Panel(f"time, {unit}", axis_label("residual", loop, "process_value"),
                          (thin_line("residual", "residual", t, residual),), bands, rules=tuple(rules), height=0.8)),
                   wide=True)


def cost_map(study: Study) -> Picture | None:
    """Error that the fit made small over S and J, with the optimum, its intervals and the ends of the searches."""
    m, e = study.cost_map, study.estimate
    if m is None or not m.S or not m.J or not m.rmse:
        return None
    across = tuple(tuple(row[j] if j < len(row) else None for row in m.rmse) for j in range(len(m.J)))
    marks = [Mark(s, j, "searches ended", "search") for s, j in m.searched]
    boxes: list[Box] = []
    unit = wording.name(e.unit) if e is not None else "%"
    error_unit = wording.name(study.data.units.get("process_value") or "units of PV")
    known = [v for row in m.rmse for v in row if v is not None]
    known_J = e is None or e.J_known
    mapped = mapped_step(study)
    ahead = mapped is not None and bool(study.steps[mapped].model.get("taps") or
                                        study.steps[mapped].model.get("increments"))
    kind = "One-step error" if ahead else "Free-run error"
    alt = f"{kind} over a grid of S and J" + (
        f", from {wording.number(min(known))} to {wording.number(max(known))} {error_unit}." if known else ".")
    title = "Cost map of S and J"
    optimum = _mapped_optimum(study)
    if optimum is not None:
        S, J, S_interval, J_interval = optimum
        marks.append(Mark(S, J, "optimum", "optimum"))
        alt += f" The optimum lies at {_place(S, J, unit, known=known_J)}."
        if S_interval is not None and J_interval is not None and e is not None:
            boxes.append(Box(*S_interval, *J_interval, f"{wording.number(100 * e.interval_level, 2)} % intervals"))
    later = added_later(study)
    if later and e is not None:
        title += " before effects were added"
        marks.append(Mark(e.S, e.J, "last model", "last"))
        alt += f" With {wording.listed([wording.name(s.added) for s in later])} the model ends at " \
               f"{_place(e.S, e.J, unit, known=known_J)}."
    return Picture("cost_map", title, alt,
                   f"{kind}, {error_unit}, for each pair of S and J with lags, dead time and start force held "
                   "at their best and the gain refitted; the fuller the colour, the smaller the error, in equal steps "
                   "of its logarithm. Empty: J above 2 S, which no valve has.",
                   (Panel(f"S, {unit}", f"J, {unit}", marks=tuple(marks), boxes=tuple(boxes),
                          cells=Cells(m.S, m.J, across, kind.casefold(), error_unit)),))


_Interval = tuple[float, float] | None


def _place(S: float, J: float, unit: str, *, known: bool) -> str:
    """A point of the cost map in words; J is a number only where the study knows it."""
    return f"S {wording.number(S)}, J {wording.number(J)} {unit}" if known else \
        f"S {wording.number(S)} {unit}; its J is unknown"


def _mapped_optimum(study: Study) -> tuple[float, float, _Interval, _Interval] | None:
    """S, J and their intervals in the model that the map shows; effects added later have moved the estimate."""
    k = mapped_step(study)
    if k is not None and k < len(study.steps) - 1:
        found = {p.name: p for p in study.steps[k].parameters if p.effect is None}
        if "S" in found and "J" in found:
            return found["S"].value, found["J"].value, found["S"].interval, found["J"].interval
    e = study.estimate
    return None if e is None else (e.S, e.J, e.S_interval, e.J_interval)


def ladder(study: Study) -> Picture | None:
    """Error after each step, in sample and held out, with the noise floor; None for a single step."""
    if len(study.steps) < 2:
        return None
    names = tuple("base model" if s.added is None else f"+ {wording.name(s.added)}" for s in study.steps)
    at = np.arange(len(names), dtype=float)
    held = [(i, s.error.rmse_holdout) for i, s in enumerate(study.steps) if s.error.rmse_holdout is not None]
    lines = [Line("error", "model", np.array([s.error.best for s in study.steps]), at, "bars")]
    if held:
        lines.append(Line("held out", "position", np.array([h for _, h in held]),
                          np.array([float(i) for i, _ in held]), "points"))
    noise = study.steps[-1].error.noise_sd
    rules = (Rule("x", noise, "noise", "bound"),) if noise else ()
    unit = wording.name(study.data.units.get("process_value") or "units of PV")
    return Picture("ladder", "Error after each added effect",
                   f"The free-run error goes from {wording.number(study.steps[0].error.best)} to "
                   f"{wording.number(study.steps[-1].error.best)} {unit} with "
                   f"{counted(len(names) - 1, 'added effect')}.",
                   "Bars: free-run error; dots: the same on data held out; dashed: measurement noise.",
                   (Panel(f"error, {unit}", "", tuple(lines), rules=rules, names=names),))


def candidates(study: Study) -> Picture | None:
    """Gain of each effect tried over the best noise model; None for a study without these gains."""
    shown = [r for r in ranking.ranked(study) if r.candidate.gain_beyond_noise is not None][:_MOST_CANDIDATES]
    if not shown:
        return None
    gains = [float(r.candidate.gain_beyond_noise or 0.0) for r in shown]
    lines = []
    for answer, role in ((ranking.NAMED, "optimum"), (ranking.KEPT, "model"), (ranking.ALIKE, "position"),
                         (ranking.REJECTED, "rule")):
        at = [i for i, r in enumerate(shown) if r.answer == answer]
        if at:
            lines.append(Line(answer, role, np.array([gains[i] for i in at]), np.array(at, float), "bars"))
    left_out = len(study.candidates) - len(shown)
    more = f" {wording.count(left_out)} more are in the table." if left_out else ""
    best = max(range(len(shown)), key=gains.__getitem__)
    return Picture("candidates", "Effects tried", f"{shown[best].name} gains most, {wording.number(gains[best])} BIC "
                   f"beyond noise; its answer: {shown[best].words}.",
                   "Gain of the best model with each effect over the best one without it, at the dashed line; the "
                   f"table has the reasons of those not taken.{more}",
                   (Panel("gain beyond noise, BIC", "", tuple(lines), rules=(Rule("x", 0.0, "noise", "bound"),),
                          names=tuple(wording.clean(r.name, 30) for r in shown)),))


def _severity_rules(largest: float) -> tuple[Rule, ...]:
    """Rules at the start of each severity band, up to a little above the largest S."""
    return tuple(Rule("x", limit, word, "bound") for (limit, _), (_, word) in pairwise(BANDS)
                 if limit < 1.2 * largest)


def comparison(studies: Sequence[Study]) -> Picture | None:
    """S of several loops with its interval, on one axis."""
    known = [(wording.clean(s.data.name, 30), s.estimate) for s in studies if s.estimate is not None]
    if len(known) < 2:
        return None
    lines, marks = [], []
    for i, (_, e) in enumerate(known):
        marks.append(Mark(e.S, float(i), "S", "optimum"))
        if e.S_interval is not None:
            lines.append(Line("interval of S", "model", np.array(e.S_interval), np.array([float(i)] * 2)))
    worst = max(known, key=lambda pair: pair[1].S)
    return Picture("comparison", "S of all loops", f"{worst[0]} has the largest S, {wording.number(worst[1].S)} "
                   f"{wording.name(worst[1].unit)}.", "Cross: S, line: its interval (where wider than the "
                   "cross); dashed: where each severity band begins.",
                   (Panel("S, % of OP span", "", tuple(lines), marks=tuple(marks),
                          rules=(Rule("x", 0.0), *_severity_rules(max(e.S for _, e in known))),
                          names=tuple(n for n, _ in known)),))
