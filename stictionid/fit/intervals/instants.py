"""Intervals of the times at which friction changes at once: the cost is constant from one slip to the next.

Slopes know nothing of such a parameter. So it is moved outwards on a ladder, and the others follow, until the cost
excludes it; the first excluded rung is the end. Under a held command S and the start stay: their cost has steps, too.
Wrong where another S would make up for another time: this interval is then too short. Source: likelihood of a change
point, Hinkley 1970; docs/details.md, section 8.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...model.model import Model
from ...record.intervals import Span
from ...typing import FloatArray
from ..points.moves import descend_model

# Rungs either way, from one sample to the whole record: PV shows nothing between its samples.
_RUNGS = 60
# Turns of the descent of the others at each rung, and the fall of the cost at which it ends.
_TURNS, _STILL = 3, 1e-3


def instant_columns(model: Model) -> tuple[int, ...]:
    """Positions in a point of the times at which friction changes at once."""
    return tuple(rows.stop - 1 for effect, rows in zip(model.effects, model.effect_rows, strict=True)
                 if effect.at_once)


def instant_spans(model: Model, values: FloatArray, cost: Callable[[FloatArray], FloatArray],
                  limit: float) -> dict[str, Span]:
    """Earliest and latest possible time of each change in a model at values (d,).

    `cost` gives that of values (d, P), and `limit` is the largest that is possible.
    """
    names, context = list(model.named(values)), model.context
    away = np.geomspace(context.step_s, context.length_s, _RUNGS)
    break_away = (0, *model.forces) if model.spec.held else ()
    found = {}
    for at in instant_columns(model):
        trial = values[:, None].repeat(2 * _RUNGS, axis=1)
        p = model.space.parameters[at]
        trial[at] = np.clip(values[at] + np.concatenate([-away, away]), p.low, p.high)
        near = descend_model(model, model.cube(trial), fixed=(at, *break_away), turns=_TURNS, settle=_STILL)
        trial = model.values(near.points)
        excluded = trial[at][cost(trial) > limit]
        found[names[at]] = (float(excluded[excluded < values[at]].max(initial=p.low)),
                            float(excluded[excluded > values[at]].min(initial=p.high)))
    return found
