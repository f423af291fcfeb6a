"""Largest stickband plus deadband that a record does not exclude: what "no stiction" leaves open.

S stands on a ladder up to the swing of the output, with everything else free: slip jump, initial force, process. The
model, with its noise model, is that of the best valve with friction. A rung is excluded where its likelihood is below
that of the best rung by more than an interval of this level allows. Wrong where a valve path on a rung is found by
none of the starts: the bound is then too small. Source: METHODS.md section 4 (profiles); CRITICISM.md section 5.
"""

from __future__ import annotations

import numpy as np

from ..fit.intervals.assemble import INTERVAL_THRESHOLD
from ..fit.moves import descended, movable
from ..fit.noise.prewhitening import Whitened
from ..typing import FloatArray

RUNGS = np.geomspace(0.01, 1.0, 15)
"""Values of S as shares of the output's swing; a valve with more than its swing never moves."""
_JUMPS, _FORCES = (0.0, 0.3, 0.7, 1.0), (-0.9, -0.5, 0.0, 0.5, 0.9)
# Dead times tried, in samples less than that of the model without friction: a valve that rests comes late by itself.
_EARLIER = (0.0, 1.0, 3.0, 8.0)
# Best starts of a rung that are descended, and turns of the descent.
_DESCENDED, _TURNS = 4, 6


def largest_possible(sticking: Whitened, free: Whitened, swing: float) -> float | None:
    """Smallest S above which every rung is excluded, in the unit of the output; None where S is given, or none is."""
    model = sticking.model
    if not movable(model)[0] or swing <= 0.0:
        return None
    tops = []
    for share in RUNGS:
        points = model.cube(_starts(sticking, free, share * swing))
        tops.append(points[np.argsort(model.costs(points), kind="stable")[:_DESCENDED]])
    found = descended(model, np.concatenate(tops), held=(0,), turns=_TURNS)
    S = np.append(model.values(found.points)[0], sticking.values[0])
    cost = np.append(found.costs, model.costs(model.cube(sticking.values[:, None])))
    loss = model.shared.rows * np.log(np.maximum(cost, 1e-300) / cost.min())
    possible = float(S[loss <= INTERVAL_THRESHOLD].max())
    above = RUNGS[RUNGS * swing > possible * (1.0 + 1e-6)]
    return float(above[0] * swing) if above.size else None


def _starts(sticking: Whitened, free: Whitened, S: float) -> FloatArray:
    """Points (d, k) with this S: both processes, slip jumps, initial forces and dead times in all combinations."""
    model = sticking.model
    lows, highs = (np.array([getattr(p, name) for p in model.space.parameters]) for name in ("low", "high"))
    known = sticking.values.copy()
    other = known.copy()
    other[3:5] = free.values[3:5]  # time constant and dead time of the model without friction
    points = []
    for values in (known, other):
        for jump in _JUMPS:
            for force in _FORCES:
                for earlier in _EARLIER:
                    point = values.copy()
                    point[0], point[1], point[4] = S, jump * S, values[4] - earlier * model.step_s
                    point[list(model.forces)] = force
                    points.append(point)
    found = np.stack(points, axis=1)
    movers = movable(model) > 0
    clipped = np.clip(found, lows[:, None], highs[:, None])
    clipped[1] = np.clip(found[1], 0.0, highs[1] * clipped[0])
    return np.where(movers[:, None], clipped, known[:, None])
