"""Basins of a valve with effects: an even grid on a short part of the record, polished on longer parts.

A valve that misses one break-away of a held command is out of step for long. On a whole record the right S, J and size
lie in a narrow basin: half a per cent in each of four or five parameters. No swarm meets it. On a few cycles the basin
is ten times as wide: a grid finds it, and every longer part polishes the points of the shorter one.

The process is left open. A candidate's position goes through a high pass and a few lags, whose sum imitates any
process of first or second order. The best of a ladder of delays counts. The high pass removes from y what is slower
than a slip: drift, steps, waves, the errors that an integrator adds up. The one-step error needs no process either, but
with a noisy y it is smallest at a valve that merely follows y.

Under a held command two searches begin on parts of different length, because they fail on different records. Measured
with the true specification on 25 loops of benchmarks/plants (seed 105000): 20 valves are found, as many as with twice
the points. S is right in 15, with twice the points in 12. With these, on 50 loops exported at the scan (seed 41000),
polished beside the true disturbances, 37 come within 3 % of the error of the true valve. Within 2 %, one search alone
finds 34 or 33. From parts of two periods on, before the last polish, a high pass of 0.2 periods found 33, one of 0.7
periods 26. Under a command that moves between samples two searches find 22 of 29 valves that may rest, one finds 21.
Source: docs/details.md, sections 6.1 and 6.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...model.model import Model
from ...numerics.filter_bank import LagBank
from ...numerics.jit import LANES
from ...numerics.population import refine
from ...process.linear import Dynamics, free_run
from ...record.loop import fingerprint
from ...system import evaluations
from ...typing import FloatArray
from ..points.moves import (
    beginning,
    distinct_points,
    even_steps,
    lift_points,
    longest_piece,
    neutral_point,
    search_model,
    thin_model,
    thinning,
)
from .reparametrised import as_valves, ridge_of

# Lags in periods; the longest one is that of the high pass, too. A process as slow as the high pass needs a lag beside
# it, or what is left of a right valve is several times the noise. Measured on 197 loops of benchmarks/plants with the
# true specification (seeds 43000, 45000, 95000 to 97000): 147 valves found, with 0.2, 0.1, 0.04 and 0.012 in place of
# these 136. Where PV is missing so often that its mean distance is
# longer than so many samples, a slower one. Delays tried, up to this share of a period.
LAGS, _SPARSE, SPARSE_PACE = (0.25, 0.15, 0.06, 0.02), (0.7, 0.2, 0.06, 0.015), 1.25
_DELAYS, _LONGEST = 6, 0.4
# Points of the first grid for each searched parameter beyond two. For each search periods of the shortest part and the
# factor from one part to the next: two under a held command, one under a command that moves. Then the points that the
# first and the last part leave.
_SCAN, _HELD, _MOVING, _LEFT = 12_000, ((3.0, 2.0), (8.0, 2.0)), ((5.0, 2.0),), (32, 8)
# Shares of the record, with the points that each leaves, where friction changes along it. A short part determines the
# rate of change so badly that the next part must not be much longer.
_DRIFTING = ((0.06, 64), (0.1, 48), (0.14, 32), (0.2, 24), (0.28, 16), (0.4, 12), (0.55, 8), (0.75, 8), (1.0, 6))
# Periods in the shortest part.
_SHORTEST = 2.0
# Ends of the bands of the stickband, as shares of its range, each of which keeps valves of its own.
_BANDS_OF_S = (0.2, 0.35, 0.55, 0.75)
# Below this share of S_max a valve follows its command, and with it, in the closed loop, y. Unit: 1.
LEAST_S = 0.1
# Distance between points that are kept: of the grid, and of what was polished. Share of the range.
_APART, _NEAR = 0.03, 0.004
# Rounds of a polish, and where friction changes along the record, which is two parameters more. Its population.
_ROUNDS, _SLOWER, _POPULATION, _SETTLED = 16, 24, 12, 1e-3
# Path values that are evaluated together: the arrays stay in the processor's cache.
_BLOCK = 1 << 17
# First standard deviations of the polish: on parts up to this share of the record, and on longer ones.
_WIDE, _FINE, _SHORT = 0.02, 0.01, 0.3
# Shares of the record, with the points that each leaves.
Schedule = Sequence[tuple[float, int]]


def open_bank(model: Model) -> LagBank:
    """The costs of valve positions on the record of a one-segment model, with the process left open."""
    lags, delays = _lags_s(model), [d for d in delay_ladder(model) if d <= model.skip]
    return LagBank(_quick_part(model), model.good() & ~model.starting(), lags, lags[0], delays, step_s=model.step_s,
                   parts=model.parts)


def delay_ladder(model: Model) -> list[int]:
    """Delays in samples that stand for all dead times up to a share of the period."""
    longest = int(np.clip(_LONGEST * model.period_s / model.step_s, 1, 60))
    return [int(d) for d in np.unique(np.round(np.geomspace(1, longest + 1, _DELAYS) - 1))]


def _lags_s(model: Model) -> list[float]:
    """Lags of the bank in seconds, that of the high pass first."""
    return [share * model.period_s for share in (_SPARSE if model.pace > SPARSE_PACE else LAGS)]


def open_costs(model: Model, part: LagBank, values: FloatArray) -> FloatArray:
    """Sum of squared errors (P,) of values (d, P); infinite for valves that hardly stick and so follow their command.
    """
    out = np.empty(values.shape[1])
    evaluations.add(out.size, model.loop.samples, model.parts)
    lanes = max(_BLOCK // (model.loop.samples * model.parts) // LANES, 1) * LANES
    for a in range(0, out.size, lanes):
        out[a:a + lanes] = part.costs(model.positions(values[:, a:a + lanes], lent=True))
    return np.where(values[0] >= LEAST_S * model.s_max, out, np.inf)


def _quick_part(model: Model) -> FloatArray:
    """The part of y (n,) that the high pass of the bank lets through."""
    y = model.context.process_value - model.context.process_value[0]
    alone = np.array(_lags_s(model)[:1])
    return y - free_run(y[:, None], Dynamics(alone, 0.0 * alone, 0.0 * alone, False), step_s=model.step_s)[:, 0]


def grown_valves(model: Model, names: Sequence[str], rng: np.random.Generator,
                 known: FloatArray | None = None, *, once: bool = False) -> FloatArray:
    """Points (k, d) of the unit cube, best first, searched over the valve, its start and the effects of these names.

    The other parameters are as in `known` values (d,), or neutral. `once` leaves out all searches but the first, which
    takes a third of the time. Of several segments the longest is searched. A command that moves between samples gets a
    coarse grid: a polish puts right what that costs. Measured on 109 loops of benchmarks/plants under such a command
    (seeds 43000, 45000, 95000, 96000): 78 valves found with 2 points a sample, and 78 with 4, which take 1.7 times as
    long.
    """
    at = longest_piece(model)
    piece = model.pieces[at]
    whole = search_model(piece)
    small = thin_model(whole, thinning(whole))
    shift = model.head - small.head
    rows = (model.rows_of(name) for name in names)
    columns = [0, 1, model.forces[at], *(i for r in rows for i in range(r.start, r.stop))]
    middle = neutral_point(small) if known is None else small.cube(model.of(at, known[:, None]))[0]
    own = [2 if c == model.forces[at] else c - (shift if c >= model.head else 0) for c in columns]
    points = _grow_once(small, own, middle, rng, _schedules(small)[:1 if once else None])
    found = middle[None].repeat(len(points), axis=0)
    found[:, own] = points
    found = as_valves(small, found)[0] if _along_ridge(small, own) else found
    # Ranges depend on the grid.
    found = piece.cube(np.stack([piece.vector(small.named(column)) for column in small.values(found).T], axis=1))
    return found if len(model.pieces) == 1 else lift_points(model, at, found)


def _along_ridge(model: Model, own: list[int]) -> bool:
    """True where the search uses the natural numbers of an effect that has them."""
    along = ridge_of(model)
    return along is not None and along[1].start in own


def _grow_once(model: Model, own: list[int], middle: FloatArray, rng: np.random.Generator,
               searches: Sequence[Schedule]) -> FloatArray:
    """The points of `_grow_points`, cached by question: a further lag, or another process, needs the same valves.

    No result depends on the cache. The generator ends in the state that the search leaves, and the work counts as
    that of one question.
    """
    key, memory = _question(model, own, middle, rng, searches), model.loop.memory
    if (known := memory.get(key)) is not None:
        points: FloatArray = known[0]
        rng.bit_generator.state, took = known[1:]
        evaluations.note_answer(key, took)
        return points
    before = evaluations.samples_spent()
    points = _grow_points(model, own, middle, rng, searches)
    took = evaluations.samples_spent() - before
    evaluations.take_back(before)
    evaluations.note_answer(key, took)
    memory.keep(key, (points, rng.bit_generator.state, took))
    return points


def _question(model: Model, own: list[int], middle: FloatArray, rng: np.random.Generator,
              searches: Sequence[Schedule]) -> str:
    """A fingerprint of all inputs of `_grow_points`."""
    context, spec = model.context, model.spec
    stems = [name for name, effect in zip(model.names, model.effects, strict=True) if effect.friction or effect.run]
    fixed = [middle[model.rows_of(name)].tolist() for name in stems]
    names = [*model.named(np.zeros(model.space.size))]
    asked = [(names[c], model.space.parameters[c]) for c in own]
    told = (spec.law, spec.between, spec.friction_free, model.parts, model.step_s, model.period_s, model.s_max,
            model.skip, context.record, context.centre, stems, fixed, asked, _lags_s(model), searches,
            rng.bit_generator.state, spec.process if _along_ridge(model, own) else "any")
    guide = context.guide if model.follows_y else None
    return fingerprint(told, context.command, context.process_value, model.good(), guide)


def _grow_points(small: Model, own: list[int], middle: FloatArray, rng: np.random.Generator,
                 searches: Sequence[Schedule]) -> FloatArray:
    """The best points (k, columns) of the whole record, from one part of it to the next."""
    ridge = _along_ridge(small, own)
    banks: dict[int, tuple[Model, LagBank]] = {}

    def cost_of(rows: int) -> Callable[[FloatArray], FloatArray]:
        if rows not in banks:
            part = beginning(small, rows)
            banks[rows] = part, open_bank(part)
        part, bank = banks[rows]

        def cost(points: FloatArray) -> FloatArray:
            whole = middle[None].repeat(len(points), axis=0)
            whole[:, own] = points
            whole, possible = as_valves(small, whole) if ridge else (whole, np.ones(len(whole), bool))
            return np.where(possible, open_costs(part, bank, small.values(whole)), np.inf)

        return cost

    found = np.concatenate([_through_parts(small, cost_of, len(own), parts, rng) for parts in searches])
    return found[np.argsort(cost_of(small.loop.samples)(found), kind="stable")]


def _through_parts(small: Model, cost_of: Callable[[int], Callable[[FloatArray], FloatArray]], scanned: int,
                   parts: Schedule, rng: np.random.Generator) -> FloatArray:
    """The best points (k, scanned) of the whole record, searched on growing parts with the cost of so many rows.

    `parts` are shares of the record, with the points that each leaves.
    """
    points = np.empty((0, scanned))
    rounds = _SLOWER if _changes(small) else _ROUNDS
    # A record may begin at rest, so a part also has its share of the energy of y.
    happened = np.cumsum(_quick_part(small) ** 2)
    for share, kept in parts:
        rows = max(int(share * small.loop.samples), small.skip + int(_SHORTEST * small.period_s / small.step_s),
                   int(np.searchsorted(happened, share * happened[-1])) + 1)
        cost = cost_of(min(rows, small.loop.samples))
        points = (_polish_part(cost, points, share, kept, rounds, rng) if len(points) else
                  _scan_first_part(cost, scanned, kept, rng))
    return points


def _changes(model: Model) -> bool:
    """True where friction drifts along the record."""
    return any(effect.drifts for effect in model.effects)


def _schedules(model: Model) -> list[Schedule]:
    """Shares of a record, with the points that each leaves, for every search of it."""
    if _changes(model):
        return [_DRIFTING]
    return [growing_parts(model, periods, growth, _LEFT) for periods, growth in (_HELD if model.spec.held else _MOVING)]


def growing_parts(model: Model, periods: float, growth: float, ends: tuple[int, int]) -> list[tuple[float, int]]:
    """Shares of a record that grow geometrically from a few periods to the whole, and the points that each leaves."""
    first = min((model.skip + periods * model.period_s / model.step_s) / model.loop.samples, 1.0)
    count = max(int(np.ceil(-np.log(first) / np.log(growth))), 1) + 1
    left = np.geomspace(*ends, count).astype(int)
    return list(zip(np.geomspace(first, 1.0, count).tolist(), left.tolist(), strict=True))


def _polish_part(cost: Callable[[FloatArray], FloatArray], points: FloatArray, share: float, kept: int, rounds: int,
                 rng: np.random.Generator) -> FloatArray:
    """The best distinct points (kept, columns) of one part of the record, from those of the part before."""
    found = refine(cost, points, rng, spread=_WIDE if share <= _SHORT else _FINE, rounds=rounds,
                   population=_POPULATION, settle=_SETTLED)
    return found.points[_diverse_points(found.points, kept, _NEAR)]


def _scan_first_part(cost: Callable[[FloatArray], FloatArray], scanned: int, kept: int,
                     rng: np.random.Generator) -> FloatArray:
    """The best distinct points (kept, columns) of an even grid on the first part."""
    count = _SCAN * (scanned - 2)
    points = (rng.random(scanned) + np.outer(np.arange(count), even_steps(scanned))) % 1.0
    points = points[np.argsort(cost(points), kind="stable")[:count // 4]]
    return points[_diverse_points(points, kept, _APART)]


def _diverse_points(points: FloatArray, count: int, apart: float) -> list[int]:
    """Indices of points (k, columns), best first: half of the `count` are the best, the others the best of each band.

    With the process open a small valve follows its command, and y follows that through any process. So a short part of
    a record may show nothing of the right valve, whose stickband is larger.
    """
    best = distinct_points(points, count - count // 2, apart)
    band = np.digitize(points[:, 0], _BANDS_OF_S)
    others: list[tuple[int, int]] = []
    for rows in (np.flatnonzero(band == b) for b in range(len(_BANDS_OF_S) + 1)):
        found = rows[distinct_points(points[rows], count // 2, apart)]
        others += enumerate(i for i in found.tolist() if all(np.abs(points[i] - points[j]).max() > apart for j in best))
    return sorted([*best, *(i for _, i in sorted(others)[:count - len(best)])])
