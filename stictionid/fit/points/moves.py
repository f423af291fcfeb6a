"""Moves of a model's points, and substitutes for the model: descent, initial force, thinned, coarser and held models.

Searches, intervals and diagnosis share them. Source: docs/details.md, section 6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from ...effects.contract import Record
from ...model.model import Model
from ...model.segments import Restarted, bind_model
from ...model.spec import BASE, Spec
from ...numerics.gauss_newton import descend
from ...numerics.population import Found
from ...record.loop import Loop
from ...typing import FloatArray
from .fitted import Fitted, as_it_stands

# Samples a period for a search without starts; records with twice as many are thinned for it.
_SEARCH_SAMPLES = 60
# Parts of a sample where a command moves, for a search without starts.
_OPEN_SUBSTEPS = 2
# First differences of a descent, as a share of the range.
_DIFFERENCE = 1e-3
# Ladders of initial residual forces as shares of their range: a fine one to use, a rough one to rank points. With
# several segments each force is less certain, so neighbours of the present one are tried too.
_NEAR_FORCES = np.array([-0.03, -0.015, -0.007, -0.003, 0.003, 0.007, 0.015, 0.03])
FORCES = np.linspace(0.01, 0.99, 33)


def longest_piece(model: Model) -> int:
    """Index of the segment with the most samples that count."""
    return int(np.argmax([float(piece.weight.sum()) for piece in model.pieces]))


def beginning_of(fit: Fitted, samples: int) -> Fitted:
    """The fit on the first samples of its longest segment; the fit itself where that has less than twice as many."""
    model = fit.model
    at = longest_piece(model)
    piece = model.pieces[at].loop
    if piece.samples < 2 * samples:
        return fit
    short = bind_model(piece.cut(0, samples), model.spec, s_max=model.s_max, period_s=model.period_s)
    return as_it_stands(short, model.of(at, fit.values))


def beginning(model: Model, rows: int) -> Model:
    """The same one-segment model on the first rows of its record."""
    loop, residual = model.loop, model.context.residual
    if rows >= loop.samples:
        return model
    command = model.context.command[:rows * model.grid[1]]
    return Model(loop.cut(0, rows), model.spec, s_max=model.s_max, period_s=model.period_s, command=command,
                 residual=None if residual is None else residual[:rows], record=model.context.record)


def neutral_point(model: Model) -> FloatArray:
    """Neutral point (d,) of the unit cube; process parameters in the middle."""
    return np.array([0.5 if i in (3, 4) or not p.high > p.low else p.share(p.neutral)
                     for i, p in enumerate(model.space.parameters)])


def valve_grid(values: FloatArray, S: FloatArray, J: FloatArray) -> FloatArray:
    """Values (d, k) of valves with stickbands and slip jumps (k,), all other values as given (d,)."""
    grid = values[:, None].repeat(S.size, axis=1)
    grid[0], grid[1] = S, J
    return grid


def with_start(model: Model, points: FloatArray) -> FloatArray:
    """Points (k, d) with the best initial residual force of a ladder; the force has basins of its own."""
    return first_force(model, points, FORCES)[0]


def first_force(model: Model, points: FloatArray, ladder: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (k, d) with the best initial residual force of a ladder, their own included, and their costs (k,).

    With several segments each takes its own best, found as if it were alone.
    """
    if len(model.pieces) == 1:
        trial = points[:, None, :].repeat(ladder.size + 1, axis=1)
        trial[:, 1:, model.forces[0]] = ladder
        c = model.costs(trial.reshape(-1, points.shape[1])).reshape(len(points), -1)
        return trial[np.arange(len(points)), c.argmin(axis=1)], c.min(axis=1)
    assert isinstance(model, Restarted)
    near = points[:, None, list(model.forces)] + _NEAR_FORCES[:, None]
    trial = points[:, None, :].repeat(ladder.size + len(_NEAR_FORCES) + 1, axis=1)
    trial[:, 1:ladder.size + 1, list(model.forces)] = ladder[:, None]
    trial[:, ladder.size + 1:, list(model.forces)] = np.clip(near, 0.0, 1.0)
    alone = model.piece_costs(model.values(trial.reshape(-1, points.shape[1])))[0]
    best = alone.reshape(len(alone), len(points), -1).argmin(axis=2)
    chosen = points.copy()
    for force, at in zip(model.forces, best, strict=True):
        chosen[:, force] = trial[np.arange(len(points)), at, force]
    before, after = model.costs(np.concatenate([points, chosen])).reshape(2, -1)
    return np.where((after < before)[:, None], chosen, points), np.minimum(before, after)


