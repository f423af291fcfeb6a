"""Parts of y in a fitted model: the valve through the process, each linear effect, start and level, and the rest.

The parts add up to y. Effects on friction, stem or trim act inside the part of the valve, which names them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..record.swing import Share
from ..typing import FloatArray
from .model import Model

# Share of a part that opposes the others, from which it is joined to the largest one. Unit: 1.
_OPPOSES = 0.01


@dataclass(frozen=True, slots=True)
class Part:
    """One part of y (n,): its name (see Share), its curve, and its share cov(part, y) / var(y) of the variance of y."""

    name: str
    curve: FloatArray
    share: float


def parts_of(model: Model, values: FloatArray) -> tuple[Part, ...]:
    """Parts of y of the model with values (d,), the valve first, the noise last; their shares add up to 1.

    Shares count the samples of the free-run error. A share may be negative, or exceed 1, where parts oppose each other.
    """
    done = model.evaluate(values)
    own = model.follow_guide(done.guide) if model.follows_y else model
    columns = own.own_columns(*own.responses(values[:, None], filtered=False))[:, :, 0]
    curves = {Share.VALVE: done.own[0] * columns[0]}
    for name, at in own.sizes_at(values):
        if at.stop > at.start:
            curves[name] = np.asarray(done.own[at] @ columns[at])
    curves[Share.START] = done.model - sum(curves.values())
    curves[Share.NOISE] = done.residual
    good = done.counted > 0
    y = (done.model + done.residual)[good]
    centred = y - y.mean()
    power = float(centred @ centred)
    return tuple(Part(name, curve, float(curve[good] @ centred) / power if power else 0.0)
                 for name, curve in curves.items())


def join_parts(parts: tuple[Part, ...]) -> tuple[Part, ...]:
    """The parts, those that cancel as one: a part that opposes the others joined to the largest, names linked by "+".

    A start that takes away most of what the valve adds says nothing of either.
    """
    against = [p for p in parts if p.share <= -_OPPOSES]
    if not against:
        return parts
    both = [max(parts, key=lambda p: p.share), *against]
    names = [p.name for p in both]
    one = Part("+".join(names), np.sum([p.curve for p in both], axis=0), sum(p.share for p in both))
    return (one, *(p for p in parts if p.name not in names))
