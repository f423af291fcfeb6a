"""Profile of the slip jump over its whole range, everything else searched anew at every value.

The likelihood of J may have a ridge, on which J times the gain is constant, and valleys apart. A search outwards from
the optimum ends at the first slip that moves by a sample. So every J of a grid gets the valves that slip at the same
samples (starts/same_slips.py), with other dead times, too. Those that come near are polished with J fixed, in the start
force and S as well. The ends of what is possible are then divided further.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...model.model import Model
from ...typing import BoolArray, FloatArray
from ..points.moves import descend_model, first_force
from ..starts.same_slips import with_same_slips
from .profile import Mover

# Slip jumps tried, from this share of S up to the limit of the range, and the samples by which all slips may come
# earlier.
_GRID, _LEAST, _SHIFTS = 36, 0.02, range(-4, 5)
# Starts polished at every J, and the multiple of the least cost up to which one is.
_STARTS, _FAR = 2, 4.0
# Twice the log-likelihood that a J may lose for a grid of its S and start force, shares of S in it, and start forces.
_NEAR, _BANDS, _FORCES = 60.0, np.linspace(-0.006, 0.006, 49), np.linspace(0.01, 0.99, 33)
# Values between a possible and an excluded J, and rounds of them.
_BETWEEN, _ROUNDS = 6, 2
_TURNS, _SETTLED = 8, 1e-4


@dataclass(frozen=True, slots=True)
class Jumps:
    """Slip jumps (m,) in % that were tried, ascending, the best point (m, d) found at each, and its cost (m,)."""

    J: FloatArray
    points: FloatArray
    costs: FloatArray

    def merge_best(self, other: Jumps) -> Jumps:
        """Both profiles in one, at every slip jump the better point."""
        J = np.concatenate([self.J, other.J])
        order = np.lexsort((np.concatenate([self.costs, other.costs]), J))
        order = order[np.unique(J[order], return_index=True)[1]]
        return Jumps(J[order], np.concatenate([self.points, other.points])[order],
                     np.concatenate([self.costs, other.costs])[order])


def over_jumps(model: Model, point: FloatArray, ratio: float) -> Jumps | None:
    """The profile beside a point (d,); a J is possible within a ratio to the least cost. None where J can't be moved.
    """
    best = float(model.costs(point[None])[0])
    if not model.spec.held or model.law.one_parameter or not model.space.movable[:2].all() \
            or not 0.0 < best < np.inf:
        return None
    values = model.values(point[None])[:, 0]
    top = model.space.parameters[1].high
    goals = np.unique(np.append(values[0] * np.geomspace(_LEAST, top, _GRID), values[1]))
    # Valves with the same slips for every slip jump, and with all other numbers as they are.
    path = model.positions(values[:, None])[:, 0]
    alike = [with_same_slips(model, values, path, rests=rests, shifts=_SHIFTS, jumps=goals) for rests in (True, False)]
    starts = np.concatenate([*alike, _move_jumps(model, values[:, None], goals)], axis=1)
    found = _polish_goals(model, goals, starts, best)
    found = found.merge_best(Jumps(values[1:2], point[None], np.array([best])))
    for _ in range(_ROUNDS):
        least = float(found.costs.min())
        inside = found.costs <= ratio * least
        ends = np.flatnonzero(inside[1:] != inside[:-1])
        if not ends.size:
            break
        low, high = found.J[ends], found.J[ends + 1]
        # (from no slip jump on the steps are even)
        between = np.where(low > 0.0, np.geomspace(np.where(low > 0.0, low, high), high, _BETWEEN + 2),
                           np.linspace(low, high, _BETWEEN + 2))
        goals = np.unique(between[1:-1])
        near = model.values(found.points[np.unique([ends, ends + 1])])
        found = found.merge_best(_polish_goals(model, goals, _move_jumps(model, near, goals), least))
    return found


def _move_jumps(model: Model, values: FloatArray, goals: FloatArray) -> FloatArray:
    """Values (d, k) of points (d, p) with J moved to each goal, S as it is or moved along."""
    trial = Mover(model, values[:, 0])(values, 1, goals)
    return trial.reshape(len(trial), -1)


def _polish_goals(model: Model, goals: FloatArray, trial: FloatArray, best: float) -> Jumps:
    """The best points of every goal (m,) among values (d, k) whose J is one of the goals, polished with J fixed."""
    costs = model.costs_of(trial)
    which = np.abs(trial[1] - goals[:, None]).argmin(axis=0)
    exact = np.abs(trial[1] - goals[which]) <= 1e-9 * goals[which]
    mine = (np.flatnonzero((which == goal) & exact) for goal in range(goals.size))
    kept = np.concatenate([at[np.argsort(costs[at], kind="stable")[:_STARTS]] for at in mine])
    points, which = model.cube(trial[:, kept]), which[kept]
    costs = model.costs(points)
    near = costs <= _FAR * best
    points, costs = _descend_near(model, points, costs, near)
    rows, free = model.shared.rows, min(best, float(costs.min(initial=np.inf)))
    near = costs <= free * np.exp(_NEAR / rows)
    if near.any():
        scanned = _scan_stickband(model, points[near])
        points[near], costs[near] = _descend_near(model, scanned, model.costs(scanned), np.ones(len(scanned), bool))
    order = np.lexsort((costs, which))
    order = order[np.unique(which[order], return_index=True)[1]]
    return Jumps(goals[which[order]], points[order], costs[order])


def _descend_near(model: Model, points: FloatArray, costs: FloatArray,
                  near: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Points (k, d) and costs (k,), those that are `near` after a descent with the valve fixed."""
    points, costs, at = points.copy(), costs.copy(), np.flatnonzero(near)
    if not at.size:
        return points, costs
    # Descents come back best first: the fixed numbers tell which is which.
    held = (0, 1, *model.forces)
    found = descend_model(model, points[at], fixed=held, turns=_TURNS, settle=_SETTLED)
    keys = [np.lexsort(x[:, held].T) for x in (points[at], found.points)]
    points[at[keys[0]]], costs[at[keys[0]]] = found.points[keys[1]], found.costs[keys[1]]
    return points, costs


def _scan_stickband(model: Model, points: FloatArray) -> FloatArray:
    """Points (k, d) with the best S of a fine ladder, J in % and the first slip as they are, then the best start force.
    """
    values = model.values(points)
    trial = values[:, :, None].repeat(_BANDS.size, axis=2)
    trial[0] *= 1.0 + _BANDS
    sides = np.sign(values[list(model.forces)])[:, :, None]
    before = (values[0] + values[1])[:, None] / (trial[0] + trial[1])
    for row, side in zip(model.forces, sides, strict=True):
        kept = np.where(side == 0.0, trial[row] * before, side * (1.0 - (1.0 - side * trial[row]) * before))
        trial[row] = np.clip(kept, -1.0, 1.0)
    cube = model.cube(trial.reshape(len(trial), -1))
    best = model.costs(cube).reshape(len(points), -1).argmin(axis=1)
    return first_force(model, cube.reshape(len(points), _BANDS.size, -1)[np.arange(len(points)), best], _FORCES)[0]
