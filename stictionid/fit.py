"""Fitting one model to one record: basin by ARX, finish by free run, restarts, hold-out, intervals.

The ARX cost finds the basin in few dimensions (swarms over S, J and the initial residual force, for a ladder of
delays); time constant and dead time follow from a grid; the free-run cost finishes all starts side by side by
covariance matrix adaptation. Whether the restarts agree is part of the answer.
Source: METHODS.md section 4, traps 1 to 5; CRITICISM.md sections 5 and 7.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from .arx import Arx
from .descent import descend, normals_at, principal
from .folds import best_of_fold
from .loop import BoolArray, FloatArray, Loop
from .model import Model
from .restarts import bound
from .search import Found, refine, swarm
from .spec import BASE, Evaluated

GROUPS = 3
_PARTICLES, _ROUNDS, _SCOUTS = 20, 12, 300
_DELAYS = 6
_VALLEY_ROUNDS = 150
# Samples a period on which a search from nothing is made; records with twice as many are thinned for it.
_SEARCH_SAMPLES = 60
_COARSE_SUBSTEPS, _MOST_RUNS, _RIDGE_TURNS = 4, 4, 3
_ROAMERS, _ROAM_ROUNDS = 1, 25
# Valves of an even scan, how many get a polish, the lag in samples that stands for all, the longest dead time in
# periods, and the steps of the sequence (powers of the root of x^4 = x + 1).
_SCAN, _SCAN_KEPT, _SCAN_LAG, _SCAN_DEAD = 20000, 96, 0.4, 0.25
_EVEN = 1.2207440846057596 ** -np.arange(1.0, 4.0)
# Shares of the record that a search grows through, how many points each polishes, and periods of the shortest part.
_GROWTH, _GROWN_KEPT, _GROWN_PERIODS = (0.1, 0.2, 0.4, 0.7, 1.0), 16, 2.0
# The scan along the ridge: points and span in S (share), dead time in samples either way, and slip jumps tried as
# shares of S (None: the point's own).
_RIDGE_POINTS, _RIDGE_S, _RIDGE_SAMPLES = 161, 0.12, 5
_RIDGE_J = (None, 0.3, 0.9)
_RIDGE_KEPT = 6
# Initial residual forces tried for each segment there, where there are several.
_RIDGE_FORCES = np.linspace(-0.96, 0.96, 9)
# First differences of a descent, as a share of the range.
_DIFFERENCE = 1e-3
# Turns of descent that tell which of the points beside the best deserve a population, and how many get one.
_GLANCE, _KEPT = 3, 3
# A polish has settled when its cost falls by less than this share in a dozen rounds. Unit: 1.
_SETTLED = 1e-4
# Points closer than this in S and J (share of the range) need only one last polish.
_SAME_POINT = 2e-3
# Two restarts agree when S differs by at most this share and J by at most this share of S (CRITICISM.md section 7).
AGREE_S, AGREE_J = 0.01, 0.05
# Their costs must agree as well: -2 ln LR, or a share of the cost where the record is noise-free.
_AGREE_COST, _AGREE_SIGNAL = 0.05, 0.002
HOLDOUT_BLOCKS = 5
# Costs that differ by less than this share are those of one valve path; where the path ends is looked for on a ladder.
_SAME_PATH = 1e-9
_PLATEAU_LADDER = np.geomspace(1e-6, 0.05, 30)
# Difference for the slopes behind the rays, and how far along them is looked, as shares of the range.
_RAY_DIFFERENCE, _RAY_LADDER = 1e-4, np.geomspace(1e-5, 0.5, 26)
# Longest scan of a usual DCS in seconds; and share of a move of the command to which its rebuilding is exact at slips
# (benchmarks/verdicts.py, seeds below 1000).
_SLOWEST_SCAN_S, _REBUILT = 2.0, 0.35
# Slip jumps (distance as shares of S) and break-aways (factors of S) tried for the interval of J.
_JUMPS = np.array([0.01, 0.02, 0.035, 0.055, 0.08, 0.12, 0.17, 0.25, 0.4])
_BREAKS = 1.0 + np.array([-0.008, -0.004, -0.002, -0.001, -0.0005, 0.0, 0.0005, 0.001, 0.002, 0.004, 0.008])
_BREAKS_KEPT = 3
# Grid of time constants and dead times for the process of a given valve, as shares of their ranges.
_GRID_T, _GRID_L = np.linspace(0.1, 0.9, 14), np.linspace(0.0, 0.95, 12)
# Ladders of initial residual forces, as shares of their range: for points that deserve it, and to choose those.
# Where there are several segments each force is less known than one: neighbours of what it is are tried, too.
_NEAR_FORCES = np.array([-0.03, -0.015, -0.007, -0.003, 0.003, 0.007, 0.015, 0.03])
_FORCES, _ROUGH_FORCES = np.linspace(0.01, 0.99, 33), np.linspace(0.05, 0.95, 7)
# Neighbouring minima of a command rebuilt between samples, in parts of a sample of dead time, and how often to look.
_BESIDE, _BESIDE_TURNS = (-8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0), 4
# Size of the cloud around the optimum from which folds and intervals choose.
_CLOUD = 120
# Likelihood-ratio threshold for a 90 % interval of a threshold parameter (Hansen 2000; CRITICISM.md section 5).
INTERVAL_THRESHOLD = 5.94
INTERVAL_LEVEL = 0.90

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Fitted:
    """The best values (d,) of a model, how the restarts agreed, and what else is needed for a step of a study."""

    model: Model
    values: FloatArray
    sse: float
    runs: int
    agree: int
    best: Evaluated
    rmse_holdout: float | None
    intervals: dict[str, tuple[float, float]]
    searched: FloatArray
    # Values (d, k) with other slip jumps that a wider model's intervals start from.
    jumps: FloatArray | None = None


def basins(model: Model, rng: np.random.Generator, *, groups: int = GROUPS) -> FloatArray:
    """Starting points (groups, d) from independent swarms on the ARX cost; each swarm's best, (S, J, force) only.

    A record with very many samples a period is thinned first: its one-step error is all noise. Several segments are
    searched one by one, since one unknown start is easier to find than four, and what fits all of them best is kept.
    """
    if len(model.pieces) > 1:
        return _common_basins(model, rng, groups)
    found = swarm(_one_step_cost(model), 3, rng, groups=groups, particles=_PARTICLES, rounds=_ROUNDS,
                  scouts=_SCOUTS)
    picked: list[FloatArray] = []
    for point in found.points:  # distinct ones first: a wrong basin must not fill all starts
        if all(abs(point[0] - q[0]) > 0.015 or abs(point[1] - q[1]) > 0.1 for q in picked):
            picked.append(point)
        if len(picked) == groups:
            break
    starts = _neutral(model)[None].repeat(len(picked), axis=0)
    starts[:, :3] = picked
    return starts


def _one_step_cost(model: Model) -> Callable[[FloatArray], FloatArray]:
    """The ARX cost (P,) of points (P, 3) of S, J and initial force in the unit cube, on the record thinned."""
    model = thinned(model, _every(model))
    period = model.period_s / model.step_s
    longest = int(np.clip(0.4 * period, 1, 60))
    ladder = np.unique(np.round(np.geomspace(1, longest + 1, _DELAYS) - 1).astype(int))
    arx = Arx(model, 2, tuple(int(d) for d in ladder))
    neutral = _neutral(model)[None, 3:]

    def cost(cube: FloatArray) -> FloatArray:
        return arx.costs(model.values(np.concatenate([cube, neutral.repeat(len(cube), 0)], axis=1)))[0]

    return cost


def _common_basins(model: Model, rng: np.random.Generator, groups: int) -> FloatArray:
    """The starting points (groups, d) among those of all segments whose one-step error is the smallest in all of them.

    Each segment with the start that goes best with the valve.
    """
    found = np.concatenate([basins(piece, rng, groups=groups)[:, :3] for piece in model.pieces])
    trial = found[:, None].repeat(_FORCES.size, axis=1)
    trial[:, :, 2] = _FORCES
    costs = np.stack([_one_step_cost(piece)(trial.reshape(-1, 3)).reshape(len(found), -1) for piece in model.pieces])
    order = np.argsort(costs.min(axis=2).sum(axis=0), kind="stable")
    order = order[_first_distinct(found[order], groups)]
    starts = _neutral(model)[None].repeat(len(order), axis=0)
    starts[:, :2] = found[order, :2]
    starts[:, list(model.forces)] = _FORCES[costs.argmin(axis=2)][:, order].T
    return starts


def longest_piece(model: Model) -> int:
    """Which segment of a model has the most samples that count."""
    return int(np.argmax([float(piece.weight.sum()) for piece in model.pieces]))


def _neutral(model: Model) -> FloatArray:
    """Neutral point (d,) of the unit cube; process parameters in the middle."""
    names = model.space.names
    values = np.array([p.neutral for p in model.space.parameters])
    cube = np.empty(len(names))
    for i, p in enumerate(model.space.parameters):
        span = (np.log(p.high / p.low) if p.log else p.high - p.low) if p.high > p.low else 0.0
        if i in (3, 4) or not span:
            cube[i] = 0.5
        else:
            cube[i] = np.clip((np.log(max(values[i], p.low) / p.low) if p.log else values[i] - p.low) / span, 0, 1)
    return cube


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
    further = _further_lags(model)
    points = start[None].repeat(len(grid) * (len(further[0][1]) if further else 1), 0)
    points[:, 3:5] = np.tile(grid, (len(points) // len(grid), 1))
    for rows, guesses in further[:1]:
        points[:, rows] = guesses.repeat(len(grid), axis=0)
    return points, model.costs_of(model.values(points), model.positions(model.values(start[None])))


def _further_lags(model: Model) -> list[tuple[slice, FloatArray]]:
    """Columns of the unit cube and guesses (g, k) of every effect that adds dynamics: they join the process's grid."""
    found = []
    for effect, rows in zip(model.effects, model._slices, strict=True):
        if effect.dynamics and effect.guess:
            values = np.array([p.neutral for p in model.space.parameters])[:, None].repeat(
                len(guesses := effect.guess(model.context)), axis=1)
            values[rows] = guesses.T
            found.append((rows, model.cube(values)[:, rows]))
    return found


