"""A study's model on another record: S, J and the process held, start state and bias refitted.

Effects tied to the first record's clock (steps, ramps, sine waves, drifting stiction) say nothing about another record.
They are left out, with a note. Source: CLI.md, compare STUDY FILE.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..effects import parse
from ..errors import DataError
from ..model.model import Model
from ..model.restore import rebuild_model
from ..model.segments import bound
from ..model.spec import Evaluated, Spec
from ..record.loop import Finding, Loop

# Start forces tried, and number of refinements of the ladder.
_FORCES, _TURNS = 41, 3


def rebuilt(loop: Loop, description: dict[str, Any]) -> tuple[Model, Evaluated]:
    """The study's model on its own record."""
    model, values = rebuild_model(loop, description)
    return model, model.evaluate(values)


def transferred(loop: Loop, description: dict[str, Any],
                own: Loop | None) -> tuple[Model, Evaluated, tuple[Finding, ...]]:
    """The study's model on another record (`own` is the first one, for the gain); DataError where a tag is missing."""
    notes: list[Finding] = []
    kept: list[str] = []
    dropped: list[str] = []
    for name in description["effects"]:
        effect, tag = parse(name)
        if "extra" in effect.needs and tag not in loop.extras:
            raise DataError(f"the model needs the tag {tag}, which the second file does not give",
                            "give a file that has it")
        timed = (effect.kind == "L" and not effect.needs) or effect.profile is not None
        (dropped if timed else kept).append(name)
    if dropped:
        notes.append(Finding("left-out", "info",
                             f"{', '.join(dropped)}: tied to the first record's clock, left out here",
                             {"effects": dropped}))
    fixed = dict(description["fixed"])
    refitted = ["start state", "bias"]
    follows = any(parse(name)[0].follows_y for name in kept)
    if own is not None and not follows:
        model, evaluated = rebuilt(own, description)
        fixed["gain"] = evaluated.gain
    else:
        refitted.append("gain")
    spec = Spec(description["law"], description["process"], tuple(kept), description["between"],
                int(description["substeps"]), bool(description["increments"]), tuple(description["taps"]), fixed,
                bool(description.get("friction_free", False)), tuple(description.get("guides", ())))
    model = bound(loop, spec, s_max=description["s_max"], period_s=description["period_s"])
    values = model.vector(description["values"])
    for row in model.forces:
        low, high = -1.0, 1.0
        for _ in range(_TURNS):
            forces = np.linspace(low, high, _FORCES)
            trial = values[:, None].repeat(_FORCES, axis=1)
            trial[row] = forces
            costs = model.costs_of(trial)
            at = int(np.argmin(costs))
            values[row] = forces[at]
            width = (high - low) / (_FORCES - 1)
            low, high = max(-1.0, forces[at] - width), min(1.0, forces[at] + width)
    if not np.isfinite(costs[at]):
        raise DataError("the study's valve never moves under the second file's command",
                        "give a record in which the loop cycles at least as far")
    notes.append(Finding("validated", "info", f"S, J and process held at the study's values; refitted on this file: "
                         f"{', '.join(refitted)}", {"refitted": refitted}))
    return model, model.evaluate(values), tuple(notes)
