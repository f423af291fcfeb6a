"""Basins of a valve together with its process: valves of a short part, polished with their process on longer parts.

The search that assumes no process (continuation.py) ranks a valve by what slips alone explain. In a steady cycle that
is little: a valve that hardly sticks, behind any lags, follows the cycle nearly as well. With its process the right
valve is far better than those on all but the shortest parts. A disturbance misleads this search, but not the other one,
so each finds valves that the other misses (benchmarks/valve_starts.py).
Source: METHODS.md section 4, traps 1 and 3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...model.model import Model
from ...numerics.population import refine
from ...typing import FloatArray
from ..moves import beginning, lifted, longest_piece, neutral_point, spreads
from .basins import with_process
from .continuation import LEAST_S, first_valves, happened, of_all_bands, open_bank, open_costs

# Periods in the first part, the factor from one part to the next, and the points that the first and last part leave.
_PERIODS, _GROWTH, _LEFT = 4.0, 1.7, (40, 8)
# Rounds and size of the populations that polish them, the fall of the cost at which one has settled, the distance of
# points that are kept, and the share of the record from which the first standard deviations are half as wide.
_ROUNDS, _POPULATION, _SETTLED, _APART, _SHORT = 12, 14, 1e-3, 0.004, 0.3


def grown_models(model: Model, columns: Sequence[int], rng: np.random.Generator,
                 known: FloatArray | None = None) -> FloatArray:
    """Points (k, d) of the unit cube, best first, with a valve found in `columns` and a process that fits it.

    The first part is searched in those columns; the others are as in `known` values (d,), or neutral. Of several
    segments the longest is searched. Wrong where a disturbance is larger than what the slips move.
    """
    at = longest_piece(model)
    whole = model.pieces[at]
    shift = model.head - whole.head
    own = [2 if c == model.forces[at] else c - (shift if c >= model.head else 0) for c in columns]
    middle = neutral_point(whole) if known is None else whole.cube(model.of(at, known[:, None]))[0]
    first = min((whole.skip + _PERIODS * whole.period_s / whole.step_s) / whole.loop.samples, 1.0)
    count = max(int(np.ceil(-np.log(first) / np.log(_GROWTH))), 1) + 1
    points = np.empty((0, whole.space.size))
    for share, kept in zip(np.geomspace(first, 1.0, count), np.geomspace(*_LEFT, count).astype(int), strict=True):
        part = beginning(whole, happened(whole, share))
        if not len(points):
            points = with_process(part, _valves(part, own, middle, 2 * kept, rng))
            points = points[of_all_bands(points, kept, _APART)]
        found = refine(part.costs, points, rng, spread=spreads(part, 1.0 if share <= _SHORT else 0.5), rounds=_ROUNDS,
                       population=_POPULATION, settle=_SETTLED)
        points = found.points[of_all_bands(found.points, kept, _APART)]
    return points if len(model.pieces) == 1 else lifted(model, at, points)


def _valves(part: Model, own: Sequence[int], middle: FloatArray, kept: int, rng: np.random.Generator) -> FloatArray:
    """The best distinct points (kept, d) of an even scan of the valve with the process left open."""
    bank = open_bank(part)

    def whole(points: FloatArray) -> FloatArray:
        out = middle[None].repeat(len(points), axis=0)
        out[:, own] = points
        return out

    def cost(points: FloatArray) -> FloatArray:
        values = part.values(whole(points))
        return np.where(values[0] >= LEAST_S * part.s_max, open_costs(part, bank, values), np.inf)

    return whole(first_valves(cost, len(own), kept, rng))
