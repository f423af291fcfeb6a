"""One model fitted to one record: independent searches until two agree, last polish, hold-out error, intervals.

Covariance matrix adaptation on the free-run cost finishes all starts side by side. The agreement of the restarts is
part of the answer. Source: docs/details.md, sections 6, 8 and 11.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ..model.model import Model
from ..model.segments import rebind_model
from ..numerics.population import Found, refine
from ..record.intervals import Span, united
from ..typing import BoolArray, FloatArray
from .intervals.assemble import CLOUD, NOTHING_TRIED, cloud, intervals_of, pieces_of, widen_cloud
from .points.fitted import Fitted
from .points.held_out_blocks import held_out_cost
from .points.moves import (
    descend_model,
    distinct_points,
    longest_first,
    polish_smooth,
    spreads,
    thin_model,
    thinning,
    with_start,
)
from .points.plateau import end_of_ladder, settle_on_plateau
from .starts.basins import along_ridge, basins, grow_starts, roam_free_run, with_other_start, with_process

# Costs that differ by less than this share belong to one valve path; a ladder of S searches where the path ends.
_SAME_PATH = 1e-9
_PLATEAU_LADDER = np.geomspace(1e-6, 0.05, 30)
_MOST_RUNS, _RIDGE_TURNS = 4, 3
# A restart of an integrator whose cost is this many times the best so far starts from a growing record.
_MUCH_WORSE = 1.5
# Turns of descent that rank the starts beside the best one, and the number of starts that then get a population.
_GLANCE, _KEPT = 3, 3
# A polish has settled when its cost falls by less than this share in a dozen rounds.
_SETTLED = 1e-4
# Points closer than this in S and J (share of the range) need only one last polish.
_SAME_POINT = 2e-3
# Two restarts agree when S differs by at most this share and J by at most this share of S (docs/details.md, section
# 6.3).
AGREE_S, AGREE_J = 0.01, 0.05
# Their costs must agree as well: -2 ln LR, or a share of the cost where the record is noise-free.
_AGREE_COST, _AGREE_SIGNAL = 0.05, 0.002
# Likelihood ratio below which friction explains nothing (as in the verdict).
_EXPLAINS_NOTHING = 15.0
# Twice the log-likelihood that moves the answer to another step of S, and the most moves.
_BETTER, _STEPS_BETTER = 0.5, 3
# Dead times tried beside a minimum (in parts of a sample; each may hold a minimum), turns, and starts kept a turn.
_BESIDE, _BESIDE_TURNS, _BESIDE_KEPT = (-8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0), 4, 3


def search(model: Model, rng: np.random.Generator, *, starts: FloatArray | None = None,
           before: tuple[FloatArray, FloatArray] | None = None) -> tuple[FloatArray, FloatArray]:
    """Independent runs until two agree, four at the most: their best points (k, d) and costs (k,), best first.

    `before` are runs that were made already. A run that reaches the best optimum so far is not polished further. Where
    two runs find no friction that explains anything there is no S to agree on, and the search ends.
    """
    points, costs = before or (np.empty((0, model.space.size)), np.empty(0))

    def agrees(point: FloatArray, cost: float) -> bool:
        if not len(costs):
            return False
        order = np.argsort([costs[0], cost], kind="stable")
        return agreement(model, np.stack([points[0], point])[order], np.array([costs[0], cost])[order]) == 2

    while len(costs) < _MOST_RUNS and not (len(costs) >= 2 and agreement(model, points, costs) >= 2):
        point, cost = one_run(model, rng, starts, enough=agrees)
        if model.spec.increments and starts is None and cost > _MUCH_WORSE * costs.min(initial=np.inf):
            # The best so far lies in a basin too narrow for swarms. A restart that cannot find it says nothing against
            # it.
            point, cost = one_run(model, rng, grow_starts(model, rng))
        points, costs = np.concatenate([points, point[None]]), np.append(costs, cost)
        order = np.argsort(costs, kind="stable")
        points, costs = points[order], costs[order]
        if len(costs) == 2 and agreement(model, points, costs) < 2 and _nothing_found(model, points[0], costs[0]):
            break
    return points, costs


def _nothing_found(model: Model, point: FloatArray, cost: float) -> bool:
    """True where a valve without friction explains as much as point (d,), once its process has descended from there."""
    if model.spec.friction_free or not model.space.movable[0]:
        return False
    free = rebind_model(model, replace(model.spec, friction_free=True, between="hold", substeps=1),
                        model.context.residual)
    values = model.values(point[None]).repeat(3, axis=1)
    values[[0, 1, *model.forces]] = 0.0
    values[4] = np.maximum(values[4] - np.array([0.0, 0.5, 1.0]) * model.step_s, 0.0)
    found = descend_model(free, free.cube(values), turns=10, settle=1e-3)
    return bool(model.shared.rows * np.log(found.costs[0] / max(cost, 1e-300)) < _EXPLAINS_NOTHING)


def one_run(model: Model, rng: np.random.Generator, starts: FloatArray | None = None, near: FloatArray | None = None,
            enough: Callable[[FloatArray, float], bool] | None = None) -> tuple[FloatArray, float]:
    """One search from nothing (or from given starts): best point (d,) and cost. `near` are known basins.

    `enough` gets point and cost before the search along the curve of equal cost (S against dead time). Where that curve
    is smooth it gets them once more, after the first turns. The search ends where it returns true. A record with very
    many samples a period is thinned and searched first: the curve of the thinned record is short.
    """
    moving = not model.spec.held
    every = thinning(model)
    if starts is None:
        near = basins(model, rng) if near is None else near
        if every > 1:
            small = thin_model(model, every)
            point, _ = one_run(small, rng, near=near)
            beside = np.outer(np.arange(model.space.size) == 4, 0.5 * every * model.step_s * np.arange(-1, 2))
            starts = model.cube(small.values(point[None]).repeat(3, axis=1) + beside)
        else:
            starts = np.concatenate([with_process(model, near), roam_free_run(model, rng)])
    found = refine(model.costs, with_start(model, starts), rng, spread=spreads(model), rounds=12 if moving else 35,
                   population=14, settle=_SETTLED)
    points = found.points
    if enough is not None and enough(points[0], float(found.costs[0])):
        return points[0], float(found.costs[0])
    for _ in range(0 if moving else _RIDGE_TURNS):
        near = np.concatenate([with_start(model, np.concatenate([points[:2], along_ridge(model, points[:2])])),
                               with_other_start(model, points[0])])
        near = descend_model(model, near, turns=_GLANCE).points[:_KEPT]
        last = refine(model.costs, near, rng, spread=spreads(model, 0.4), rounds=45, population=14, settle=_SETTLED)
        dead = model.values(np.stack([points[0], last.points[0]]))[4]
        points = last.points
        if abs(dead[1] - dead[0]) < 0.5 * model.step_s:
            break
    if moving:
        # Where the command moves between samples the curve of equal cost is a smooth, narrow valley: descend along it.
        found = descend_model(model, with_start(model, points), turns=6, settle=1e-2)
        points = found.points
        if enough is not None and enough(points[0], float(found.costs[0])):
            return points[0], float(found.costs[0])
        near = np.concatenate([with_start(model, points[:2]), with_other_start(model, points[0], 1)])
        found = descend_model(model, near, settle=_SETTLED)
        return found.points[0], float(found.costs[0])
    return polish_smooth(model, with_start(model, points[:1])[0])


def middle_of_plateau(model: Model, point: FloatArray) -> FloatArray:
    """Point (d,) moved to the middle of the break-away forces that give the very same valve path.

    A held command jumps over every force between two of its values. A range of f_s, with f_d and e(0) unchanged,
    therefore explains the record equally well. Its middle has the smallest expected error.
    """
    if model.law.one_parameter or not model.space.movable[:3].all():
        return point
    values, forces = model.values(point[None])[:, 0], list(model.forces)
    fs = 0.5 * (values[0] + values[1])
    cost = float(model.costs(point[None])[0])
    same = cost * (1.0 + _SAME_PATH) + _SAME_PATH * _SAME_PATH * model.shared.target_energy

    def alike(moves: FloatArray) -> BoolArray:
        trial = values[:, None].repeat(moves.size, axis=1)
        trial[0] += moves
        trial[1] += moves
        trial[forces] *= fs / (fs + moves)
        inside = ((np.abs(trial[forces]) <= 1.0).all(axis=0) & (trial[1] >= 0.0) & (trial[1] <= 2.0 * trial[0])
                  & (trial[0] <= model.space.parameters[0].high))
        trial[:, ~inside] = values[:, None]
        return (model.costs_of(trial) <= same) & inside

    ladder = fs * _PLATEAU_LADDER
    move = 0.5 * (end_of_ladder(ladder, alike) - end_of_ladder(ladder, lambda moves: alike(-moves)))
    moved = values.copy()
    moved[:2] += move
    moved[forces] *= fs / (fs + move)
    found = model.cube(moved[:, None])[0]
    return found if float(model.costs(found[None])[0]) <= same else point


def finish_fit(model: Model, points: FloatArray, costs: FloatArray, rng: np.random.Generator, *,
               rounds: int = 200, holdout: bool = True, reach: bool = True, spans: bool = True) -> Fitted:
    """The last polish of the best points, with errors, hold-out and intervals.

    Without `reach` the intervals span only the points met so far; `widen_intervals` completes them. Without `spans`
    there are none.
    """
    values = model.values(points)
    near = with_start(model, points[distinct_points(points[:, :2], 3, _SAME_POINT)])
    if not model.spec.held:
        found = _best_beside(model, descend_model(model, near, turns=40))
    else:
        found = refine(model.costs, near, rng, spread=spreads(model, 0.15), rounds=rounds, population=18,
                       settle=_SETTLED)
    top = polish_smooth(model, found.points[0])[0]
    if reach:
        top = settle_on_plateau(model, top)
    agree = agreement(model, points, costs)
    for turn in range(1 + _STEPS_BETTER):
        best_cost = float(model.costs(top[None])[0])
        cube, cost = cloud(model, top, rng)
        S, tried = None, NOTHING_TRIED
        if reach and spans:
            cube, cost, S, tried = widen_cloud(model, cube, cost)
        # Points beside an optimum tell nothing of the interval of a better one.
        if not (reach and spans) or turn == _STEPS_BETTER or _gain(model, best_cost, float(cost.min())) <= _BETTER:
            break
        top = settle_on_plateau(model, cube[cost.argmin()])
    if not (reach and model.spec.held) and cost.min() < best_cost:
        top = cube[cost.argmin()]
    if model.spec.held and not reach:
        top = middle_of_plateau(model, top)
    best_cost = float(model.costs(top[None])[0])
    cube, cost = np.concatenate([top[None], cube]), np.append(best_cost, cost)
    best_values = model.values(longest_first(model, top[None]))[:, 0]
    best = model.evaluate(best_values)
    held = held_out_cost(model, best, cube[np.argsort(cost, kind="stable")[:CLOUD // 2]]) if holdout else None
    intervals = intervals_of(model, cube, cost, best_cost, best, S, rough=not reach) if spans else {}
    return Fitted(model, best_values, best_cost, len(points), agree, best, held, intervals, values[:2].T, (cube, cost),
                  pieces_of(model, cube, cost, best, tried, intervals))


def _gain(model: Model, cost: float, other: float) -> float:
    """Twice the log-likelihood that another cost gains over a cost."""
    return float(model.shared.rows * np.log(max(cost, 1e-300) / max(other, 1e-300)))


def widen_intervals(fit: Fitted, rng: np.random.Generator, *, steps_only: bool = False) -> Fitted:
    """A fit finished without `reach`, its intervals now as wide as the cost allows for S and J.

    With `steps_only` only the steps of S under a held command are looked at, for a wider model that does the others.
    Where one of these steps does better than the fit, the answer moves there.
    """
    if fit.around is None:
        return fit
    for _ in range(_STEPS_BETTER):
        cube, cost, S, tried = widen_cloud(fit.model, *fit.around, steps_only=steps_only)
        best = min(fit.sse, float(cost.min()))
        if S is None or _gain(fit.model, fit.sse, best) <= _BETTER:
            break
        moved = finish_fit(fit.model, cube[[cost.argmin()]], cost[[cost.argmin()]], rng, reach=False)
        same = abs(moved.values[0] - fit.values[0]) <= AGREE_S * fit.values[0]
        fit = replace(moved, runs=fit.runs, agree=fit.agree if same else 1, searched=fit.searched)
    if S is None and steps_only:
        return fit  # no steps of S: `finish_fit` has looked at everything
    found = intervals_of(fit.model, cube, cost, min(fit.sse, best), fit.best, S)
    return replace(fit, intervals=found, around=(cube, cost),
                   pieces=pieces_of(fit.model, cube, cost, fit.best, tried, found))


def include_intervals(fit: Fitted, intervals: Mapping[str, Span], pieces: Mapping[str, tuple[Span, ...]]) -> Fitted:
    """A fit whose intervals reach to those of a wider model, too, in pieces where both leave a gap."""
    both, parts = dict(fit.intervals), dict[str, tuple[Span, ...]]()
    for name in fit.intervals:
        if name in intervals:
            found = united([*fit.spans(name), *(pieces.get(name) or (intervals[name],))])
            both[name] = found[0][0], found[-1][1]
            parts |= {name: found} if len(found) > 1 else {}
    return replace(fit, intervals=both, pieces=parts)


def _best_beside(model: Model, found: Found) -> Found:
    """The best minimum (1, d) among those a few parts of a sample of dead time away.

    The rebuilt command is known on a grid of parts of a sample. So each part of dead time may hold a minimum of its
    own.
    """
    dead, part = model.space.parameters[4], model.step_s / model.spec.substeps
    if dead.high <= dead.low:
        return found
    for _ in range(_BESIDE_TURNS):
        starts = found.points[:1].repeat(len(_BESIDE), axis=0)
        starts[:, 4] = np.clip(starts[:, 4] + np.array(_BESIDE) * part / (dead.high - dead.low), 0.0, 1.0)
        shifted = descend_model(model, starts, fixed=(4,), turns=2, settle=1e-2).points[:_BESIDE_KEPT]
        shifted = descend_model(model, shifted, fixed=(4,), turns=3, settle=1e-2).points
        more = descend_model(model, shifted[:2], turns=40)
        if not more.costs[0] < found.costs[0] * (1.0 - _SETTLED):
            break
        found = more
    return found


def agreement(model: Model, points: FloatArray, costs: FloatArray) -> int:
    S, J = model.values(points)[:2]
    close = (np.abs(S - S[0]) <= AGREE_S * S[0]) & (np.abs(J - J[0]) <= AGREE_J * S[0])
    if not np.isfinite(costs[0]):
        return 1
    ratio = costs / max(costs[0], 1e-300)
    alike = (ratio <= 1.0 + _AGREE_COST) | (model.shared.rows * np.log(np.maximum(ratio, 1e-300)) <= 2.0)
    # Errors that differ by less than this share of the signal are alike in any real record.
    alike |= np.sqrt(costs) - np.sqrt(costs[0]) <= _AGREE_SIGNAL * np.sqrt(model.shared.target_energy)
    return int((close & alike).sum())


def held_out_error(model: Model, point: FloatArray, rng: np.random.Generator) -> float | None:
    """Held-out error of a point (d,) of the unit cube as it is, in the form that the model is fitted in."""
    cube, cost = cloud(model, point, rng)
    cube = cube[np.argsort(cost, kind="stable")[:CLOUD // 2]]
    return held_out_cost(model, model.evaluate(model.values(cube[:1])[:, 0]), cube)

