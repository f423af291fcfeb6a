"""Starting points of a search: basins on the ARX cost, process grids, swarms, growing records, equal-cost neighbours.

The ARX cost finds the basin in few dimensions: swarms over S, J and the initial residual force, for a ladder of delays.
Time constant and dead time follow from a grid. Source: docs/details.md, section 6.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from ...model.model import Model
from ...model.segments import Restarted
from ...numerics.population import refine, swarm
from ...typing import FloatArray
from ..points.arx_cost import Arx
from ..points.moves import (
    FORCES,
    as_held,
    beginning,
    descend_model,
    distinct_points,
    even_steps,
    first_apart,
    lift_points,
    longest_piece,
    neutral_point,
    spreads,
    thin_model,
    thinning,
    valve_grid,
    with_start,
)
from .continuation import SPARSE_PACE, delay_ladder, open_bank, open_costs

GROUPS = 3
# Basins are distinct that lie apart by these shares of the range in S or in J.
_DISTINCT = (0.015, 0.1)
_PARTICLES, _ROUNDS, _SCOUTS = 20, 12, 300
_ROAMERS, _ROAM_ROUNDS = 1, 25
# Valves of an even grid, and how many of them get a polish. Then the one lag in samples and the longest dead time in
# periods.
_SCAN, _SCAN_KEPT, _SCAN_LAG, _SCAN_DEAD = 20000, 96, 0.4, 0.25
# Shares of the record in a growing search, points polished on each, and periods in the shortest part.
_GROWTH, _GROWN_KEPT, _GROWN_PERIODS = (0.1, 0.2, 0.4, 0.7, 1.0), 16, 2.0
# The grid along the curve of equal cost: points and span in S (share), and dead time in samples either way. Then the
# slip jumps, as shares of S (None: the point's own).
_RIDGE_POINTS, _RIDGE_S, _RIDGE_SAMPLES = 161, 0.12, 5
_RIDGE_J = (None, 0.3, 0.9)
# Where a valve rests at every sample, each slip after the first waits for J, so J decides its time. Points in S and J,
# over the same span of S and this span of J (share).
_REST_S, _REST_J = 81, 1.0 + np.linspace(-0.2, 0.2, 21)
_RIDGE_KEPT = 6
# Initial residual forces tried for each segment there, where there are several.
_RIDGE_FORCES = np.linspace(-0.96, 0.96, 9)
# Grid of time constants and dead times for the process of a given valve, as shares of their ranges.
_GRID_T, _GRID_L = np.linspace(0.1, 0.9, 14), np.linspace(0.0, 0.95, 12)


def basins(model: Model, rng: np.random.Generator, *, groups: int = GROUPS) -> FloatArray:
    """Starting points (groups, d) from independent swarms on the ARX cost; each swarm's best, (S, J, force) only.

    A record with very many samples a period is thinned first: its one-step error is all noise. Several segments are
    searched one by one, since one unknown start is easier to find than four. The points that fit all segments best are
    kept. A command that moves between samples is taken as held, which has the same basins and a quarter of the rows.
    """
    model = as_held(model)
    if len(model.pieces) > 1:
        return _common_basins(model, rng, groups)
    found = swarm(_one_step_cost(model), 3, rng, groups=groups, particles=_PARTICLES, rounds=_ROUNDS,
                  scouts=_SCOUTS)
    # Distinct ones: a wrong basin must not fill all starts.
    picked = first_apart(range(len(found.points)), groups, lambda i, j: bool(
        np.any(np.abs(found.points[i, :2] - found.points[j, :2]) > _DISTINCT)))
    starts = neutral_point(model)[None].repeat(len(picked), axis=0)
    starts[:, :3] = found.points[picked]
    return starts


def _one_step_cost(model: Model) -> Callable[[FloatArray], FloatArray]:
    """The ARX cost (P,) of points (P, 3) of S, J and initial force in the unit cube, on the thinned record.

    Where PV is missing too often for a difference equation to hold from each PV to the next, the free run of a few lags
    together.
    """
    model = thin_model(model, thinning(model))
    neutral = neutral_point(model)[None, 3:]

    def values_of(cube: FloatArray) -> FloatArray:
        return model.values(np.concatenate([cube, neutral.repeat(len(cube), 0)], axis=1))

    if model.pace > SPARSE_PACE:
        bank = open_bank(model)
        return lambda cube: open_costs(model, bank, values_of(cube))
    arx = Arx(model, 2, tuple(delay_ladder(model)))
    return lambda cube: arx.costs(values_of(cube))[0]


def _common_basins(model: Model, rng: np.random.Generator, groups: int) -> FloatArray:
    """The starting points (groups, d) of all segments with the smallest one-step error over all of them.

    Each segment has the start that fits the valve best.
    """
    found = np.concatenate([basins(piece, rng, groups=groups)[:, :3] for piece in model.pieces])
    trial = found[:, None].repeat(FORCES.size, axis=1)
    trial[:, :, 2] = FORCES
    costs = np.stack([_one_step_cost(piece)(trial.reshape(-1, 3)).reshape(len(found), -1) for piece in model.pieces])
    order = np.argsort(costs.min(axis=2).sum(axis=0), kind="stable")
    order = order[distinct_points(found[order, :2], groups)]
    starts = neutral_point(model)[None].repeat(len(order), axis=0)
    starts[:, :2] = found[order, :2]
    starts[:, list(model.forces)] = FORCES[costs.argmin(axis=2)][:, order].T
    return starts


def with_process(model: Model, starts: FloatArray) -> FloatArray:
    """Starts (k, d) with the best time constant and dead time of a grid on the free-run cost, best start first."""
    out, costs = starts.copy(), np.empty(len(starts))
    for i, start in enumerate(starts):
        points, c = process_grid(model, start)
        out[i], costs[i] = points[c.argmin()], c.min()
    return out[np.argsort(costs, kind="stable")]


def process_grid(model: Model, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A point (d,) with every process of a grid of time constants, dead times and further lags, and the costs."""
    T, L = np.meshgrid(_GRID_T, _GRID_L, indexing="ij")
    grid = np.stack([T.ravel(), L.ravel()], axis=1)
    rows, guesses = _further_lag(model)
    points = start[None].repeat(len(grid) * len(guesses), 0)
    points[:, 3:5] = np.tile(grid, (len(guesses), 1))
    points[:, rows] = guesses.repeat(len(grid), axis=0)
    return points, model.costs_of(model.values(points), model.positions(model.values(start[None])))


