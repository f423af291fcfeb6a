"""A study's model on another record: what belongs to the plant is held, what belongs to the record is refitted.

S, J, the process and the period of a wave are held. Start state, bias, phase of a wave and time of a step are refitted.
A step or ramp that the other record does not show is left out, and so are effects tied to the first record's clock,
such as drifting stiction; notes say so. Source: `stictionid compare --help`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..effects import parse
from ..errors import DataError
from ..fit.public_values import values_of
from ..model.model import Model
from ..model.restore import rebuild_model
from ..model.segments import bind_model
from ..model.spec import Evaluated, Spec
from ..numerics.noise.likelihood import Likelihood
from ..record.loop import Finding, Loop
from ..typing import FloatArray

# Start forces and times tried, and number of refinements of each ladder.
_FORCES, _TIMES, _TURNS = 41, 161, 3
# Parameters' worth of BIC by which an event of the first record must lower the cost to count as in the second, too.
_SHOWN = 3
# Share by which a size of the plant may differ from record to record.
_OTHER = 0.2


def rebuilt(loop: Loop, description: dict[str, Any]) -> tuple[Model, Evaluated]:
    """The study's model on its own record."""
    model, values = rebuild_model(loop, description)
    return model, model.evaluate(values)


def transferred(loop: Loop, description: dict[str, Any],
                own: Loop | None) -> tuple[Model, Evaluated, tuple[Finding, ...]]:
    """The study's model on another record (`own` is the first one, for the gain); DataError where a tag is missing."""
    notes: list[Finding] = []
    kept, dropped, own_time = [], [], []
    for name in description["effects"]:
        effect, tag = parse(name)
        if "extra" in effect.needs and tag not in loop.extras:
            raise DataError(f"the model needs the tag {tag}, which the second file does not give",
                            "give a file that has it")
        clocked = (effect.kind == "L" and not effect.needs) or effect.profile is not None
        if clocked and not effect.of_record:
            dropped.append(name)
        elif set(effect.of_record) & {p.name for p in effect.parameters if effect.searched and p.name in
                                      effect.searched}:
            own_time.append(name)
        else:
            kept.append(name)
    fixed = dict(description["fixed"])
    refitted = ["start state", "bias"]
    follows = any(parse(name)[0].follows_y for name in kept)
    if own is not None and not follows:
        model, evaluated = rebuilt(own, description)
        fixed["gain"] = evaluated.gain
    else:
        refitted.append("gain")
    refitted += [f"{parameter} of {name}" for name in kept for parameter in parse(name)[0].of_record]
    model, values = _started(loop, description, kept, fixed)
    for name in own_time:
        # Kept where the other record shows such an event, too.
        names = [n for n in description["effects"] if n == name or n in model.spec.effects]
        tried, trial = _started(loop, description, names, fixed, model.evaluate(values).left)
        _timed(tried, trial, name)
        _force(tried, trial)
        before, after = (float(m.costs_of(v[:, None])[0]) for m, v in ((model, values), (tried, trial)))
        rows = float(model.good().sum())
        if Likelihood(before, rows).deviance > Likelihood(after, rows).bic(_SHOWN):
            model, values = tried, trial
            refitted += [f"{parameter} of {name}" for parameter in parse(name)[0].of_record]
        else:
            dropped.append(name)
    if dropped:
        notes.append(Finding("left-out", "info", f"{', '.join(dropped)}: tied to the first record's clock, and not in "
                             "this one", {"effects": dropped}))
    if not np.isfinite(model.costs_of(values[:, None])[0]):
        raise DataError("the study's valve never moves under the second file's command",
                        "give a record in which the loop cycles at least as far")
    notes.append(Finding("validated", "info", f"S, J and process held at the study's values; refitted on this file: "
                         f"{', '.join(refitted)}", {"refitted": refitted}))
    evaluated = model.evaluate(values)
    if own is not None:
        notes += _other_sizes(own, description, model, values, evaluated)
    return model, evaluated, tuple(notes)


def _other_sizes(own: Loop, description: dict[str, Any], model: Model, values: FloatArray,
                 evaluated: Evaluated) -> list[Finding]:
    """Warnings on sizes that belong to the plant, such as the amplitude of a wave, and are others on this record.

    Sizes are linear: the least squares find them anew on every record.
    """
    first, known = rebuild_model(own, description)
    there = first.evaluate(known)
    found = []
    for name in model.spec.effects:
        effect, _ = parse(name)
        if not effect.of_record:
            continue
        a, b = values_of(name, first, known, there), values_of(name, model, values, evaluated)
        for p in effect.parameters:
            if p.name not in effect.of_record and abs(b[p.name] - a[p.name]) > _OTHER * abs(a[p.name]):
                found.append(Finding("other-size", "warning", f"{p.name} of {name} is {b[p.name]:.4g} on this record, "
                                     f"{a[p.name]:.4g} in the study", {"here": b[p.name], "study": a[p.name]}))
    return found


def _started(loop: Loop, description: dict[str, Any], effects: Sequence[str], fixed: dict[str, float],
             residual: FloatArray | None = None) -> tuple[Model, FloatArray]:
    """The described model with some of its effects on another record, its start forces refitted."""
    spec = Spec(description["law"], description["process"], tuple(effects), description["between"],
                int(description["substeps"]), bool(description["increments"]), tuple(description["taps"]), fixed,
                bool(description.get("friction_free", False)), tuple(description.get("guides", ())))
    model = bind_model(loop, spec, s_max=description["s_max"], period_s=description["period_s"], residual=residual)
    values = model.vector(description["values"])
    _force(model, values)
    return model, values


def _force(model: Model, values: FloatArray) -> None:
    """Refit the start forces in `values` (d,), in place."""
    for row in model.forces:
        _ladder(model, values, row, np.linspace(-1.0, 1.0, _FORCES), (-1.0, 1.0))


def _timed(model: Model, values: FloatArray, name: str) -> None:
    """Refit the searched parameters of an effect that belong to the record, in `values` (d,) and in place."""
    effect = parse(name)[0]
    for row, p in enumerate(effect.parameters_for(model.context), model.rows_of(name).start):
        if p.name in effect.of_record:
            _ladder(model, values, row, np.linspace(p.low, p.high, _TIMES), (p.low, p.high))


def _ladder(model: Model, values: FloatArray, row: int, rungs: FloatArray, limits: tuple[float, float]) -> None:
    """Set one of `values` (d,) to the best of some rungs, then of finer ones about it."""
    for _ in range(_TURNS):
        trial = values[:, None].repeat(rungs.size, axis=1)
        trial[row] = rungs
        at = int(np.argmin(model.costs_of(trial)))
        values[row], width = rungs[at], rungs[1] - rungs[0]
        rungs = np.linspace(max(limits[0], rungs[at] - width), min(limits[1], rungs[at] + width), _FORCES)
