"""Basins of a valve that rests at every scan: many short windows of the record, which grow until they are the whole.

Such a valve slips several times a stroke and each slip waits for the one before. Where one comes at another scan so do
all that follow. On a whole record the basin of the right S, J and size of an effect is far narrower than that of a
valve that slides. On a part that grows from the beginning (continuation.py) it is as narrow after a few cycles. A
window of one cycle whose start is unknown forgives errors of a tenth. A dozen windows all over the record leave few
valves that fit all. Other events in the record (a step, a ramp, a wave) bend few windows or none.

Each window assumes no process (numerics/filter_bank.py) and takes the best of a ladder of starts. Their errors add up
as standard deviations, so that one spoilt window does not decide. Measured on eight Karnopp valves of integrators and
tanks with one hidden effect, where parts that grow from the beginning found none: six found, in 1 s each. Source:
METHODS.md section 4, traps 1 and 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...effects import parse
from ...effects.contract import Place, Record
from ...model.model import Model
from ...numerics.filter_bank import LagBank
from ...numerics.population import refine
from ...process.scan import answers
from ...typing import BoolArray, FloatArray
from ..moves import lifted, longest_piece, neutral_point, search_model, thinned, thinning
from .continuation import distinct, even, grown_valves, open_bank, open_costs
from .reparametrised import as_natural, as_valves

# Starts tried in every window, as shares of the break-away force.
_FORCES = np.linspace(-0.97, 0.97, 15)
# Windows of the scan, windows of its first look, and its points for each parameter beyond one. Then the divisor that
# gives the points that go on, and the points that the scan and the last polish leave.
_WINDOWS, _FIRST, _SCAN, _GO_ON, _LEFT = 12, 3, 3000, 10, (16, 4)
# Lengths of the windows in periods, and the length up to which the polish is wide. Measured on 12 Karnopp valves with
# one hidden effect, integrators and tanks, two seeds each: from 1.6 on 16 of 24 found, from 1 on 14, in 1.3 times the
# time.
_PERIODS, _SHORT = (1.6, 2.5, 4.0, 7.0, 12.0), 2.5
_WIDE, _FINE = 0.02, 0.008
# Distance between kept points on windows of one period, as a share of the range. Longer windows have narrower basins,
# and points closer together may all lie in one basin that only short windows favour.
_APART = 0.02
_ROUNDS, _POPULATION, _SETTLED = 12, 14, 1e-3
# Where effects are searched together: points about the known values, and twice as many all over the range, since no
# number is dense in six dimensions. Then points that go on and that either scan leaves. Then rounds and first standard
# deviation of their polish, which has a long way to go. Last the standard deviation about the known values (shares of
# the range).
_FEW, _TAKEN, _CHOSEN, _LONG, _FAR, _ABOUT = 6000, 750, 8, 20, 0.08, 0.1
# Searches from the beginning: one in three ends where a polish finds the valve.
_GROWTHS = 3
# Below this share of S_max a valve follows its command, and with it, in the closed loop, y.
_LEAST_S = 0.1


def resting_valves(model: Model, names: Sequence[str], still: slice, rng: np.random.Generator, *,
                   rival: tuple[Model, FloatArray] | None = None) -> FloatArray:
    """Points (k, d) from a search over S, J, start and effects `names` for a valve that rests at every scan.

    The columns `still` are at their upper end. The search uses windows. Where the stem lags behind its friction it uses
    parts that grow from the beginning. The lag at the start of a window is unknown, and those parts cost a fifth.
    """
    own = [0, 1, *(i for name in names for i in range(model.rows_of(name).start, model.rows_of(name).stop))]
    if not any(parse(name)[0].place is Place.STEM for name in names):
        return windowed_valves(model, own, still, rng, rival=rival)
    own.insert(2, model.forces[longest_piece(model)])
    return np.concatenate([grown_valves(model, own, rng, still) for _ in range(_GROWTHS)])


def windowed_valves(model: Model, columns: list[int], still: slice | None, rng: np.random.Generator, *,
                    rival: tuple[Model, FloatArray] | None = None,
                    known: tuple[FloatArray, slice] | None = None) -> FloatArray:
    """Points (k, d) of the unit cube, best first, from a search over `columns` (S, J and effects) and the start.

    The process parameters are in the middle of their ranges. The columns `still` are at their upper end (a valve that
    rests at every scan; None for one that slides). Of several segments the longest is searched. The result is empty (0,
    d) where a valve of a `rival`, a model and its values (d,) or (d, k), fits the shortest windows as well.

    Where several effects are searched together, `known` holds values (d,) and the rows of the one that they do not
    know. A second scan then lies about these values. The polish goes further, along the natural numbers (see
    reparametrised.py).
    """
    at = longest_piece(model)
    whole = search_model(model.pieces[at])
    small = thinned(whole, thinning(whole))
    shift = model.head - small.head
    own = [c - (shift if c >= model.head else 0) for c in columns]
    middle = neutral_point(small)
    if still is not None:
        middle[still.start - shift:still.stop - shift] = 1.0

    def valves(points: FloatArray) -> tuple[FloatArray, BoolArray]:
        cube = middle[None].repeat(len(points), axis=0)
        cube[:, own] = points
        return as_valves(small, cube) if known else (cube, np.ones(len(cube), bool))

    def costs_on(windows: _Windows, first: int | None = None) -> Callable[[FloatArray], FloatArray]:
        def cost(points: FloatArray) -> FloatArray:
            cube, possible = valves(points)
            values = small.values(cube)
            possible &= values[0] >= _LEAST_S * small.s_max
            return np.where(possible, windows.costs(values, first).sum(axis=0), np.inf)

        return cost

    direction = answers(model.loop)
    windows = _Windows(small, _PERIODS[0], _WINDOWS, direction)
    count = _SCAN * (len(own) - 1)
    count, taken, left = (_FEW, _TAKEN, _CHOSEN) if known else (count, count // _GO_ON, _LEFT[0])
    points = (rng.random(len(own)) + np.outer(np.arange(2 * count if known else count), even(len(own)))) % 1.0
    kept = _scanned(costs_on(windows, _FIRST), costs_on(windows), points, taken, left)
    if known:
        # Short windows may favour a valve that follows its command over all valves near the right one.
        there = as_natural(small, small.cube(model.of(at, known[0][:, None])))[0, own]
        points = points[::2]
        about = np.clip(there + _ABOUT * rng.standard_normal(points.shape), 0.0, 1.0)
        new = [i for i, c in enumerate(columns) if known[1].start <= c < known[1].stop]
        about[:, new] = points[:, new]
        kept = np.concatenate([kept, _scanned(costs_on(windows, _FIRST), costs_on(windows), about, taken, left)])
    points, left = kept, len(kept)
    for periods, kept in zip(_PERIODS, np.geomspace(left / 2, _LEFT[1], len(_PERIODS)).astype(int), strict=True):
        far = known is not None and periods == _PERIODS[0]
        windows = windows if far else _Windows(small, periods, direction=direction)
        found = refine(costs_on(windows), points, rng, spread=_FAR if far else _WIDE if periods <= _SHORT else _FINE,
                       rounds=_LONG if far else _ROUNDS, population=_POPULATION, settle=_SETTLED)
        points = found.points[distinct(found.points, kept, _APART / periods)]
        if rival is not None and periods == _PERIODS[0]:
            other = thinned(search_model(rival[0].pieces[at]), thinning(whole))
            own_of = rival[0].of(at, rival[1].reshape(len(rival[1]), -1)).T
            theirs = np.stack([other.vector(rival[0].pieces[at].named(column)) for column in own_of], axis=1)
            beaten = _Windows(other, periods, direction=direction).costs(theirs, None).sum(axis=0).min()
            if beaten <= found.costs[0]:
                return np.empty((0, model.space.size))
        if len(windows.parts) == 1:
            break
    out = valves(points)[0]
    # The start that fits each valve on the whole record.
    out = small.cube(_started(small, small.values(out)))
    return out if len(model.pieces) == 1 else lifted(model, at, out)


def _scanned(first: Callable[[FloatArray], FloatArray], then: Callable[[FloatArray], FloatArray], points: FloatArray,
             taken: int, left: int) -> FloatArray:
    """The best distinct points (left, d) by a second cost, among the `taken` points that are best by a first one."""
    points = points[np.argsort(first(points), kind="stable")[:taken]]
    points = points[np.argsort(then(points), kind="stable")]
    return points[distinct(points, left, _APART)]


def _started(model: Model, values: FloatArray) -> FloatArray:
    """Values (d, P) with the start that fits each valve best."""
    values = values.copy()
    values[2] = _FORCES[_by_start(model, open_bank(model), values).argmin(axis=1)]
    return values


def _by_start(model: Model, bank: LagBank, values: FloatArray) -> FloatArray:
    """Sums of squared errors (P, starts) of values (d, P) with every start of the ladder."""
    trial = values[:, :, None].repeat(_FORCES.size, axis=2)
    trial[2] = _FORCES
    return open_costs(model, bank, trial.reshape(len(values), -1)).reshape(values.shape[1], -1)


class _Windows:
    """Windows of so many periods, spread evenly over the record: `count` of them, or as many as cover it."""

    def __init__(self, model: Model, periods: float, count: int | None = None, direction: float = 0.0) -> None:
        n = model.loop.samples
        rows = min(model.skip + int(periods * model.period_s / model.step_s), n)
        count = max(min(count or n, n // rows), 1)
        parts = [_window(model, int(a), rows) for a in np.linspace(0, n - rows, count)]
        self.parts = [(part, open_bank(part, direction)) for part in parts]

    def costs(self, values: FloatArray, first: int | None) -> FloatArray:
        """Errors (windows, P) of values (d, P), each with its best start, of the `first` windows or all."""
        spread = self.parts if first is None else self.parts[::max(len(self.parts) // first, 1)][:first]
        return np.stack([np.sqrt(_by_start(*part, values).min(axis=1)) for part in spread])


def _window(model: Model, start: int, rows: int) -> Model:
    """The same model on some rows of its record."""
    loop, parts = model.loop, model.context.command.size // model.loop.samples
    clock, own = loop.clock_s, model.context.record
    record = Record(float(clock[start]) + (own.start_s if own else 0.0),
                    own.length_s if own else float(clock[-1]) + loop.step_s,
                    own.centre if own else float(np.nanmean(loop.process_value)))
    residual = model.context.residual
    return Model(loop.cut(start, start + rows), model.spec, s_max=model.s_max, period_s=model.period_s,
                 command=model.context.command[start * parts:(start + rows) * parts],
                 residual=None if residual is None else residual[start:start + rows], record=record)