def _further_lag(model: Model) -> tuple[slice, FloatArray]:
    """Columns of the unit cube and guesses (g, k) of the first effect with dynamics; one guess of nothing without one.
    """
    for effect, rows in zip(model.effects, model.effect_rows, strict=True):
        if effect.dynamics and effect.guess:
            values = np.array([p.neutral for p in model.space.parameters])[:, None].repeat(
                len(guesses := effect.guess(model.context)), axis=1)
            values[rows] = guesses.T
            return rows, model.cube(values)[:, rows]
    return slice(0, 0), np.empty((1, 0))


def along_ridge(model: Model, points: FloatArray) -> FloatArray:
    """Neighbours (m, d) of points (k, d) of about equal cost, best first: break-away later, dead time shorter, or back.

    Under a slow held command the two can hardly be told apart, so the cost has one local minimum for every sample of
    dead time. Each neighbour has the best S (and slip jump of a few) for its dead time; all deserve a polish.
    """
    dead = model.space.parameters[4]
    if dead.low == dead.high or "gain" in model.spec.fixed:
        return points[:0]
    found: list[tuple[float, FloatArray]] = []
    for point in points:
        values = model.values(point[None])[:, 0]
        S, J = _ridge_valves(model, values)
        grid = valve_grid(values, S, J)
        back = min(_RIDGE_SAMPLES, int((values[4] - dead.low) / model.step_s))
        grid[4] = values[4] - back * model.step_s
        shifted = (_all_shifted if len(model.pieces) == 1 else _shifted_pieces)(model, grid, back + _RIDGE_SAMPLES)
        for shift, costs in enumerate(shifted):
            if shift != back:
                neighbour = grid[:, int(costs.argmin())].copy()
                neighbour[4] += shift * model.step_s
                found.append((float(costs.min()), model.cube(neighbour[:, None])[0]))
    found.sort(key=lambda f: f[0])
    return np.array([f[1] for f in found[:_RIDGE_KEPT]]).reshape(-1, points.shape[1])


