"""Plateaus of the cost along S under a held command: location, and least cost of each with all else following.

A held command makes the cost a step function of S. A valve that breaks away one sample later, with a dead time one
sample shorter, does nearly as well. Its plateau may be twenty times narrower than the distance to it. A fine grid of S
at every such dead time finds them all. The slopes at the optimum give what the smooth parameters (J, process, effects)
would still gain. A descent removes the part of a residual that lies in their span. Only plateaus that come out as
possible get a descent.

All S on a plateau are equally likely, and a plateau is as likely as its cost says. An interval of S is therefore made
of shares of that likelihood, not of a threshold for smooth parameters.

Wrong where the slips shift by different numbers of samples on the way to another plateau; a search must then meet it.
Source: Chan 1993 and Hansen 2000 for thresholds; Golub and Pereyra 1973 for the slopes of a projected residual.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ...model.model import Model
from ...numerics.gauss_newton import slopes_at
from ...numerics.jit import LANES
from ...typing import FloatArray
from ..points.moves import descend_model
from .profile import Mover

# Samples of dead time looked at either way, and steps of S for the move of the command in one sample. Third: range of S
# for a dead time k samples shorter, in such moves, from the first to the second number times k plus half a move.
_SAMPLES, _FINE, _PACES = 3, 64, (0.6, 1.4)
# Twice the log-likelihood ratio beyond which a plateau is excluded, and the error that a grid may add to it. Then the
# ratio of neighbours on one plateau, and the most plateaus that get a descent. Slopes know little of distant plateaus:
# the best _FAR of every dead time get a descent in any case.
_POSSIBLE, _FURTHER, _ALIKE, _MOST = 8.0, 8.0, 0.5, 10
_FAR = 2
# Loss at one sample of dead time beyond which the next one is not looked at.
_BARRIER = 40.0
# Turns of a descent on one plateau, and when it has settled. Then the step of the differences for the slopes, and the
# share of the largest slope below which a slope counts as zero.
_TURNS, _SETTLED, _DIFFERENCE, _NO_SLOPE = 6, 1e-4, 1e-3, 1e-9
# Slip jumps tried on each plateau, as shares of that of the optimum.
_JUMPS = (1.0, *(1.0 + 0.01 * np.array([-9, -6, -4, -3, -2, -1, -0.5, 0.5, 1, 2, 3, 4, 6, 9])).tolist())
# Steps between two values of S of which one is possible, and the residual given to a valve that never moves.
_BETWEEN, _EXCLUDED = 8, 1e100
# Rungs of another friction parameter as shares of its range, and values of S tried at each. They lie around the
# extrapolation of earlier rungs, within these shares of S for a rung of 1 at the first and at later rungs. The last
# number is the count of lost rungs that ends the ladder.
_RIDGE, _RIDGE_LANES = 5e-4 * 1.35 ** np.arange(16), 97
_RIDGE_FIRST, _RIDGE_NEXT, _RIDGE_LOST = 1.6, 0.25, 3
# The first slip comes at a speed of the command of its own: samples tried beyond those of the dead time.
_FIRST = 1


@dataclass(frozen=True, slots=True)
class Plateaus:
    """Values of S (m,), ascending, and the least cost of each (m,); points (k, d) reached by descent, with costs."""

    S: FloatArray
    cost: FloatArray
    points: FloatArray
    costs: FloatArray

    def interval(self, rows: float, level: float) -> tuple[float, float]:
        """The S between which the middle `level` of the likelihood lies; `rows` are the independent ones."""
        weight = np.exp(-0.5 * rows * np.log(self.cost / self.cost.min()))
        # Between two values of S the likelihood is that of the nearer one: plateaus have steep ends.
        edges = np.concatenate([self.S[:1], 0.5 * (self.S[1:] + self.S[:-1]), self.S[-1:]])
        share = np.concatenate([[0.0], np.cumsum(weight * np.diff(edges))])
        low, high = np.interp(0.5 + np.array([-0.5, 0.5]) * level, share / share[-1], edges)
        return float(low), float(high)

    def possible_span(self, rows: float, threshold: float) -> tuple[float, float]:
        """The least and the most S of a plateau within `threshold` of the best one's likelihood, ends included."""
        S = self.S[rows * np.log(self.cost / self.cost.min()) <= threshold]
        return float(S.min()), float(S.max())


