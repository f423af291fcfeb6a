"""Picture of the parts of y: curves of valve, effects and noise over the last periods, each with its share."""

from __future__ import annotations

import numpy as np

from ...model.parts import join_parts, parts_of
from ...model.restore import described_segments, rebuild_model
from ...record.loop import Loop
from ...record.study import Step, Study
from ...record.swing import Share
from .. import effect_words, story, wording
from . import study_pictures
from .picture import Line, Panel, Picture

# Roles of the curves of effects, taken in turn.
_ROLES = ("position", "op", "bound", "optimum", "last")
# A part that moves less than this share of PV's range is a flat line, which the table names.
_SEEN = 0.02
_FIXED = {Share.VALVE: "model", Share.START: "sp", Share.NOISE: "residual"}


def contributions(study: Study, step: Step, loop: Loop) -> Picture:
    """Parts of y in the model of one step: curves about their mean, named with their shares."""
    piece, rows = described_segments(loop, step.model)
    model, values = rebuild_model(piece, step.model)
    parts = join_parts(parts_of(model, values))
    at = np.concatenate([np.arange(r.start, r.stop) for r in rows])
    window = study_pictures.window(study, loop)
    shown = (at >= window.start) & (at < window.stop) if ((at >= window.start) & (at < window.stop)).any() \
        else np.ones(at.size, bool)
    per, unit = study_pictures.time_unit(float(shown.sum()) * loop.step_s)
    t = loop.time_s[at][shown] / per
    apart = {effect_words.plain(name) for p in parts for name in p.name.split("+")}
    inside = [wording.name(name) for name in step.effects if name not in apart]
    names = {p.name: effect_words.fitted_part(study, p.name, inside) for p in parts}
    shares = dict(zip(names, story.shares([Share(p.name, p.share) for p in parts]), strict=True))
    lines = [_line("PV", "pv", t, loop.process_value[at][shown])]
    # Before the first sample that counts the parts may be far larger than PV and cancel.
    counted = ~model.starting()[shown]
    free = iter(_ROLES * len(parts))
    least = _SEEN * np.ptp(lines[0].y)
    seen = [p for p in parts if not counted.any() or np.ptp(p.curve[shown][counted]) > least]
    lines += [_line(f"{names[p.name]}, {shares[p.name]}", _FIXED.get(p.name.partition("+")[0]) or next(free), t,
                    np.where(counted, p.curve[shown], np.nan)) for p in seen]
    said = wording.listed([f"{shares[p.name]} {names[p.name]}" for p in parts])
    return Picture("contributions", "Parts of PV", f"The variance of PV: {said}.",
                   "Each part of PV about its mean, with its share of the variance of PV, cov(part, PV) / var(PV). The "
                   "shares add up to 100 %. They do not say what causes a cycle: in a closed loop parts go together.",
                   (Panel(f"time, {unit}", study_pictures.axis_label("PV about its mean", loop, "process_value"),
                          tuple(lines)),), wide=True)


def _line(name: str, role: str, t: np.ndarray, values: np.ndarray) -> Line:
    good = np.isfinite(values)
    return study_pictures.thin_line(name, role, t, values - (values[good].mean() if good.any() else 0.0))