def lift_points(model: Model, at: int, points: FloatArray) -> FloatArray:
    """Points (k, d) of one segment's model as points of the whole model; the starts of the other segments are neutral.
    """
    values = model.values(neutral_point(model)[None]).repeat(len(points), axis=1)
    values[[0, 1, model.forces[at], 3, 4, *range(model.head, len(values))]] = model.pieces[at].values(points)
    return model.cube(values)


def longest_first(model: Model, points: FloatArray) -> FloatArray:
    """Points (k, d) whose first time constant is the longer one: u and y do not show the order of two lags in series.
    """
    names, movers = list(model.named(np.zeros(model.space.size))), model.space.movable
    first = BASE.index("time_constant_s")
    second = [i for i, name in enumerate(names) if name.endswith(":second_time_constant_s")]
    if not second or not (movers[first] and movers[second[0]]):
        return points
    values = model.values(points)
    swapped = values.copy()
    swapped[[first, second[0]]] = values[[second[0], first]]
    return np.where((values[second[0]] > values[first])[:, None], model.cube(swapped), points)


def distinct_points(points: FloatArray, count: int, apart: float = 0.02) -> list[int]:
    """Indices of the first points (k, d), at most `count`, that lie apart by this share of the range."""
    return first_apart(range(len(points)), count, lambda i, j: bool(np.abs(points[i] - points[j]).max() > apart))


def cheapest_apart(model: Model, points: FloatArray, numbers: FloatArray, count: int, apart: float) -> FloatArray:
    """The points (k, d) of least cost, at most `count`, best first, whose numbers (k, m) lie so far apart."""
    order = np.argsort(model.costs(points), kind="stable")
    return points[order[distinct_points(numbers[order], count, apart)]]


def first_apart(candidates: Iterable[int], count: int, apart: Callable[[int, int], bool]) -> list[int]:
    """The first candidates, at most `count`, each of which lies apart from all those before it."""
    kept: list[int] = []
    for i in candidates:
        if all(apart(i, j) for j in kept):
            kept.append(i)
        if len(kept) == count:
            break
    return kept


def even_steps(dimensions: int) -> FloatArray:
    """Steps (d,) of an even sequence: powers of the root of x^(d+1) = x + 1 (Roberts 2018)."""
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return root ** -np.arange(1.0, dimensions + 1)


def spreads(model: Model, factor: float = 1.0) -> FloatArray:
    """First standard deviations of a polish, as shares of the ranges (d,)."""
    base = np.array([0.01, 0.05, 0.1, 0.03, 0.03])
    further = np.full(model.head - len(BASE), base[2])
    return factor * np.concatenate([base, further, np.full(model.space.size - model.head, 0.05)])


def search_model(model: Model) -> Model:
    """The model for a search without starts: a command that moves between samples gets a coarser grid."""
    if model.spec.substeps <= _OPEN_SUBSTEPS or model.spec.held:
        return model
    return _substitute(model, replace(model.spec, substeps=_OPEN_SUBSTEPS), None)


def _substitute(model: Model, spec: Spec, record: Record | None) -> Model:
    """A model of another spec in the place of a model, which several stages ask for; kept while that exists.

    The substitutes for a model differ in their substeps: 1 under a held command, more on a coarser grid.
    """
    known: dict[int, Model] = model.loop.memory.substitutes.setdefault(model, {})
    if spec.substeps not in known:
        known[spec.substeps] = bind_model(model.loop, spec, s_max=model.s_max, period_s=model.period_s,
                                          residual=model.context.residual, record=record)
    return known[spec.substeps]


def as_held(model: Model) -> Model:
    """The same model under a held command: the same basins at fewer rows of the valve.

    A thinned model is returned unchanged: its valve sees commands that its own samples do not hold.
    """
    if model.spec.held or model.thinned:
        return model
    return _substitute(model, replace(model.spec, between="hold", substeps=1), model.context.record)