def plateaus(model: Model, point: FloatArray) -> Plateaus | None:
    """The plateaus beside an optimum (d,); None where S is given or no slip shows the speed of the command."""
    best = float(model.costs(point[None])[0])
    if not (model.spec.held and model.space.movable[0] and 0.0 < best < np.inf):
        return None
    first = _scan_beside(model, point, best, (-1, 0, 1))
    if first is None:
        return None
    scans = [first]
    # From one sample of dead time to the next: slopes at one optimum know little of a distant one.
    for sign in (-1, 1) if model.space.movable[4] else ():
        now, lost = first, False
        for _ in range(_SAMPLES):
            beside = now.samples == sign
            if not beside.any():
                break
            # One sample alone may lose: slips at different speeds of the command do not all shift by one sample.
            loses = _ratio(model, now.costs[beside].min(), best)
            if loses > (_POSSIBLE if lost else _BARRIER):
                break
            lost = bool(loses > _POSSIBLE)
            at = np.flatnonzero(beside)[now.costs[beside].argmin()]
            further = _scan_beside(model, now.points[at], best, (0, sign))
            if further is None:
                break
            scans.append(now := further)
    S = np.unique(np.concatenate([scan.lanes[0] for scan in scans]))
    least = np.min([scan.least(S) for scan in scans], axis=0)
    return Plateaus(S, best * np.exp(least / model.shared.rows), np.concatenate([scan.points for scan in scans]),
                    np.concatenate([scan.costs for scan in scans]))


def ridges(model: Model, point: FloatArray) -> FloatArray:
    """Points (k, d) beside an optimum (d,) where S moves together with another friction parameter.

    An effect on the friction takes part in the break-away. If S moves alone every slip comes at another sample; if that
    parameter moves along the slips stay. Their ratio is followed from small rungs to large ones. The result is empty
    where no effect is on the friction: then S alone decides the break-away.
    """
    columns = [c for effect, rows in zip(model.effects, model.effect_rows, strict=True) if effect.friction
               for c in range(rows.start, rows.stop)]
    columns = [c for c in (1, *columns) if columns and model.space.movable[c]]
    values = model.values(point[None])[:, 0]
    scan = _Scan(model, values, Mover(model, values), point) if columns and model.space.movable[0] else None
    best, found = float(model.costs(point[None])[0]), [np.empty((0, point.size))]
    for column, sign in product(columns if scan is not None else (), (-1.0, 1.0)):
        pace, width, lost = 0.0, _RIDGE_FIRST, 0
        for rung in _RIDGE:
            goal = point[column] + sign * rung
            if not 0.0 <= goal <= 1.0 or lost > _RIDGE_LOST:
                break
            trial = point[None].repeat(_RIDGE_LANES, axis=0)
            trial[:, column] = goal
            assert scan is not None
            S = values[0] * (1.0 + rung * (pace + width * np.linspace(-1, 1, len(trial))))
            beside = scan.match_start(trial, S)
            costs = scan.costs_when_followed(beside)
            at = int(costs.argmin())
            if _ratio(model, costs[at], best) < _POSSIBLE + _FURTHER:
                # Take the middle of the plateau: the next rung needs its direction.
                alike = np.flatnonzero(_ratio(model, costs, costs[at]) < _ALIKE)
                at = int(alike[np.argmin(np.abs(alike - alike.mean()))])
                pace = pace + width * float(np.linspace(-1, 1, len(trial))[at])
                width, lost = _RIDGE_NEXT, 0
                found.append(beside[[at]])
            else:
                lost += 1
    starts = np.concatenate(found)
    return descend_model(model, starts, fixed=(0, *model.forces), turns=_TURNS, settle=_SETTLED).points if len(
        starts) else starts


