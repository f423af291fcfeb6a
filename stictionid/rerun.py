"""A described model on its record again: one run, no search."""

from __future__ import annotations

from typing import Any

import numpy as np

from .errors import ModelError
from .loop import FloatArray, Loop
from .model import Model
from .restarts import bound
from .segments import described
from .spec import Curves, Spec


def rebuild_model(loop: Loop, description: dict[str, Any]) -> tuple[Model, FloatArray]:
    """The model and values (d,) that `describe` wrote down; ModelError where something is missing."""
    try:
        spec = Spec(description["law"], description["process"], tuple(description["effects"]),
                    description["between"], int(description["substeps"]), bool(description["increments"]),
                    tuple(description["taps"]), dict(description["fixed"]),
                    bool(description.get("friction_free", False)), tuple(description.get("guides", ())))
        model = bound(loop, spec, s_max=description["s_max"], period_s=description["period_s"])
        return model, model.vector(description["values"])
    except (KeyError, TypeError) as error:
        raise ModelError(f"the study's model can't be rebuilt: {error}", "run stictionid identify again") from None


def rerun(loop: Loop, description: dict[str, Any]) -> Curves:
    """Run a described model over its record once, without any search.

    NaN in segments that the model was not fitted to, and before the first sample that counts in each of the others.
    """
    piece, rows = described(loop, description)
    model, values = rebuild_model(piece, description)
    e = model.evaluate(values)
    start = model.starting()

    def shown(curve: FloatArray, *, hide: bool = True) -> FloatArray:
        curve = np.where(start, np.nan, curve) if hide else curve
        if piece.samples == loop.samples:
            return curve
        whole = np.full(loop.samples, np.nan)
        whole[np.concatenate([np.arange(p.start, p.stop) for p in rows])] = curve
        return whole

    return Curves(loop.time_s, loop.setpoint, loop.output, loop.process_value, shown(e.model), shown(e.residual),
                  shown(e.position, hide=False), shown(e.innovation), loop.position)
