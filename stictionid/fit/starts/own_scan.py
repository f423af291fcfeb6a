"""Starts for an effect that says where its valves lie: an even grid on a few periods, polished on longer parts.

The grid spans valve, process and effect together, because the process of a model without the effect is wrong as well.
Most of the many local minima of the first part fail on the next one; each part leaves fewer points. On a whole record a
slip too many or too few puts all later ones out of step, and the basin is a thousandth wide. Measured on 14 loops whose
positioner integrates (plants/beyond.py, seed 47000): within 2 % of the true S in all of them, two of these after a
second search. (With twice the points; with today's 7 of 8 are named, seed 41008.) Source: docs/details.md, section 6.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...effects import parse
from ...model.model import Model
from ...numerics.population import refine
from ...record.loop import fingerprint
from ...system import evaluations
from ...typing import FloatArray
from ..points.moves import (
    as_held,
    beginning,
    descend_model,
    distinct_points,
    even_steps,
    lift_points,
    longest_piece,
    spreads,
    thin_model,
    thinning,
)
from .continuation import growing_parts

# Points of the grid, periods of the first part, growth of the parts, and points that the first and the last leave.
_SCAN, _PERIODS, _GROWTH, _LEFT = 60_000, 3.0, 1.6, (120, 8)
# Best points of the grid that get a descent, for each that the first part leaves; their distance, and that of points
# that are kept (shares of a range).
_DESCENDED, _APART, _NEAR = 4, 0.03, 0.004
_TURNS, _ROUNDS, _POPULATION, _SPREAD, _SETTLED = 6, 20, 14, 0.4, 1e-3
# Steps of the draws about the best points (share), points, draws about each, distance of those that get a descent; then
# steps of the dead time (periods) and of the effect (share of its range) for a step of 1.
_STEPS, _ABOUT, _DRAWS, _CLOSE = (0.08, 0.05, 0.03, 0.02, 0.012, 0.008, 0.005, 0.003), 6, 600, 0.002
_LATE, _OWN = 0.07, 0.3
# Most searches of a record. Another one follows where the last left more than this multiple of the error of its first
# part, but less than this share of the squared error without the effect. The first part must leave less than the share,
# too: its many numbers fit a few periods better in any case. Fifteen positioners left 0.002 to 0.16 there.
_SEARCHES, _OUT_OF_STEP, _PROMISING = 3, 1.6, 0.5
# Two searches that end with so nearly one squared error (share) found one valve: no third one follows.
_AGREE = 0.05
# Periods from which a part that is no better than without the effect ends a search.
_ENOUGH = 8.0
# Candidates of the grid that are evaluated at once.
_BLOCK = 10_000


def scanned_starts(model: Model, name: str, values: FloatArray, far: bool) -> FloatArray:
    """Points (k, d), best first, for a model with effect `name`; other effects stay as in values (d,).

    They are searched beside the other effects where `far`, else without them: once for a record and a process. Of
    several segments the longest is searched.
    """
    at = longest_piece(model)
    piece = model.pieces[at]
    whole = as_held(piece)
    if not far:
        whole = Model(whole.loop, replace(whole.spec, effects=(name,)), s_max=whole.s_max, period_s=whole.period_s)
    small = thin_model(whole, thinning(whole))
    here = piece.named(model.of(at, values))
    # (the seeds of a search are fixed, so that no answer depends on what was asked before)
    question, memory = _question(small, name, here if far else {}), model.loop.memory
    known: FloatArray | None = memory.get(question)
    if known is None:
        before = evaluations.samples_spent()
        # (infinite where no residual is known of the model without the effect)
        left = np.full(piece.loop.samples, np.inf) if piece.context.residual is None else piece.context.residual
        known = _search_points(small, name, small.vector(here), left)
        evaluations.take_back(before)
        memory.keep(question, known)
    if not len(known):
        return np.empty((0, model.space.size))
    found = [{**here, **small.named(column)} for column in small.values(known).T]
    points = piece.cube(np.stack([piece.vector(named) for named in found], axis=1))
    return points if len(model.pieces) == 1 else lift_points(model, at, points)


def _question(model: Model, name: str, values: Mapping[str, float]) -> str:
    """A fingerprint of all inputs of a search."""
    context, spec = model.context, model.spec
    told = name, values, replace(spec, guides=()), model.step_s, model.period_s, model.s_max, context.record
    return fingerprint(told, context.command, context.process_value, model.good())


def _search_points(model: Model, name: str, values: FloatArray, without: FloatArray) -> FloatArray:
    """The best points of up to three searches; none where a model with residual `without` (n,) does better."""
    best, cost = np.empty((0, model.space.size)), np.inf
    for seed in range(_SEARCHES):
        points, first = _through_parts(model, name, values, without, np.random.default_rng(seed))
        if not len(points):
            break
        points = _scatter_points(model, name, points, np.random.default_rng(seed))
        now, before = float(model.costs(points[:1])[0]), cost
        if now < cost:
            best, cost = points, now
        if abs(now - before) <= _AGREE * before:
            break
        error = np.sqrt(cost / model.shared.rows)
        if error < _OUT_OF_STEP * first or cost > _PROMISING * _cost_of(model, without):
            break
    return best


def _cost_of(part: Model, without: FloatArray) -> float:
    """Squared error of a residual (n,) on a part of the record, in the form in which the part's model is fitted."""
    every = max(without.size // part.loop.samples, 1) if part.thinned else 1
    left = without[::every][:part.loop.samples]
    if not np.isfinite(left).all():
        return np.inf
    whole = part.filter_columns(left[:, None])[:, 0]
    return float(np.sum(part.weight[:whole.size] * whole**2))


def _through_parts(model: Model, name: str, values: FloatArray, without: FloatArray,
                   rng: np.random.Generator) -> tuple[FloatArray, float]:
    """The best points of the whole record, and the error that the first part left."""
    points, least = np.empty((0, model.space.size)), np.inf
    parts = growing_parts(model, _PERIODS, _GROWTH, _LEFT)
    for share, left in parts:
        part = beginning(model, int(np.ceil(share * model.loop.samples)))
        if not len(points):
            points = _scan_values(part, name, values, left, rng)
        found = refine(part.costs, points, rng, spread=spreads(part, _SPREAD), rounds=_ROUNDS, population=_POPULATION,
                       settle=_SETTLED)
        near = descend_model(part, found.points, turns=_TURNS)
        points = near.points[distinct_points(near.points, left, _NEAR)]
        least = min(least, float(np.sqrt(near.costs[0] / part.shared.rows)))
        long = part.loop.samples * part.step_s > _ENOUGH * part.period_s
        most = _PROMISING if share == parts[0][0] else 1.0 if long else np.inf
        if near.costs[0] > most * _cost_of(part, without):
            return points[:0], least
    return points, least


def _scatter_points(model: Model, name: str, points: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Points (k, d) after draws about the best of them, in ever smaller steps, each turn with a descent.

    S, J and the effect go up and down together in most of them: slips of a larger force come at the same times where a
    faster effect builds it up. No descent crosses the slips that come a sample early or late on the way.
    """
    rows = model.rows_of(name)
    for step in _STEPS:
        values = model.values(points[:_ABOUT]).repeat(_DRAWS, axis=1)
        draws = rng.standard_normal((len(values) + 1, values.shape[1]))
        # Steps of very different size, and the points themselves.
        draws *= step * np.minimum(1.0, np.abs(rng.standard_cauchy(values.shape[1])))
        draws[:, ::_DRAWS] = 0.0
        force, common = model.forces[longest_piece(model)], draws[-1]
        values[0] *= np.exp(draws[0] + 2.0 * common)
        values[1] *= np.exp(draws[0] + draws[1] + 3.0 * common)
        values[rows] *= np.exp(2.0 * common)
        values[3] *= np.exp(draws[3])
        values[4] += _LATE * model.period_s * draws[4]
        cube = model.cube(values)
        cube[:, force] += draws[force]
        cube[:, rows] += _OWN * draws[rows].T
        cube = np.clip(cube, 0.0, 1.0)
        costs = np.concatenate([model.costs(cube[a:a + _BLOCK]) for a in range(0, len(cube), _BLOCK)])
        cube = cube[np.argsort(costs, kind="stable")[:_DRAWS]]
        near = cube[distinct_points(cube, 3 * _ABOUT, _CLOSE)]
        points = descend_model(model, near, turns=_TURNS).points
    return points


def _scan_values(part: Model, name: str, values: FloatArray, left: int, rng: np.random.Generator) -> FloatArray:
    """The best distinct points of an even grid over the values that the effect proposes, each after a descent."""
    scan, rows = parse(name)[0].scan, part.rows_of(name)
    assert scan is not None
    asked = [0, 1, part.forces[0], 3, 4, *range(rows.start, rows.stop)]
    trial = values[:, None].repeat(_SCAN, axis=1)
    trial[asked] = scan((rng.random(len(asked)) + np.outer(np.arange(_SCAN), even_steps(len(asked)))).T % 1.0,
                        part.context)
    cube = np.clip(part.cube(trial), 0.0, 1.0)
    costs = np.concatenate([part.costs(cube[a:a + _BLOCK]) for a in range(0, _SCAN, _BLOCK)])
    cube = cube[np.argsort(costs, kind="stable")[:_SCAN // 4]]
    near = descend_model(part, cube[distinct_points(cube, _DESCENDED * left, _APART)], turns=_TURNS).points
    return near[distinct_points(near, left, _NEAR)]
