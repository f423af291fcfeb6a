"""Intervals of the times at which friction changes at once: the cost is constant from one slip to the next.

Slopes know nothing of such a parameter. So it is moved outwards on a ladder, all others held, until the cost excludes
it; the first excluded rung is the end. Wrong where another S or J would make up for another time: this interval is then
too short. Source: likelihood of a change point, Hinkley 1970; docs/method.md, section 8.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...model.model import Model
from ...record.intervals import Span
from ...typing import FloatArray

# Rungs either way, from one command to the whole record.
_RUNGS = 60


def instant_columns(model: Model) -> tuple[int, ...]:
    """Positions in a point of the times at which friction changes at once."""
    return tuple(rows.stop - 1 for effect, rows in zip(model.effects, model.effect_rows, strict=True)
                 if effect.at_once)


def instant_spans(model: Model, values: FloatArray, cost: Callable[[FloatArray], FloatArray],
                  limit: float) -> dict[str, Span]:
    """Earliest and latest possible time of each change, all other values (d,) held.

    `cost` gives that of values (d, P), and `limit` is the largest that is possible.
    """
    names, context = list(model.named(values)), model.context
    away = np.geomspace(context.command_step_s, context.length_s, _RUNGS)
    found = {}
    for at in instant_columns(model):
        trial = values[:, None].repeat(2 * _RUNGS, axis=1)
        p = model.space.parameters[at]
        trial[at] = np.clip(values[at] + np.concatenate([-away, away]), p.low, p.high)
        excluded = (cost(trial) > limit).reshape(2, _RUNGS)
        ends = [int(np.argmax(side)) if side.any() else _RUNGS - 1 for side in excluded]
        found[names[at]] = (float(trial[at, ends[0]]), float(trial[at, _RUNGS + ends[1]]))
    return found
