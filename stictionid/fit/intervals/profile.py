"""Values that the cost does not exclude where it has steps: ladders outwards for S, J and times of changes.

A held command makes the cost a step function of S, and of J where the valve stops and goes on in the same direction.
Points drawn at random end inside the outermost step that is not excluded. The ladder finds that step with all other
parameters following, and finer ladders find its end.

Where friction changes at once the cost is constant from one slip to the next. Slopes know nothing of such a time, so it
is moved outwards on a ladder until the cost excludes it; the first excluded rung is the end. Under a held command S and
the start stay: their cost has steps, too. Wrong where another S would make up for another time: this interval is then
too short. Source: likelihood of a change point, Hinkley 1970; docs/details.md, section 8.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...model.model import Model
from ...record.intervals import Span
from ...typing import FloatArray
from ..points.moves import descend_model

# Rungs beyond the possible values, as shares of S: for S and for J. Under a held command those of S are close together.
# Another optimum lies one sample of dead time away, and its step may be as narrow as their distance. The best of a few
# neighbouring rungs is polished. A command that moves makes the cost smooth.
_LADDERS = (np.geomspace(5e-4, 0.12, 40), np.geomspace(2e-3, 0.5, 14))
_SMOOTH_LADDERS = (np.geomspace(1e-3, 0.12, 10), np.geomspace(4e-3, 0.5, 7))
_TOGETHER = (4, 1)
# Rungs between the last possible value and the first excluded one, and rungs that share a polish. Then rounds (one on
# the ladder, the others between its rungs) with steps in the cost and without.
_BETWEEN, _SHARED, _ROUNDS, _SMOOTH_ROUNDS = 8, 4, 3, 2
# Starts of each rung: outermost points, and best points over the range of the other parameter.
_OUTERMOST, _OVER = 3, 3
# Rungs polished from the first one that is excluded unpolished, where the cost is smooth.
_SMOOTH_RUNGS = 4
# Rungs of a time either way, from one sample to the whole record: PV shows nothing between its samples. Then turns of
# the descent of the others at each rung, and the fall of the cost at which it ends.
_TIMES, _TURNS, _STILL = 60, 3, 1e-3


def reach_ends(model: Model, cube: FloatArray, cost: FloatArray, ratio: float,
               which: tuple[int, ...] = (0, 1)) -> tuple[FloatArray, FloatArray]:
    """Points (k, d) and costs (k,) with points added where S and J are least and most within `ratio` of the least cost.

    `which` selects the parameters: 0 for S, 1 for J.
    """
    numbers = [i for i in which if model.space.movable[i] and not (i == 1 and model.law.one_parameter)]
    move = Mover(model, model.values(cube[[cost.argmin()]])[:, 0])
    excluded = {(number, sign): np.inf * sign for number in numbers for sign in (-1, 1)}
    for _ in range(_ROUNDS if model.spec.held else _SMOOTH_ROUNDS):
        for number in numbers:
            points, costs, targets = _move_outwards(move, cube, cost, ratio, number, excluded)
            cube, cost = np.concatenate([cube, points]), np.concatenate([cost, costs])
            values = model.values(cube)[number]
            possible = values[cost <= ratio * cost.min()]
            for sign in (-1, 1):
                edge = sign * (sign * possible).max()
                beyond = sign * (targets - edge)
                if (beyond > 0).any():
                    excluded[number, sign] = edge + sign * beyond[beyond > 0].min()
    return cube, cost


def _move_outwards(move: Mover, cube: FloatArray, cost: FloatArray, ratio: float, number: int,
                   excluded: dict[tuple[int, int], float]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (k, d), costs and targets of one parameter, beyond both ends of its possible values so far."""
    model = move.model
    at = np.flatnonzero(cost <= ratio * cost.min())
    values = model.values(cube[at])
    limit = ratio * float(cost.min())
    ladder = (_LADDERS if model.spec.held else _SMOOTH_LADDERS)[number] * values[0, cost[at].argmin()]
    together = _TOGETHER[number] if model.spec.held else 1
    parts, targets, found = [], [], []
    for sign in (-1, 1):
        order = np.argsort(-sign * values[number], kind="stable")[:_OUTERMOST]
        edge, end = float(values[number, order[0]]), excluded[number, sign]
        first = not np.isfinite(end)
        goal = edge + sign * ladder if first else np.linspace(edge, end, _BETWEEN + 2)[1:-1]
        starts = np.concatenate([order, spread_over(values[1 - number], cost[at], _OVER)])
        trial = move(values[:, starts], number, goal)
        points = model.cube(trial.reshape(len(trial), -1))
        costs = model.costs(points)
        near, groups = points[costs <= limit], costs.reshape(goal.size // (together if first else _SHARED), -1)
        best = points[groups.argmin(axis=1) + np.arange(len(groups)) * groups.shape[1]]
        if first and not model.spec.held:
            # With a smooth cost, rungs before the first excluded one need no polish, nor those far beyond it.
            beyond = int(np.argmax(groups.min(axis=1) > limit)) if groups[-1].min() > limit else len(groups) - 1
            best, goal = best[beyond:beyond + _SMOOTH_RUNGS], goal[beyond:beyond + _SMOOTH_RUNGS]
        parts.append(best)
        found.append(near[np.argsort(-sign * model.values(near)[number], kind="stable")[:_OUTERMOST]])
        targets.append(goal)
    held = (0, *model.forces) if number == 0 else (0, 1, *model.forces)
    polished = descend_model(model, np.concatenate(parts), fixed=held, turns=3, settle=1e-3)
    plain = np.concatenate(found)
    return (np.concatenate([polished.points, plain]), np.concatenate([polished.costs, model.costs(plain)]),
            np.concatenate(targets))


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
    away = np.geomspace(context.step_s, context.length_s, _TIMES)
    break_away = (0, *model.forces) if model.spec.held else ()
    found = {}
    for at in instant_columns(model):
        trial = values[:, None].repeat(2 * _TIMES, axis=1)
        p = model.space.parameters[at]
        trial[at] = np.clip(values[at] + np.concatenate([-away, away]), p.low, p.high)
        near = descend_model(model, model.cube(trial), fixed=(at, *break_away), turns=_TURNS, settle=_STILL)
        trial = model.values(near.points)
        excluded = trial[at][cost(trial) > limit]
        found[names[at]] = (float(excluded[excluded < values[at]].max(initial=p.low)),
                            float(excluded[excluded > values[at]].min(initial=p.high)))
    return found


def spread_over(numbers: FloatArray, cost: FloatArray, parts: int) -> NDArray[np.intp]:
    """Index of the point of least cost in each of `parts` equal parts of the range of one parameter (k,)."""
    width = max(float(np.ptp(numbers)), 1e-300)
    part = np.minimum((numbers - numbers.min()) / width * parts, parts - 1).astype(int)
    order = np.argsort(cost, kind="stable")
    return order[np.unique(part[order], return_index=True)[1]]


class Mover:
    """Moves S or J of points while the valve path changes as little as possible.

    `pace` is the speed of the command at break-away in % per second: a later break-away goes with a dead time shorter
    by as much. `sides` holds the direction in which the valve of each segment moves first.
    """

    def __init__(self, model: Model, values: FloatArray) -> None:
        self.model = model
        command, path = model.context.command, model.positions(values[:, None])[:, 0]
        path = path[::max(path.size // command.size, 1)]
        steps = np.diff(path)
        moved = np.abs(steps) > 1e-9
        slips = np.flatnonzero(moved[1:] & ~moved[:-1]) + 1
        per = model.step_s / model.parts
        self.pace = float(np.median(np.abs(np.diff(command)[slips]))) / per if slips.size else 0.0
        self.sides = [1.0 if (first := part[np.abs(part - part[0]) > 1e-9]).size == 0 else float(np.sign(
            first[0] - part[0])) for part in model.split(path)]

    def __call__(self, values: FloatArray, number: int, goal: FloatArray) -> FloatArray:
        """Values (d, goals, m k) of points (d, k) with S or J moved to each goal.

        The other one stays or moves along. With S the dead time stays or makes up for the later break-away.
        """
        model = self.model
        trial = values[:, None, :].repeat(goal.size, axis=1)
        move = goal[:, None] - values[number]
        trial[number] += move
        ways = [trial]
        if not model.law.one_parameter and model.space.movable[:2].all():
            ways.append(trial.copy())
            ways[1][1 - number] += move
        if number == 0 and self.pace > 0.0 and model.space.movable[4]:
            for way in ways[:]:
                ways.append(way.copy())
                ways[-1][4] -= move / self.pace
        trial = np.concatenate(ways, axis=2)
        S, dead = model.space.parameters[0], model.space.parameters[4]
        trial[0] = np.clip(trial[0], S.low, S.high)
        trial[1] = np.clip(trial[1], 0.0, model.space.parameters[1].high * trial[0])
        trial[4] = np.clip(trial[4], dead.low, dead.high)
        # The output change until the first break-away is kept, so that it comes at the same sample.
        before = np.tile(values[0] + values[1], len(ways))[None] / np.maximum(trial[0] + trial[1], 1e-300)
        for row, side in zip(model.forces, self.sides, strict=True):
            trial[row] = np.clip(side * (1.0 - (1.0 - side * trial[row]) * before), -1.0, 1.0)
        return trial