def _ridge_valves(model: Model, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The stickbands and slip jumps (m,) that are tried with every dead time near a point of values (d,)."""
    if model.law.one_parameter:
        S = values[0] * (1.0 + np.linspace(-_RIDGE_S, _RIDGE_S, _RIDGE_POINTS))
        return S, S
    if model.law.sliding_state is None:
        S = values[0] * (1.0 + np.linspace(-_RIDGE_S, _RIDGE_S, _REST_S))
        return S.repeat(_REST_J.size), np.minimum(np.tile(values[1] * _REST_J, S.size), 2.0 * S.repeat(_REST_J.size))
    S = np.tile(values[0] * (1.0 + np.linspace(-_RIDGE_S, _RIDGE_S, _RIDGE_POINTS)), len(_RIDGE_J))
    share = np.array([values[1] / max(values[0], 1e-12) if j is None else j for j in _RIDGE_J])
    return S, S * share.repeat(_RIDGE_POINTS)


def _all_shifted(model: Model, values: FloatArray, shifts: int) -> FloatArray:
    """Costs (shifts + 1, P) of candidates (d, P) with a dead time 0, 1, … samples longer."""
    shifts = min(shifts, model.skip)
    costs = np.empty((shifts + 1, values.shape[1]))
    for rows, part in model.blocks(values):
        base, offsets = model.responses(part, lent=True)
        for s in range(shifts + 1):
            # Rows before the record have weight 0: the first `skip` samples never count.
            costs[s, rows] = model.shared.costs(base, tuple(o - s for o in offsets))[:rows.stop - rows.start]
    return costs


def _shifted_pieces(model: Model, values: FloatArray, shifts: int) -> FloatArray:
    """The same for a model of several segments, each with the start that fits the candidate's valve best.

    A start that fits one break-away puts any other slip at the wrong sample right after it.
    """
    assert isinstance(model, Restarted)
    ladder = np.concatenate([[np.nan], _RIDGE_FORCES])
    rows = list(model.forces)
    trial = values[:, :, None].repeat(ladder.size, axis=2)
    trial[rows, :, 1:] = ladder[1:]
    shifts = min(shifts, model.skip)
    alone = model.piece_costs(trial.reshape(len(values), -1), shifts)
    return alone.reshape(shifts + 1, len(rows), values.shape[1], -1).min(axis=3).sum(axis=1)


def roam_free_run(model: Model, rng: np.random.Generator) -> FloatArray:
    """Starting points from swarms on the free-run cost itself, where drift or wrong dynamics mislead the ARX cost.

    The command is held, as in `basins`.
    """
    model = as_held(model)
    found = swarm(model.costs, model.space.size, rng, groups=_ROAMERS, particles=32, rounds=_ROAM_ROUNDS,
                  scouts=_SCOUTS)
    return found.points[distinct_points(found.points[:, :2], _ROAMERS)]


def grow_starts(model: Model, rng: np.random.Generator) -> FloatArray:
    """Starting points (k, d) for records whose ARX cost is all noise: a grid on a tenth, polished on longer parts.

    An integrator adds up its slips. On a whole record its basin is as narrow as one slip in a wrong sample (0.2 % of S
    after 80 slips). Swarms miss it. On a tenth it is ten times as wide. An even grid of valves with every dead time
    finds it there, and each longer part polishes the points of the shorter one. On a Karnopp valve of itptd, held, at 1
    % noise, 28 of 32 seeds find it. Of several segments the longest is used.
    """
    if len(model.pieces) > 1:
        at = longest_piece(model)
        return lift_points(model, at, grow_starts(model.pieces[at], rng))
    points, kept = np.empty((0, model.space.size)), _GROWN_KEPT
    for share in _GROWTH:
        least = model.skip + int(_GROWN_PERIODS * model.period_s / model.step_s)
        part = beginning(model, max(int(share * model.loop.samples), least))
        known = with_start(part, points) if len(points) else _scan(part, rng)
        near = descend_model(part, known, turns=6).points[:kept]
        last = refine(part.costs, near, rng, spread=spreads(part, 0.4), rounds=30, population=14, settle=1e-3)
        points = np.concatenate([last.points, near])
        points = points[distinct_points(points[:, :2], 2 * kept, 0.004)]
    return points[:kept // 2]


def _scan(model: Model, rng: np.random.Generator) -> FloatArray:
    """The best distinct points (k, d) of an even grid of the valve, the best dead time with each."""
    points = neutral_point(model)[None].repeat(_SCAN, axis=0)
    # S, J and the start, and what an effect does to the friction: where it vanishes there is no such valve to find.
    scanned = [0, 1, 2, *(i for effect, rows in zip(model.effects, model.effect_rows, strict=True)
                          if effect.friction is not None
                          for i in range(rows.start, rows.stop))]
    points[:, scanned] = (rng.random(len(scanned)) + np.outer(np.arange(_SCAN), even_steps(len(scanned)))) % 1.0
    values = model.values(points)
    lag, dead = model.space.parameters[3:5]
    # A lag delays, too: a short one and half samples of dead time stand for all.
    values[3] = np.clip(_SCAN_LAG * model.step_s, lag.low, lag.high)
    values[4] = np.minimum(dead.low + 0.5 * model.step_s * (np.arange(_SCAN) % 2), dead.high)
    costs = _all_shifted(model, values, int(min(dead.high - dead.low, _SCAN_DEAD * model.period_s) / model.step_s))
    order = np.argsort(costs.min(axis=0), kind="stable")[:_SCAN // 8]
    values[4] += costs.argmin(axis=0) * model.step_s
    cube = model.cube(values[:, order])
    return cube[distinct_points(cube[:, :2], _SCAN_KEPT)]


def with_other_start(model: Model, point: FloatArray, count: int = 3) -> FloatArray:
    """The best few (count, d) of point (d,) with another residual force and a process that fits it.

    A wrong start bends the slow process until both fit together, and neither can leave alone.
    """
    values = model.values(point[None])[:, 0]
    T = values[3] * np.geomspace(0.6, 1.7, 9)
    L = values[4] + model.step_s * np.arange(-3.0, 4.0)
    grid = np.stack([g.ravel() for g in np.meshgrid(T, L, indexing="ij")])
    axes = model.space.parameters
    grid = np.clip(grid, [[axes[3].low], [axes[4].low]], [[axes[3].high], [axes[4].high]])
    found: list[tuple[float, FloatArray]] = []
    for row, force in product(model.forces, np.linspace(-0.95, 0.95, 9)):
        trial = values[:, None].repeat(grid.shape[1], axis=1)
        trial[row], trial[3:5] = force, grid
        costs = model.costs_of(trial, model.positions(trial[:, :1]))
        found.append((float(costs.min()), trial[:, int(costs.argmin())]))
    found.sort(key=lambda f: f[0])
    return model.cube(np.stack([f[1] for f in found[:count]], axis=1))
