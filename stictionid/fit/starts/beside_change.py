"""Starts for friction that changes once: valve and process of a part of the record before the change, or behind it.

A model of the whole record has one valve, which fits neither side, and a process bent by it. Each end of the record is
an ordinary record of one valve unless the change lies in it. Wrong where the change lies in both ends, that is where
friction changes more than once. Source: docs/details.md, sections 6.3 and 11.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.model import Model
from ...model.segments import bind_model
from ...model.spec import BASE
from ...numerics.population import join_found
from ...typing import FloatArray
from ..points.fitted import Fitted
from ..points.moves import cheapest_apart, descend_model, longest_piece, valve_grid, with_start
from .basins import with_process
from .beside_effect import take_out_disturbances
from .continuation import grown_valves

# Part of the record at either end, its least length in periods, and the valves of each that become starts.
_PART, _PERIODS, _VALVES = 0.4, 2.0, 3
# Turns and fall of the cost of the descent of these valves.
_TURNS, _STILL = 6, 1e-3
# A grid of every valve after a change: shares of S_max, J as shares of S, and the least distance of those kept in S.
_AFTER_S, _AFTER_J, _APART = np.geomspace(0.01, 1.2, 80), np.linspace(0.0, 1.2, 9), 0.1
# Name of the initial forces, which a later part of the record does not know.
_FORCE = BASE[2]


def valves_of_ends(model: Model, name: str, guesses: FloatArray, fit: Fitted, rng: np.random.Generator) -> FloatArray:
    """Starts (k, d) of a model with effect `name`: valves of both ends of the record, each with its best guess.

    `fit` is one without the effect. `guesses` (g, 3) are changes of S and J, and times. Ends shorter than two periods
    give none.
    """
    plain = take_out_disturbances(fit.model, fit.model, fit.values)
    whole = plain.pieces[longest_piece(plain)].loop
    length, here = int(_PART * whole.samples), fit.best.values
    if length * whole.step_s < _PERIODS * plain.period_s:
        return np.empty((0, model.space.size))
    starts = []
    for behind, end in enumerate((whole.cut(0, length), whole.cut(whole.samples - length, whole.samples))):
        part = bind_model(end, replace(plain.spec, paths=None), s_max=plain.s_max, period_s=plain.period_s)
        known = part.vector(here)
        points = with_start(part, grown_valves(part, (), rng, known)[:_VALVES])
        found = join_found(*(descend_model(part, p, turns=_TURNS, settle=_STILL)
                             for p in (points, with_process(part, points))))
        for column in part.values(found.points[:_VALVES]).T:
            named = part.named(column)
            vector = model.vector({**here, **named, **{n: here[n] for n in here if n.startswith(_FORCE)}})
            trial = vector[:, None].repeat(len(guesses), axis=1)
            trial[model.rows_of(name)] = guesses.T
            trial[:2] += (1 - behind) * guesses.T[:2]
            cube = model.cube(trial)[(trial[0] > 0.0) & (trial[1] >= 0.0)]
            starts += list(cube[np.argsort(model.costs(cube), kind="stable")[:1]])
    return np.array(starts).reshape(-1, model.space.size)


def valves_after(model: Model, point: FloatArray, name: str, count: int) -> FloatArray:
    """The best few points (count, d) with another valve after the change of effect `name`, all else as in a point (d,).

    A small valve after a large one has a narrow basin: a step of the population leaps over it.
    """
    values = model.values(point[None])[:, 0]
    S, share = (g.ravel() for g in np.meshgrid(model.s_max * _AFTER_S, _AFTER_J, indexing="ij"))
    trial = valve_grid(values, S, S * share)
    rows = model.rows_of(name)
    before = values[:2] - values[rows][:2]
    trial[rows.start:rows.start + 2] = trial[:2] - before[:, None]
    cube = np.clip(model.cube(trial), 0.0, 1.0)
    return cheapest_apart(model, cube, np.log(S)[:, None], count, _APART)