def with_start(model: Model, points: FloatArray) -> FloatArray:
    """Points (k, d) with the best initial residual force of a ladder: the force decides basins of its own."""
    return _first_force(model, points, _FORCES)[0]


def _first_force(model: Model, points: FloatArray, ladder: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (k, d) with the best initial residual force of a ladder, their own included, and their costs (k,).

    Of several segments each takes its own best, found as if it were alone.
    """
    if len(model.pieces) == 1:
        trial = points[:, None, :].repeat(ladder.size + 1, axis=1)
        trial[:, 1:, model.forces[0]] = ladder
        c = model.costs(trial.reshape(-1, points.shape[1])).reshape(len(points), -1)
        return trial[np.arange(len(points)), c.argmin(axis=1)], c.min(axis=1)
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


def along_ridge(model: Model, points: FloatArray) -> FloatArray:
    """Neighbours (m, d) of points (k, d) along their ridge, best first: break-away later, dead time shorter, or back.

    Under a slow held command the two can hardly be told apart, so the cost has one local minimum for every sample of
    dead time. Each neighbour has the best S (and slip jump of a few) for its dead time; all deserve a polish.
    """
    dead = model.space.parameters[4]
    if dead.low == dead.high or "gain" in model.spec.fixed:
        return points[:0]
    found: list[tuple[float, FloatArray]] = []
    for point in points:
        values = model.values(point[None])[:, 0]
        S = values[0] * (1.0 + np.linspace(-_RIDGE_S, _RIDGE_S, _RIDGE_POINTS))
        grid = values[:, None].repeat(S.size * len(_RIDGE_J), axis=1)
        grid[0] = np.tile(S, len(_RIDGE_J))
        share = np.array([values[1] / max(values[0], 1e-12) if j is None else j for j in _RIDGE_J])
        grid[1] = grid[0] * (1.0 if model.law.one_parameter else share.repeat(S.size))
        back = min(_RIDGE_SAMPLES, int((values[4] - dead.low) / model.step_s))
        grid[4] = values[4] - back * model.step_s
        looks = _shifted_costs(model, grid, back + _RIDGE_SAMPLES) if len(model.pieces) == 1 else \
            _shifted_pieces(model, grid, back + _RIDGE_SAMPLES)
        for shift, (cost, at) in enumerate(looks):
            if shift != back:
                neighbour = grid[:, at].copy()
                neighbour[4] += shift * model.step_s
                found.append((cost, model.cube(neighbour[:, None])[0]))
    found.sort(key=lambda f: f[0])
    return np.array([f[1] for f in found[:_RIDGE_KEPT]]).reshape(-1, points.shape[1])


def _shifted_costs(model: Model, values: FloatArray, shifts: int) -> list[tuple[float, int]]:
    """For a dead time 0, 1, … samples longer: the smallest cost over the candidates (d, P), and which one it is."""
    return [(float(c.min()), int(c.argmin())) for c in _all_shifted(model, values, shifts)]


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


def _shifted_pieces(model: Model, values: FloatArray, shifts: int) -> list[tuple[float, int]]:
    """The same for a model of several segments, each with the start that goes best with the candidate's valve.

    A start that goes with one break-away makes any other slip at the wrong sample right after it.
    """
    ladder = np.concatenate([[np.nan], _RIDGE_FORCES])
    rows = list(model.forces)
    trial = values[:, :, None].repeat(ladder.size, axis=2)
    trial[rows, :, 1:] = ladder[1:]
    shifts = min(shifts, model.skip)
    alone = model.piece_costs(trial.reshape(len(values), -1), shifts)
    costs = alone.reshape(shifts + 1, len(rows), values.shape[1], -1).min(axis=3).sum(axis=1)
    return [(float(c.min()), int(c.argmin())) for c in costs]


def roamed(model: Model, rng: np.random.Generator) -> FloatArray:
    """Starting points from swarms on the free-run cost itself, where drift or wrong dynamics mislead the ARX cost."""
    found = swarm(model.costs, model.space.size, rng, groups=_ROAMERS, particles=32, rounds=_ROAM_ROUNDS,
                  scouts=_SCOUTS)
    return found.points[_first_distinct(found.points, _ROAMERS)]


def grown(model: Model, rng: np.random.Generator) -> FloatArray:
    """Starting points (k, d) for records whose ARX cost is all noise, from a scan of a tenth that grows to the whole.

    An integrator adds up its slips, so that on a whole record the basin is as narrow as one slip in a wrong sample
    (0.2 % of S after 80 slips) and swarms walk past it. On a tenth it is ten times as wide: an even scan of valves with
    every dead time finds it, and each longer part polishes what the shorter one left. On a Karnopp valve of
    itptd, held, at 1 % noise, 28 of 32 seeds find it. Of several segments the longest grows.
    """
    if len(model.pieces) > 1:
        at = longest_piece(model)
        return _lifted(model, at, grown(model.pieces[at], rng))
    points, kept = np.empty((0, model.space.size)), _GROWN_KEPT
    for share in _GROWTH:
        least = model.skip + int(_GROWN_PERIODS * model.period_s / model.step_s)
        part = _beginning(model, max(int(share * model.loop.samples), least))
        near = descended(part, with_start(part, points) if len(points) else _scan(part, rng), turns=6).points[:kept]
        last = refine(part.costs, near, rng, spread=spreads(part, 0.4), rounds=30, population=14, settle=1e-3)
        points = np.concatenate([last.points, near])
        points = points[_first_distinct(points, 2 * kept, 0.004)]
    return points[:kept // 2]


def _lifted(model: Model, at: int, points: FloatArray) -> FloatArray:
    """Points (k, d) of one segment's model as points of all, the other segments' starts neutral."""
    values = model.values(_neutral(model)[None]).repeat(len(points), axis=1)
    values[[0, 1, model.forces[at], 3, 4, *range(model.head, len(values))]] = model.pieces[at].values(points)
    return model.cube(values)


def _scan(model: Model, rng: np.random.Generator) -> FloatArray:
    """The best distinct points (k, d) of an even scan of the valve, the best dead time with each."""
    points = _neutral(model)[None].repeat(_SCAN, axis=0)
    points[:, :3] = (rng.random(3) + np.outer(np.arange(_SCAN), _EVEN)) % 1.0
    values = model.values(points)
    lag, dead = model.space.parameters[3:5]
    # A lag delays, too: a short one and half samples of dead time stand for all.
    values[3] = np.clip(_SCAN_LAG * model.step_s, lag.low, lag.high)
    values[4] = np.minimum(dead.low + 0.5 * model.step_s * (np.arange(_SCAN) % 2), dead.high)
    costs = _all_shifted(model, values, int(min(dead.high - dead.low, _SCAN_DEAD * model.period_s) / model.step_s))
    order = np.argsort(costs.min(axis=0), kind="stable")[:_SCAN // 8]
    values[4] += costs.argmin(axis=0) * model.step_s
    cube = model.cube(values[:, order])
    return cube[_first_distinct(cube, _SCAN_KEPT)]


def _beginning(model: Model, rows: int) -> Model:
    """The same model on the first rows of its record."""
    loop = model.loop
    if rows >= loop.samples:
        return model
    return Model(loop.cut(0, rows), model.spec, s_max=model.s_max, period_s=model.period_s,
                 residual=None if model.context.residual is None else model.context.residual[:rows],
                 record=model.context.record)


def _first_distinct(points: FloatArray, count: int, apart: float = 0.02) -> list[int]:
    kept: list[int] = []
    for i, point in enumerate(points):
        if all(np.abs(point[:2] - points[j, :2]).max() > apart for j in kept):
            kept.append(i)
        if len(kept) == count:
            break
    return kept


def with_other_start(model: Model, point: FloatArray, count: int = 3) -> FloatArray:
    """The best few (count, d) of point (d,) with another residual force and a process that goes with it.

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


def spreads(model: Model, factor: float = 1.0) -> FloatArray:
    """First standard deviations of a polish, as shares of the ranges (d,)."""
    base = np.array([0.01, 0.05, 0.1, 0.03, 0.03])
    further = np.full(model.head - len(BASE), base[2])
    return factor * np.concatenate([base, further, np.full(model.space.size - model.head, 0.05)])


def search(model: Model, rng: np.random.Generator, *, starts: FloatArray | None = None,
           before: tuple[FloatArray, FloatArray] | None = None) -> tuple[FloatArray, FloatArray]:
    """Independent runs until two agree, four at the most: their best points (k, d) and costs (k,), best first.

    `before` are runs that were made already.
    """
    coarse = search_model(model)
    points, costs = before or (np.empty((0, model.space.size)), np.empty(0))
    while len(costs) < _MOST_RUNS and not (len(costs) >= 2 and agreement(coarse, points, costs) >= 2):
        point, cost = one_run(coarse, rng, starts)
        points, costs = np.concatenate([points, point[None]]), np.append(costs, cost)
        order = np.argsort(costs, kind="stable")
        points, costs = points[order], costs[order]
    return points, costs


def search_model(model: Model) -> Model:
    """The model to search on: a command that moves between samples is searched on a coarser grid than finished on."""
    if model.spec.substeps <= _COARSE_SUBSTEPS or model.spec.held:
        return model
    return bound(model.loop, replace(model.spec, substeps=_COARSE_SUBSTEPS), s_max=model.s_max,
                 period_s=model.period_s, residual=model.context.residual)


def one_run(model: Model, rng: np.random.Generator, starts: FloatArray | None = None,
            near: FloatArray | None = None) -> tuple[FloatArray, float]:
    """One search from nothing (or from given starts): best point (d,) and cost. `near` are basins that are known.

    A record with very many samples a period is searched thinned first: its ridge is too long to walk sample by
    sample, and the thinned one is short.
    """
    moving = not model.spec.held
    every = _every(model)
    if starts is None and every > 1:
        small = thinned(model, every)
        point, _ = one_run(small, rng, near=near)
        starts = model.cube(small.values(point[None]).repeat(3, axis=1)
                            + np.outer(np.arange(model.space.size) == 4, 0.5 * every * model.step_s * np.arange(-1, 2)))
    elif starts is None:
        near = basins(model, rng) if near is None else near
        starts = np.concatenate([with_process(model, near),
                                 grown(model, rng) if model.spec.taps else roamed(model, rng)])
    found = refine(model.costs, with_start(model, starts), rng, spread=spreads(model), rounds=12 if moving else 35,
                   population=14, settle=_SETTLED)
    points = found.points
    for _ in range(0 if moving else _RIDGE_TURNS):
        near = np.concatenate([with_start(model, np.concatenate([points[:2], along_ridge(model, points[:2])])),
                               with_other_start(model, points[0])])
        near = descended(model, near, turns=_GLANCE).points[:_KEPT]
        last = refine(model.costs, near, rng, spread=spreads(model, 0.4), rounds=45, population=14, settle=_SETTLED)
        dead = model.values(np.stack([points[0], last.points[0]]))[4]
        points = last.points
        if abs(dead[1] - dead[0]) < 0.5 * model.step_s:
            break
    if moving:
        # Where the command moves between samples the ridge is a smooth, narrow valley: walk along it.
        points = descended(model, with_start(model, points), turns=6, settle=1e-2).points
        near = np.concatenate([with_start(model, points[:2]), with_other_start(model, points[0], 1)])
        found = descended(model, near)
        return found.points[0], float(found.costs[0])
    return polish_smooth(model, with_start(model, points[:1])[0])


def _every(model: Model) -> int:
    """One sample in how many a search from nothing needs."""
    return int(model.period_s / model.step_s / _SEARCH_SAMPLES)


def thinned(model: Model, every: int) -> Model:
    """The same model on every so many samples: y is averaged around them, the valve still sees every command.

    The one-step error of a record sampled much faster than its dynamics is all noise; thinned, it shows the valve.
    """
    if every <= 1:
        return model
    if len(model.pieces) > 1:
        return _thinned_segments(model, every)
    loop = model.loop
    half = every // 2
    part = slice(half, loop.samples - half, every)
    window = np.ones(2 * half + 1) / (2 * half + 1)
    y = np.convolve(model.context.process_value, window, "same")[part]
    m = model.spec.substeps
    command = model.context.command[half * m:]
    residual = model.context.residual
    small = Loop(output=loop.output[part], process_value=y,
                 setpoint=None if loop.setpoint is None else loop.setpoint[part],
                 used=(np.convolve(model.good(), window, "same") > 0.999)[part],
                 extras={tag: x[part] for tag, x in loop.extras.items()}, step_s=loop.step_s * every, units=loop.units)
    rows = small.samples * every * m
    command = np.concatenate([command[:rows], np.full(max(rows - command.size, 0), command[-1])])
    return bound(small, replace(model.spec, substeps=every * m), s_max=model.s_max, period_s=model.period_s,
                 residual=None if residual is None else residual[part], command=command, record=model.context.record)


def _thinned_segments(model: Model, every: int) -> Model:
    """The model of several segments, each thinned on its own."""
    parts = [thinned(piece, every) for piece in model.pieces]
    clock = model.loop.clock_s
    small = Loop.joined([part.loop for part in parts],
                        begins_s=tuple(float(clock[first]) for first in model.loop.starts))
    residual = None if model.context.residual is None else np.concatenate([p.context.residual for p in parts])
    return bound(small, parts[0].spec, s_max=model.s_max, period_s=model.period_s, residual=residual,
                 command=np.concatenate([part.context.command for part in parts]))


def middle_of_plateau(model: Model, point: FloatArray) -> FloatArray:
    """Point (d,) moved to the middle of the break-away forces that give the very same valve path.

    A held command jumps over every force between two of its values, so that a range of f_s, with f_d and e(0) as they
    are, explains the record equally well; its middle is the answer with the smallest error to expect.
    """
    if model.law.one_parameter or not movable(model)[:3].all():
        return point
    values, forces = model.values(point[None])[:, 0], list(model.forces)
    fs = 0.5 * (values[0] + values[1])
    cost = float(model.costs(point[None])[0])
    same = cost * (1.0 + _SAME_PATH) + _SAME_PATH * _SAME_PATH * model.shared.target_energy

    def alike(moves: FloatArray) -> NDArray[np.bool_]:
        trial = values[:, None].repeat(moves.size, axis=1)
        trial[0] += moves
        trial[1] += moves
        trial[forces] *= fs / (fs + moves)
        inside = ((np.abs(trial[forces]) <= 1.0).all(axis=0) & (trial[1] >= 0.0) & (trial[1] <= 2.0 * trial[0])
                  & (trial[0] <= model.space.parameters[0].high))
        trial[:, ~inside] = values[:, None]
        return (model.costs_of(trial) <= same) & inside

    ends = []
    for sign in (-1.0, 1.0):
        ladder = fs * _PLATEAU_LADDER
        low, high = 0.0, float(ladder[-1])
        for _ in range(2):
            flat = alike(sign * ladder)
            first = int(np.argmin(flat)) if not flat.all() else ladder.size - 1
            low, high = (float(ladder[first - 1]) if first else low), float(ladder[first])
            ladder = np.linspace(low, high, ladder.size + 1)[1:]
        ends.append(sign * low)
    move = 0.5 * (ends[0] + ends[1])
    moved = values.copy()
    moved[:2] += move
    moved[forces] *= fs / (fs + move)
    found = model.cube(moved[:, None])[0]
    return found if float(model.costs(found[None])[0]) <= same else point


def descended(model: Model, starts: FloatArray, *, held: tuple[int, ...] = (), turns: int = 20,
              settle: float = 1e-5) -> Found:
    """Starts (k, d) of a model polished by descent, in all numbers that may move but those `held`; best first."""
    spread = _DIFFERENCE * movable(model)
    spread[list(held)] = 0.0
    return descend(model.residuals, model.costs, starts, spread=spread, turns=turns, settle=settle)


def movable(model: Model) -> FloatArray:
    """1 for parameters that may move, 0 for those that are fixed (d,)."""
    return np.array([float(p.high > p.low) for p in model.space.parameters])


def polish_smooth(model: Model, point: FloatArray) -> tuple[FloatArray, float]:
    """Point (d,) polished with the break-away as it is: S has a plateau narrower than anything else, and holding it
    lets J, the process and the effects settle in a smooth cost."""
    found = descended(model, point[None], held=(0, *model.forces))
    return found.points[0], float(found.costs[0])


def finish(model: Model, points: FloatArray, costs: FloatArray, rng: np.random.Generator, *,
           rounds: int = 200, holdout: bool = True) -> Fitted:
    """The last polish of the best points, with errors, hold-out and intervals."""
    values = model.values(points)
    near = with_start(model, _distinct(points)[:3])
    if not model.spec.held:
        found = _beside(model, descended(model, near, turns=40))
    else:
        found = refine(model.costs, near, rng, spread=spreads(model, 0.15), rounds=rounds, population=18,
                       settle=_SETTLED)
    top, best_cost = polish_smooth(model, found.points[0])
    agree = agreement(model, points, costs)
    jumps = _jump_profile(model, top)
    cube, cost = _cloud(model, top, rng, jumps)
    if cost.min() < best_cost:
        top, best_cost = cube[cost.argmin()], float(cost.min())
    if model.spec.held:
        top = middle_of_plateau(model, top)
        best_cost = float(model.costs(top[None])[0])
        cube, cost = np.concatenate([top[None], cube]), np.append(best_cost, cost)
    best_values = model.values(top[None])[:, 0]
    best = model.evaluate(best_values)
    held = _holdout(model, best, cube[np.argsort(cost, kind="stable")[:_CLOUD // 2]]) if holdout else None
    return Fitted(model, best_values, best_cost, len(points), agree, best, held,
                  _intervals(model, cube, cost, best_cost, best), values[:2].T, model.values(jumps))


def _beside(model: Model, found: Found) -> Found:
    """The best minimum (1, d) among those a few parts of a sample of dead time away.

    The rebuilt command is known on a grid of parts, so that each part of dead time may hold a minimum of its own.
    """
    dead, part = model.space.parameters[4], model.step_s / model.spec.substeps
    if dead.high <= dead.low:
        return found
    for _ in range(_BESIDE_TURNS):
        starts = found.points[:1].repeat(len(_BESIDE), axis=0)
        starts[:, 4] = np.clip(starts[:, 4] + np.array(_BESIDE) * part / (dead.high - dead.low), 0.0, 1.0)
        shifted = descended(model, starts, held=(4,), turns=5, settle=1e-2)
        more = descended(model, shifted.points[:2], turns=40)
        if not more.costs[0] < found.costs[0] * (1.0 - _SETTLED):
            break
        found = more
    return found


def agreement(model: Model, points: FloatArray, costs: FloatArray) -> int:
    values = model.values(points)
    S, J = values[0], values[1]
    close = np.abs(S - S[0]) <= AGREE_S * S[0]
    close &= np.abs(J - J[0]) <= AGREE_J * S[0]
    if not np.isfinite(costs[0]):
        return 1
    ratio = costs / max(costs[0], 1e-300)
    alike = (ratio <= 1.0 + _AGREE_COST) | (model.shared.rows * np.log(np.maximum(ratio, 1e-300)) <= 2.0)
    # Errors that differ by less than this share of the signal are alike in any real record.
    alike |= np.sqrt(costs) - np.sqrt(costs[0]) <= _AGREE_SIGNAL * np.sqrt(model.shared.target_energy)
    return int((close & alike).sum())


def region(model: Model, top: FloatArray, rng: np.random.Generator,
           jumps: FloatArray | None = None) -> dict[str, tuple[float, float]]:
    """Intervals of all numbers of a model around a point (d,) that has been polished.

    `jumps` (k, d) are points with other slip jumps where they are known from a narrower model.
    """
    cube, cost = _cloud(model, top, rng, None if jumps is None else _jumps_settled(model, jumps))
    best = int(cost.argmin())
    return _intervals(model, cube, cost, float(cost[best]), model.evaluate(model.values(cube[best:best + 1])[:, 0]))


def _cloud(model: Model, top: FloatArray, rng: np.random.Generator,
           jumps: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Points around the optimum, shaped by the points that do nearly as well, and their costs; `jumps` among them.

    Rays along which one number moves and the others follow; a cloud of all numbers together; and one with the
    break-away (S, initial force) held, since on a sampled command its plateau is far narrower than the rest.
    """
    movable = np.array([p.high > p.low for p in model.space.parameters])
    held = movable & ~np.isin(np.arange(top.size), (0, *model.forces))
    jumps = _jump_profile(model, top) if jumps is None else jumps
    parts = [top[None], _rays(model, top), jumps, _adapted(model, top, movable, rng),
             _adapted(model, top, held, rng)]
    cube = np.concatenate(parts)
    return cube, model.costs(cube)


def _jump_profile(model: Model, top: FloatArray) -> FloatArray:
    """Points (k, d) with other slip jumps, each with the break-away and the process that go best with it.

    A held command makes the path of the valve jump between a few shapes as S and the initial force move by little; each
    has another best slip jump, which no ray from the best point reaches.
    """
    if not model.spec.held or model.law.one_parameter or not movable(model)[:3].all():
        return top[None]
    values = model.values(top[None])[:, 0]
    jumps = values[1] + values[0] * np.concatenate([-_JUMPS, _JUMPS])
    jumps = jumps[(jumps >= 0.0) & (jumps <= 1.5 * values[0])]
    if not jumps.size:
        return top[None]
    grid = values[:, None].repeat(jumps.size * _BREAKS.size, axis=1)
    grid[0] *= np.tile(_BREAKS, jumps.size)
    grid[1] = jumps.repeat(_BREAKS.size)
    if len(model.pieces) > 1:
        # The residual force stays what it is, not its share of a break-away force that changes.
        grid[list(model.forces)] *= (values[0] + values[1]) / (grid[0] + grid[1])
        grid[list(model.forces)] = np.clip(grid[list(model.forces)], -1.0, 1.0)
    rough, cost = _first_force(model, model.cube(grid), _ROUGH_FORCES)
    order = np.argsort(cost.reshape(jumps.size, -1), axis=1, kind="stable")[:, :_BREAKS_KEPT]
    kept = (order + np.arange(jumps.size)[:, None] * _BREAKS.size).ravel()
    near, cost = _first_force(model, rough[kept], _FORCES)
    best = cost.reshape(jumps.size, -1).argmin(axis=1) + np.arange(jumps.size) * _BREAKS_KEPT
    return _jumps_settled(model, near[best])


def _jumps_settled(model: Model, points: FloatArray) -> FloatArray:
    """Points (k, d) with the process that goes best with each one's valve."""
    return descended(model, points, held=(0, 1, *model.forces), turns=4, settle=1e-3).points


def _rays(model: Model, top: FloatArray) -> FloatArray:
    """Points (k, d) along the directions in which a number moves while the others follow it at least cost.

    The direction of each number is its column of the covariance that the slopes of the residuals give: of all numbers,
    and with the break-away (S, initial force) held, since slopes across a held command's plateau mean little. A wide
    ladder both ways finds where the cost leaves each ray.
    """
    free = np.flatnonzero(movable(model) > 0)
    normal = normals_at(model.residuals, top[None], free, np.full((1, free.size), _RAY_DIFFERENCE))[0][0]
    directions = [*np.eye(top.size)[free], *_following(normal, free, top.size)]
    held = ~np.isin(free, (0, *model.forces))
    if held.any() and not held.all():
        directions += _following(normal[np.ix_(held, held)], free[held], top.size)
    ladder = np.concatenate([-_RAY_LADDER, _RAY_LADDER])
    points = top + ladder[:, None, None] * np.array(directions)
    inside = ((points >= 0.0) & (points <= 1.0)).all(axis=2)
    return points[inside]


def _following(normal: FloatArray, free: FloatArray, size: int) -> list[FloatArray]:
    """Directions (size,) along which one of the `free` numbers moves by 1 and the others follow at least cost."""
    values, vectors, scale = principal(normal)
    spread = (vectors / np.maximum(values, 1e-9 * values[-1] + 1e-30)) @ vectors.T / scale / scale[:, None]
    found = []
    for j in range(free.size):
        ray = np.zeros(size)
        ray[free] = spread[:, j] / max(abs(spread[j, j]), 1e-300)
        found.append(ray)
    return found


def _adapted(model: Model, top: FloatArray, free: NDArray[np.bool_], rng: np.random.Generator) -> FloatArray:
    """Points (k, d) around `top` in its free numbers, drawn three times from the spread of the best so far."""
    columns = np.flatnonzero(free)
    d = columns.size
    if not d:
        return top[None]
    wide = spreads(model, 0.3)[columns] * rng.standard_normal((_CLOUD, d)) * np.exp(-5.0 * rng.random((_CLOUD, 1)))
    cube = top[None].repeat(_CLOUD, axis=0)
    cube[:, columns] = np.clip(top[columns] + wide, 0.0, 1.0)
    cost = model.costs(cube)
    for _ in range(3):
        chosen = cube[np.argsort(cost, kind="stable")[:max(4 * d, _CLOUD // 8)]][:, columns] - top[columns]
        spread = chosen.T @ chosen / len(chosen)
        root = np.linalg.cholesky(spread + (1e-10 * np.trace(spread) + 1e-18) * np.eye(d))
        more = top[None].repeat(_CLOUD, axis=0)
        more[:, columns] = np.clip(top[columns] + 1.7 * rng.standard_normal((_CLOUD, d)) @ root.T, 0.0, 1.0)
        cube, cost = np.concatenate([cube, more]), np.concatenate([cost, model.costs(more)])
    return cube


def effective_rows(residual: FloatArray, good: FloatArray) -> float:
    """Rows that count as independent, by the residual's lag-one autocorrelation (n (1-ρ)/(1+ρ))."""
    from .noise import autocovariance

    r = autocovariance(residual, good > 0, 1)  # the first sample of a segment never counts
    rho = float(np.clip(r[1] / r[0], 0.0, 0.999)) if r[0] > 0 else 0.0
    return max(float((good > 0).sum()) * (1.0 - rho) / (1.0 + rho), 5.0)


def _intervals(model: Model, cube: FloatArray, cost: FloatArray, best_cost: float,
               best: Evaluated) -> dict[str, tuple[float, float]]:
    """Smallest and largest value of each parameter among points that the likelihood ratio does not exclude."""
    rows = effective_rows(np.nan_to_num(best.innovation), model.weight)
    keep = rows * np.log(np.maximum(cost, 1e-300) / max(best_cost, 1e-300)) <= INTERVAL_THRESHOLD
    if not keep.any():
        keep = cost <= best_cost
    values = model.values(cube[keep])
    found = {name: (float(v.min()), float(v.max())) for name, v in zip(best.values, values, strict=True)}
    margin = _between_samples(model, best)
    for name in ("S", "J"):
        low, high = found[name]
        found[name] = (max(low - margin, 0.0), high + margin)
    return found


def _between_samples(model: Model, best: Evaluated) -> float:
    """How far S and J may be off in % because a slip happened between two samples, where the command is not known.

    A record as fast as the scans of a DCS knows its command. A slower one knows a slip to a whole move of the command
    from one sample to the next; a command rebuilt between samples (or at the scans there) is known to a share of such
    a move.
    """
    share = _REBUILT if model.spec.between != "hold" else 1.0 if model.step_s > _SLOWEST_SCAN_S else 0.0
    moves = []
    for position, output in zip(model.split(best.position), model.split(model.loop.output), strict=True):
        moved = np.abs(np.diff(position)) > 1e-9
        moves.append(np.abs(np.diff(output))[np.flatnonzero(moved[1:] & ~moved[:-1]) + 1])
    slips = np.concatenate(moves)
    return share * float(np.median(slips)) if slips.size and share else 0.0


def _holdout(model: Model, best: Evaluated, cube: FloatArray) -> float | None:
    """Error on contiguous blocks that were masked while a fold chose its point from the cloud and its linear part.

    The valve runs through the whole record, so no fold restarts it; the block and a gap beside it are left out. The
    start-up transient is taken from the full fit: a fold without the start could not know it.
    """
    values = model.values(cube)
    own = model.own_columns(*model.responses(values))
    level = model.context.process_value - best.transient
    own = own[:own.shape[0] - best.transients]
    goal = model.filtered(level[:, None])[:, 0]
    columns = model.filtered(model._columns())
    if model.spec.increments:
        columns = columns[:, len(model.pieces):]  # a constant has no differences
    total, rows = 0.0, 0
    for test, near in fold_rows(model, values[:, 0], [max(p.skip, p.taps.size) for p in model.pieces]):
        test &= model.weight > 0
        train = (model.weight > 0) & ~near
        if test.sum() < 3 or train.sum() < 5 * (own.shape[0] + columns.shape[1] + 1):
            return None
        p, sizes, tail = best_of_fold(own, columns, goal, train, model.spec.fixed.get("gain"))
        error = goal[test] - (own[:, test, p].T @ sizes + columns[test] @ tail)
        total, rows = total + float(np.sum(error**2)), rows + int(test.sum())
    return float(np.sqrt(total / rows)) if np.isfinite(total) else None


def fold_rows(model: Model, values: FloatArray, firsts: Sequence[int]) -> list[tuple[BoolArray, BoolArray]]:
    """The rows (n,) that each fold holds out, and these with the gap on either side; values (d,) set the gap.

    A fold holds out one block of every segment from its first row on, so that each segment's own level can be known.
    """
    inside = np.zeros((HOLDOUT_BLOCKS, model.loop.samples), bool)
    near = inside.copy()
    at = 0
    for i, (piece, first) in enumerate(zip(model.pieces, firsts, strict=True)):
        n = piece.loop.samples
        gap = gap_rows(piece, model.of(i, values), first)
        edges = np.linspace(first, n, HOLDOUT_BLOCKS + 1).astype(int)
        for fold, (a, b) in enumerate(pairwise(edges.tolist())):
            inside[fold, at + a:at + b] = True
            near[fold, at + max(a - gap, 0):at + min(b + gap, n)] = True
        at += n
    return list(zip(inside, near, strict=True))


def held_out_error(model: Model, point: FloatArray, rng: np.random.Generator) -> float | None:
    """Held-out error of a point (d,) of the unit cube as it is, in the form the model is fitted in; see `_holdout`."""
    cube, cost = _cloud(model, point, rng)
    cube = cube[np.argsort(cost, kind="stable")[:_CLOUD // 2]]
    return _holdout(model, model.evaluate(model.values(cube[:1])[:, 0]), cube)


def gap_rows(model: Model, values: FloatArray, first: int) -> int:
    """Rows left out on either side of a block: while the process of values (d,) remembers, half a period at least."""
    wanted = max(values[4] + 3.0 * values[3], model.period_s / 2.0) / model.step_s
    return int(min(wanted, (model.loop.samples - first) / (2 * HOLDOUT_BLOCKS)))


def _distinct(points: FloatArray) -> FloatArray:
    """Points (k, d) without those that repeat an earlier one's S and J: restarts that agree need one polish."""
    return points[_first_distinct(points, len(points), _SAME_POINT)]