def _ratio(model: Model, cost: FloatArray | float, best: float) -> FloatArray:
    """Twice the log-likelihood (m,) that costs lose against the least one."""
    return model.shared.rows * np.log(np.maximum(cost, 1e-300) / best)


@dataclass(frozen=True, slots=True)
class _Scanned:
    """One grid search: lanes (3, m) and their loss (m,); points (k, d) after descent, costs, dead time less."""

    lanes: FloatArray
    ratio: FloatArray
    points: FloatArray
    costs: FloatArray
    samples: FloatArray

    def least(self, S: FloatArray) -> FloatArray:
        """The loss of each of ascending values of S (m,) with the best dead time and first slip."""
        out = np.full(S.size, np.inf)
        for kind in np.unique(self.lanes[1:], axis=1).T:
            mine = np.flatnonzero(np.all(self.lanes[1:].T - kind == 0.0, axis=1))
            own, ratio = self.lanes[0, mine], self.ratio[mine]
            near = np.clip(np.searchsorted(own, S), 1, max(own.size - 1, 1)) if own.size > 1 else np.zeros(S.size, int)
            near = near - ((S - own[near - 1] <= own[near] - S) & (near > 0))
            inside = (own[0] <= S) & (own[-1] >= S)
            out[inside] = np.minimum(out[inside], ratio[near[inside]])
        return out


def _scan_beside(model: Model, point: FloatArray, best: float, samples: tuple[int, ...]) -> _Scanned | None:
    """The grid search beside a point (d,), against `best`; None where no slip shows the speed of the command."""
    values = model.values(point[None])[:, 0]
    move = Mover(model, values)
    if not move.pace > 0.0:
        return None
    scan = _Scan(model, values, move, point)
    lanes = scan.lanes(samples if model.space.movable[4] else (0,))
    cost = scan.costs(lanes)
    for _ in range(2):
        more = scan.lanes_between(lanes, _ratio(model, cost, best))
        if not more.shape[1]:
            break
        lanes, cost = np.concatenate([lanes, more], axis=1), np.concatenate([cost, scan.costs(more)])
    order = np.lexsort(lanes)
    return scan.polish_possible(lanes[:, order], _ratio(model, cost[order], best), best)