def thinning(model: Model) -> int:
    """Number n such that a search without starts needs one sample in n."""
    return int(model.period_s / model.step_s / _SEARCH_SAMPLES)


def thin_model(model: Model, every: int) -> Model:
    """The same model on one sample in `every`: y is averaged around it, the valve still sees every command.

    The one-step error of a record sampled much faster than its dynamics is all noise; thinned, it shows the valve.
    """
    if every <= 1:
        return model
    if len(model.pieces) > 1:
        return _thin_segments(model, every)
    loop, good, links = model.loop, model.good(), model.links
    half = every // 2
    part = slice(half, loop.samples - half, every)
    if links is not None:
        # Where PV is missing its straight lines between two samples that count are good enough for a search.
        good = good | links.gap_samples()
        if every < 2.0 * links.pace:
            # There is nothing to average: the rows that hold most of what was measured.
            half, part = 0, slice(int(np.bincount(links.rows % every).argmax()), loop.samples, every)
    window = np.ones(2 * half + 1) / (2 * half + 1)
    y = np.convolve(model.context.process_value, window, "same")[part]
    m = model.spec.substeps
    command = model.context.command[part.start * m:]
    residual = model.context.residual
    small = Loop(output=loop.output[part], process_value=y,
                 setpoint=None if loop.setpoint is None else loop.setpoint[part],
                 used=(np.convolve(good, window, "same") > 0.999)[part],
                 extras={tag: x[part] for tag, x in loop.extras.items()}, step_s=loop.step_s * every, units=loop.units,
                 memory=loop.memory)
    rows = small.samples * every * m
    command = np.concatenate([command[:rows], np.full(max(rows - command.size, 0), command[-1])])
    return bind_model(small, replace(model.spec, substeps=every * m), s_max=model.s_max, period_s=model.period_s,
                      residual=None if residual is None else residual[part], command=command,
                      record=model.context.record)


def _thin_segments(model: Model, every: int) -> Model:
    """The model of several segments, each thinned on its own."""
    parts = [thin_model(piece, every) for piece in model.pieces]
    clock = model.loop.clock_s
    small = Loop.joined([part.loop for part in parts],
                        begins_s=tuple(float(clock[first]) for first in model.loop.starts))
    residual = None if model.context.residual is None else np.concatenate([p.context.residual for p in parts])
    return bind_model(small, parts[0].spec, s_max=model.s_max, period_s=model.period_s, residual=residual,
                      command=np.concatenate([part.context.command for part in parts]))


def descend_model(model: Model, starts: FloatArray, *, fixed: tuple[int, ...] = (), turns: int = 20,
                  settle: float = 1e-5) -> Found:
    """Starts (k, d) of a model polished by descent, in all parameters that may move but those `fixed`; best first."""
    spread = np.where(model.space.movable, _DIFFERENCE, 0.0)
    spread[list(fixed)] = 0.0
    return descend(partial(model.residuals, lent=True), model.costs, starts, spread=spread, turns=turns, settle=settle)


def descend_values(model: Model, starts: FloatArray, *, turns: int = 20, settle: float = 1e-5) -> FloatArray:
    """The best values (d,) that descents from values (d, k) in all parameters reach."""
    found = descend_model(model, model.cube(starts), turns=turns, settle=settle)
    return model.values(found.points[:1])[:, 0]


def polish_smooth(model: Model, point: FloatArray) -> tuple[FloatArray, float]:
    """Point (d,) polished with the break-away fixed, and its cost.

    The plateau of S is narrower than that of any other parameter. With S fixed, J, the process and the effects settle
    in a smooth cost.
    """
    found = descend_model(model, point[None], fixed=(0, *model.forces))
    return found.points[0], float(found.costs[0])


def behind_valve(model: Model, starts: FloatArray, own: slice, *, turns: int, settle: float) -> Found:
    """Starts (k, d) polished in the process and one effect's parameters (`own`) only, the valve fixed; best first.

    The exchange between a lag, the dead time and the time constant is smooth while no slip moves. S and J have a step
    at every sample: a descent in all parameters stops at the first one.
    """
    free = {3, 4, *range(own.start, own.stop)}
    held = tuple(i for i in range(model.space.size) if i not in free)
    return descend_model(model, starts, fixed=held, turns=turns, settle=settle)
