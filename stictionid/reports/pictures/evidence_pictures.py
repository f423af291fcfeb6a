"""Evidence for each named effect: the residual before and after it, over the axis that its own file names.

The film shows the same window of PV and free run for every step, so that the fall of the error is seen.
"""

from __future__ import annotations

import numpy as np

from ...errors import StictionidError
from ...model.restore import rerun
from ...model.spec import Curves
from ...record.loop import Loop
from ...record.study import Step, Study
from ...typing import FloatArray
from .. import effect_words, wording
from . import measures, study_pictures
from .curves import Case
from .picture import Line, Panel, Picture

# Most points of a residual, and bins of its mean. Unit: points, bins.
_DOTS, _BINS = 500, 24
# Fewest points of a bin whose mean is shown.
_FEWEST = 5
# Bins of a thinned spectrum.
_LINES = 300
# Most steps of a film; of more the first and the last ones are shown.
_MOST_STEPS = 6


def evidence(case: Case) -> list[Picture]:
    """One picture for each effect of the base, "evidence-0-" and its place, and of each step, "evidence-" and the step.

    Nothing stands before the base: its effects are shown beside the same model without them.
    """
    study, loop = case.study, case.loop
    if loop is None or len(case.curves) != len(study.steps):
        return []
    found = []
    for i, step in enumerate(study.steps):
        if i and step.added:
            found.append(_evidence(study, loop, str(i), effect_words.named_in(step), case.curves[i - 1],
                                   case.curves[i]))
        elif not i:
            for k, name in enumerate(step.effects):
                if (without := _without(loop, step, name)) is not None:
                    found.append(_evidence(study, loop, f"0-{k}", name, without, case.curves[0]))
    return found


def _without(loop: Loop, step: Step, name: str) -> Curves | None:
    """Curves of a model without one effect and with its other numbers; None where it does not run so.

    Gain and offset are fitted again, as in every run.
    """
    model = step.model or {}
    rest = [n for n in model.get("effects", ()) if n != name]
    if len(rest) == len(model.get("effects", ())):
        return None
    values = {k: v for k, v in model["values"].items() if not k.startswith(f"{name}:")}
    try:
        return rerun(loop, {**model, "effects": rest, "values": values})
    except StictionidError:
        return None


def _evidence(study: Study, loop: Loop, key: str, name: str, before: Curves, after: Curves) -> Picture:
    effect, _ = effect_words.known(name)
    over = effect.seen_over if effect is not None else "time"
    good = np.isfinite(before.residual) & np.isfinite(after.residual) & loop.used
    unit = study_pictures.axis_label("residual", loop, "process_value")
    title = f"Residual without and with {effect_words.noun(study, name)}"
    if key.startswith("0"):
        errors = _spread(before, good), _spread(after, good)
        held = "Without it, the other numbers kept, the model errs by"
        change = f"{held} {wording.number(errors[0])}, with it by {wording.number(errors[1])} where both are known."
    else:
        first, last = (study.steps[int(key) - k].error.best for k in (1, 0))
        change = (f"The free-run error {'falls' if last < first else 'rises'} from {wording.number(first)} to "
                  f"{wording.number(last)}.")
    if over == "spectrum":
        lines = [_spectrum(loop, "without", "rule", before, good), _spectrum(loop, "with", "optimum", after, good)]
        panel = Panel("period, s", "log10 of power", tuple(lines), log_x=True)
        said = "Power of the residual over the period"
    else:
        x, label, said = _axis(over, study, loop, name, after)
        good &= np.isfinite(x)
        panel = Panel(label, unit, (_dots("without", "rule", x, before, good), _dots("with", "optimum", x, after, good),
                                    _mean("mean without", "guide", x, before, good)))
    return Picture(f"evidence-{key}", title, change,
                   f"{said}; grey without the effect, coloured with it. {change}", (panel,))


def _spread(curves: Curves, good: np.ndarray) -> float:
    return float(np.sqrt(np.mean(curves.residual[good] ** 2))) if good.any() else float("nan")


def _axis(over: str, study: Study, loop: Loop, name: str, after: Curves) -> tuple[FloatArray, str, str]:
    """The x (n,) over which an effect is seen, its label, and the picture in words."""
    if over == "time":
        per, unit = study_pictures.time_unit(loop.samples * loop.step_s)
        return loop.time_s / per, f"time, {unit}", "Residual over time"
    if over == "y":
        return after.model, study_pictures.axis_label("PV of the model", loop, "process_value"), "Residual over PV"
    if over == "travel":
        label = study_pictures.axis_label("valve position", loop, "output", "%")
        return (_as_seen(study, loop, after.position), label,
                "Residual over the valve's position, as late as PV shows it")
    if over == "phase":
        own = next((p.value for p in effect_words.parameters(study, name) if "period" in p.name), None)
        period = own or study.range.period_median_s or loop.samples * loop.step_s
        return (np.asarray(loop.time_s / period % 1.0), "part of the cycle",
                f"Residual over the cycle of {wording.duration(period)}")
    return (_as_seen(study, loop, _since_turn(loop, after)), "s after a turn: closing < 0 < opening",
            "Residual after each turn of the valve, as late as PV shows it")