class _Scan:
    """Costs of S at every dead time beside one point; the smooth parameters follow as far as their slopes reach."""

    def __init__(self, model: Model, values: FloatArray, move: Mover, point: FloatArray) -> None:
        self.model, self.values, self.move = model, values, move
        self.held = (0, *model.forces)
        free = np.flatnonzero(model.space.movable)
        free = free[~np.isin(free, self.held)]
        self.basis = np.zeros((model.loop.samples, 0))
        if free.size:
            slopes, _ = slopes_at(model.residuals, point[None], free, np.full((1, free.size), _DIFFERENCE))
            size = np.linalg.norm(slopes[0], axis=0)
            self.basis = np.linalg.qr(slopes[0][:, size > _NO_SLOPE * size.max()])[0]
        self.pace = move.pace * model.step_s
        self.lacks = [_lacks(piece, values[row] * 0.5 * (values[0] + values[1]), 0.5 * (values[0] + values[1]), side)
                      for piece, row, side in zip(model.pieces, model.forces, move.sides, strict=True)]

    def lanes(self, samples: tuple[int, ...]) -> FloatArray:
        """Lanes (3, m): S, samples by which the dead time is shorter, samples by which the first slip is later.

        The first slip comes at a speed of the command of its own, so a coarse grid finds its sample.
        """
        found = []
        for k in samples:
            late = np.arange(min(k, 0) - _FIRST, max(k, 0) + _FIRST + 1)
            rough = self._even_values(k, _FINE // 8)
            if not rough.size:
                continue
            grid = np.stack([g.ravel() for g in np.meshgrid(rough, [k], late, indexing="ij")])
            least = self.costs(grid).reshape(rough.size, late.size).min(axis=0)
            fine = self._even_values(k, _FINE)
            found.append(np.stack([fine, np.full(fine.size, k), np.full(fine.size, late[least.argmin()])]))
        return np.concatenate(found, axis=1)

    def _even_values(self, k: int, steps: int) -> FloatArray:
        """Values of S for a dead time k samples shorter, `steps` of them per move of the command in one sample."""
        axis = self.model.space.parameters[0]
        ends = np.sort(np.array(_PACES) * k) + np.array([-0.5, 0.5])
        S = self.values[0] + self.pace * np.arange(np.ceil(ends[0] * steps), ends[1] * steps + 1) / steps
        return S[(axis.low <= S) & (axis.high >= S)]

    def points(self, lanes: FloatArray, values: FloatArray | None = None, moved: float = 0.0) -> FloatArray:
        """Points (m, d) of lanes (3, m), with the smooth parameters of the optimum or of `values` (d,).

        `values` have a dead time that is `moved` samples shorter already.
        """
        S, samples, late = lanes
        trial = (self.values if values is None else values)[:, None].repeat(S.size, axis=1)
        trial[0] = S
        trial[1] = np.clip(trial[1], 0.0, self.model.space.parameters[1].high * S)
        dead = self.model.space.parameters[4]
        trial[4] = np.clip(trial[4] - (samples - moved) * self.model.step_s, dead.low, dead.high)
        fs = np.maximum(0.5 * (trial[0] + (S if self.model.law.one_parameter else trial[1])), 1e-300)
        for row, side, (first, lacks) in zip(self.model.forces, self.move.sides, self.lacks, strict=True):
            now = 0.5 * (self.values[0] + self.values[1]) * (1.0 - side * self.values[row])
            lack = np.where(late == 0.0, now, lacks[np.clip(first + late.astype(int), 0, lacks.size - 1)])
            trial[row] = np.clip(side * (1.0 - lack / fs), -1.0, 1.0)
        return self.model.cube(trial)

    def match_start(self, points: FloatArray, S: FloatArray) -> FloatArray:
        """Points (m, d) with another S (m,) and the same output change until the first break-away."""
        trial = self.model.values(points)
        trial[1] *= S / trial[0]
        trial[0] = np.clip(S, self.model.space.parameters[0].low, self.model.space.parameters[0].high)
        before = self.values[0] + self.values[1]
        for row, side in zip(self.model.forces, self.move.sides, strict=True):
            lack = before * (1.0 - side * self.values[row]) / np.maximum(trial[0] + trial[1], 1e-300)
            trial[row] = np.clip(side * (1.0 - lack), -1.0, 1.0)
        return self.model.cube(trial)

    def costs(self, lanes: FloatArray) -> FloatArray:
        """Costs (m,) of lanes (3, m) once the smooth parameters have followed."""
        return self.costs_when_followed(self.points(lanes))

    def costs_when_followed(self, points: FloatArray) -> FloatArray:
        """Costs (m,) of points (m, d) once the smooth parameters have followed."""
        out = np.empty(len(points))
        for a in range(0, len(points), LANES):
            r = self.model.residuals(points[a:a + LANES], lent=True)
            r[~np.isfinite(r)] = _EXCLUDED
            cost = np.einsum("np,np->p", r, r)
            out[a:a + LANES] = np.maximum(cost - np.sum((self.basis.T @ r)**2, axis=0), 1e-12 * cost)
        return out

    def _with_jump(self, lanes: FloatArray) -> FloatArray:
        """Points (m, d) of lanes (3, m) with the best of a few slip jumps.

        The cost has steps in J where the valve stops and goes.
        """
        if self.model.law.one_parameter or not self.model.space.movable[1]:
            return self.points(lanes)
        jump = np.arange(self.values.size) == 1
        trial = [self.points(lanes, self.values * np.where(jump, share, 1.0)) for share in _JUMPS]
        which = self.costs_when_followed(np.concatenate(trial)).reshape(len(trial), -1).argmin(axis=0)
        return np.stack(trial)[which, np.arange(which.size)]

    def lanes_between(self, lanes: FloatArray, ratio: FloatArray) -> FloatArray:
        """Further lanes (3, m) between neighbours of which one is possible and the other differs."""
        order = np.lexsort(lanes)
        lanes, ratio = lanes[:, order], ratio[order]
        edge = ((lanes[1:, 1:] == lanes[1:, :-1]).all(axis=0) & (np.minimum(ratio[1:], ratio[:-1]) < _POSSIBLE)
                & (np.abs(np.diff(ratio)) > _ALIKE))
        at = np.flatnonzero(edge)
        part = np.arange(1, _BETWEEN) / _BETWEEN
        more = lanes[:, at].repeat(part.size, axis=1)
        more[0] += (np.diff(lanes[0])[at, None] * part).ravel()
        return more

    def polish_possible(self, lanes: FloatArray, ratio: FloatArray, best: float) -> _Scanned:
        """The grid search with the costs of the possible plateaus replaced by those that a descent finds."""
        new = (lanes[1:, 1:] != lanes[1:, :-1]).any(axis=0) | (np.abs(np.diff(ratio)) > _ALIKE)
        plateau = np.concatenate([[0], np.cumsum(new)])
        least = np.full(plateau[-1] + 1, np.inf)
        np.minimum.at(least, plateau, ratio)
        order = np.argsort(least, kind="stable")
        near = order[least[order] < _POSSIBLE + _FURTHER]
        far, samples = order[near.size:], lanes[1, np.searchsorted(plateau, order[near.size:])]
        chosen = np.concatenate([near[:_MOST], *(far[samples == k][:_FAR] for k in np.unique(samples))])
        middles = np.array([(at := np.flatnonzero(plateau == which))[at.size // 2] for which in chosen], int)
        points, costs = np.empty((len(chosen), self.model.space.size)), np.empty(len(chosen))
        starts = self._with_jump(lanes[:, middles])
        for k in np.unique(lanes[1, middles]):
            mine = np.flatnonzero(lanes[1, middles] == k)
            found = descend_model(self.model, starts[mine], fixed=self.held, turns=_TURNS, settle=_SETTLED)
            # Descents come back best first; their S is unchanged.
            to, back = mine[np.argsort(starts[mine, 0], kind="stable")], np.argsort(found.points[:, 0], kind="stable")
            points[to], costs[to] = found.points[back], found.costs[back]
        ends = []
        for which, middle, point, cost in zip(chosen.tolist(), middles.tolist(), points, costs.tolist(), strict=True):
            at = np.flatnonzero(plateau == which)
            ratio[at] += _ratio(self.model, cost, best) - ratio[middle]
            # The same smooth parameters at either end of this plateau.
            values = self.model.values(point[None])[:, 0]
            ends.append(self.points(lanes[:, at[[0, -1]]], values, lanes[1, middle]))
        further = np.concatenate(ends) if ends else points
        return _Scanned(lanes, ratio, np.concatenate([points, further]), np.append(costs, self.model.costs(further)),
                        np.concatenate([lanes[1, middles], lanes[1, middles].repeat(2)[:len(further)]]))


def _lacks(model: Model, force: float, fs: float, side: float) -> tuple[int, FloatArray]:
    """Output changes (ascending) that put the first break-away of one segment at one sample after the other.

    The index says which of them holds at an initial `force` in % under a break-away force `fs`.
    """
    command = side * (model.context.command - model.context.command[0])
    highest = np.maximum.accumulate(command)
    # The middle between one highest command and the next: each is passed first at a sample of its own.
    ends = np.unique(highest)
    lacks = 0.5 * (ends[1:] + ends[:-1]) if ends.size > 1 else ends
    return int(np.argmin(np.abs(lacks - (fs - side * force)))), lacks
