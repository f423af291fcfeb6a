"""Largest stickband plus deadband that a record does not exclude: what "no stiction" leaves open.

S stands on a ladder up to the swing of the output, with everything else free: slip jump, initial force, process. The
model, with its noise model, is that of the best valve with friction. Where the best model without friction predicts
better, friction is put into that one: a ladder in a structure that the record rejects would exclude anything. A rung is
excluded where its likelihood is below that of the best rung by more than an interval of this level allows. Wrong where
a valve path on a rung is found by none of the starts: the bound is then too small. Source: docs/details.md, section 8.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..fit.intervals.assemble import INTERVAL_THRESHOLD
from ..fit.noise.prewhitening import Whitened, whitened
from ..fit.points.moves import descend_model
from ..model.segments import rebind_model
from ..model.spec import Spec
from ..typing import FloatArray
from .odds import FrictionGain, friction_gain

RUNGS = np.geomspace(0.01, 1.0, 15)
"""Values of S as shares of the output's swing; a valve with more than its swing never moves."""
_JUMPS, _FORCES = (0.0, 0.3, 0.7, 1.0), (-0.9, -0.5, 0.0, 0.5, 0.9)
# Dead times tried, in samples less than that of the model without friction: a resting valve is late by itself.
_EARLIER = (0.0, 1.0, 3.0, 8.0)
# Best starts of a rung that are descended, and turns of the descent.
_DESCENDED, _TURNS = 4, 6


@dataclass(frozen=True, slots=True)
class Possible:
    """Smallest S above which every rung is excluded, None where none is, and the likelihood ratio of the best rung."""

    above: float | None
    gain: FrictionGain


def largest_possible(sticking: Whitened, free: Whitened, swing: float) -> Possible | None:
    """The S that a record leaves possible, in the unit of the output; None where S is given."""
    worse = sticking.innovation_sd > free.innovation_sd
    known, other = (_sticking_in(free), sticking) if worse else (_by_law(sticking), free)
    model = known.model
    if not model.space.movable[0] or swing <= 0.0:
        return None
    tops = []
    for share in RUNGS:
        points = model.cube(_starts(known, other, share * swing))
        tops.append(points[np.argsort(model.costs(points), kind="stable")[:_DESCENDED]])
    found = descend_model(model, np.concatenate(tops), fixed=(0,), turns=_TURNS)
    values = np.concatenate([model.values(found.points), known.values[:, None]], axis=1)
    S, cost = values[0], np.maximum(np.append(found.costs, model.costs(model.cube(known.values[:, None]))), 1e-300)
    loss = model.shared.rows * np.log(cost / cost.min())
    possible = float(S[loss <= INTERVAL_THRESHOLD].max())
    above = RUNGS[RUNGS * swing > possible * (1.0 + 1e-6)]
    best = whitened(model, values[:, int(cost.argmin())])
    return Possible(float(above[0] * swing) if above.size else None, friction_gain(best, free))


def _by_law(sticking: Whitened) -> Whitened:
    """The model with a valve that slips by its law: a path belongs to one S, and a ladder along it says nothing."""
    return _rebound(sticking, replace(sticking.model.spec, paths=None)) if sticking.model.spec.paths else sticking


def _sticking_in(free: Whitened) -> Whitened:
    """The model without friction as one with friction of size 0."""
    return _rebound(free, replace(free.model.spec, friction_free=False))


def _rebound(known: Whitened, spec: Spec) -> Whitened:
    model = rebind_model(known.model, spec)
    return whitened(model, model.vector(known.model.named(known.values)))


def _starts(known: Whitened, beside: Whitened, S: float) -> FloatArray:
    """Points (d, k) with this S: both processes, slip jumps, initial forces and dead times in all combinations."""
    model = known.model
    lows, highs = (np.array([getattr(p, name) for p in model.space.parameters]) for name in ("low", "high"))
    own, other = known.values.copy(), known.values.copy()
    # Time constant and dead time of the other model.
    other[3:5] = beside.values[3:5]
    points = []
    for values, jump, force, earlier in product((own, other), _JUMPS, _FORCES, _EARLIER):
        point = values.copy()
        point[0], point[1], point[4] = S, jump * S, values[4] - earlier * model.step_s
        point[list(model.forces)] = force
        points.append(point)
    found = np.stack(points, axis=1)
    movers = model.space.movable
    clipped = np.clip(found, lows[:, None], highs[:, None])
    clipped[1] = np.clip(found[1], 0.0, highs[1] * clipped[0])
    return np.where(movers[:, None], clipped, own[:, None])