def _since_turn(loop: Loop, after: Curves) -> FloatArray:
    """Seconds (n,) since the valve turned, below 0 where it closes."""
    v = np.nan_to_num(after.position)
    move = np.diff(v, prepend=v[0])
    rest = 1e-6 * max(float(np.ptp(v)), 1e-12)
    sign = np.where(np.abs(move) > rest, np.sign(move), 0.0)
    at = np.maximum.accumulate(np.where(sign != 0, np.arange(v.size), 0))
    last = sign[at]
    turned = np.maximum.accumulate(np.where(np.diff(last, prepend=last[0]) != 0, np.arange(v.size), 0))
    return np.where(last == 0, np.nan, last * (np.arange(v.size) - turned) * loop.step_s)


def _as_seen(study: Study, loop: Loop, values: FloatArray) -> FloatArray:
    """Values of the valve (n,) one dead time later."""
    late = round((study.estimate.dead_time_s if study.estimate else 0.0) / loop.step_s)
    if not 0 < late < values.size:
        return values
    return np.concatenate([np.full(late, np.nan), values[:-late]])


def _dots(name: str, role: str, x: FloatArray, curves: Curves, good: np.ndarray) -> Line:
    at = np.flatnonzero(good)
    at = at[::max(1, -(-at.size // _DOTS))]
    return Line(name, role, x[at], curves.residual[at], "dots")


def _mean(name: str, role: str, x: FloatArray, curves: Curves, good: np.ndarray) -> Line:
    """Mean residual in bins of equal counts; all samples at one place, such as a stop, share a bin."""
    xs, rs = x[good], curves.residual[good]
    edges = np.unique(np.quantile(xs, np.linspace(0.0, 1.0, _BINS + 1))) if xs.size else xs
    which = np.searchsorted(edges, xs, side="right")
    parts = [p for p in (np.flatnonzero(which == k) for k in np.unique(which)) if p.size >= _FEWEST]
    return Line(name, role, np.array([xs[p].mean() for p in parts]), np.array([rs[p].mean() for p in parts]))


def _spectrum(loop: Loop, name: str, role: str, curves: Curves, good: np.ndarray) -> Line:
    run = measures.longest_run(good)
    residual = curves.residual[run]
    period, power = measures.spectrum(residual, loop.step_s)
    decades = np.log10(np.maximum(power * float(residual.var()), 1e-300))
    return Line(name, role, *measures.thin(period[::-1], decades[::-1], _LINES))


def film(case: Case) -> Picture | None:
    """PV and the free run of every step over one window, one above the other; None for a single step."""
    study, loop = case.study, case.loop
    if loop is None or len(study.steps) < 2 or len(case.curves) != len(study.steps):
        return None
    numbers = list(range(len(study.steps)))
    if len(numbers) > _MOST_STEPS:
        numbers = [0, *numbers[-(_MOST_STEPS - 1):]]
    part = study_pictures.window(study, loop)
    per, unit = study_pictures.time_unit((part.stop - part.start) * loop.step_s)
    t = loop.time_s[part] / per
    pv = measures.joined(loop, loop.process_value)[part]
    panels, said = [], []
    for i in numbers:
        words = _frame(study.steps[i])
        said.append(words)
        lines = (study_pictures.thin_line("PV", "pv", t, pv),
                 study_pictures.thin_line(words, "model", t, case.curves[i].model[part]))
        panels.append(Panel(f"time, {unit}" if i == numbers[-1] else "",
                            study_pictures.axis_label("PV", loop, "process_value"), lines, height=0.62))
    return Picture("film", "Each step over the same window", f"{'; then '.join(said)}.",
                   "Measured PV and the free run of each model, which never sees PV: the closer the two curves, the "
                   "smaller the error.", tuple(panels), wide=True)


def _frame(step: Step) -> str:
    """A step in a few words: its error, S and J, and last what it added, which a phone may cut."""
    of = {p.name: p for p in step.parameters if p.effect is None}
    known = [f"{name} {wording.with_unit(of[name].value, of[name].unit)}" for name in ("S", "J") if name in of]
    name = "base model" if step.added is None else f"+ {wording.clean(step.added, 30)}"
    return f"{', '.join([f'error {wording.number(step.error.best)}', *known])}: {name}"
