"""Refitting a model with one more effect, and completing any model with the noise that its residual asks for.

An effect's refit starts warm from the model so far and fresh from new basins, because a missing effect moves S and J
into a wrong basin. Completion fits an autoregression to the free-run residual and, where there is one, refits the model
in prewhitened form, so that all models are compared by their innovations, noise model included.
Source: METHODS.md section 6; CRITICISM.md sections 1 and 7.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .arx import Arx
from .effects import parse
from .fit import (
    Fitted,
    along_ridge,
    basins,
    polish_smooth,
    search_model,
    spreads,
    with_other_start,
    with_process,
    with_start,
)
from .loop import BoolArray, FloatArray
from .model import BASE, Evaluated, Model, Spec
from .noise import autoregression
from .search import refine, swarm

_WARM, _ROAM, _SCOUTS = 6, 2, 500
_SETTLED = 1e-4
# Further polishes go on while each lowers the cost by this share, at most so often.
_WORTH, _TURNS = 0.01, 4
LARGEST_ORDER = 8
BLOCKS = 5


@dataclass(frozen=True, slots=True)
class Refit:
    """A model at its best point (d,), completed with its noise; `innovation` (n,) is white where it is adequate."""

    model: Model
    values: FloatArray
    evaluated: Evaluated
    taps: FloatArray
    increments: bool
    innovation: FloatArray
    good: BoolArray
    parameters: int

    @property
    def innovation_sd(self) -> float:
        """Standard deviation of the innovations, in the unit of y."""
        return float(np.sqrt(np.mean(self.innovation[self.good] ** 2)))

    def bic(self, good: BoolArray) -> float:
        """BIC of the innovations on common samples (n,)."""
        rows = float(good.sum())
        sse = float(np.sum(self.innovation[good] ** 2))
        return rows * float(np.log(max(sse, 1e-300) / rows)) + self.parameters * float(np.log(rows))


def starting_pool(model: Model, values: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Values (k, 5) of the base parameters to start refits from: the fit so far and fresh basins."""
    base = Model(model.loop, Spec(law=model.spec.law, process=model.spec.process, between=model.spec.between,
                                  substeps=model.spec.substeps, increments=model.spec.increments,
                                  fixed=model.spec.fixed), s_max=model.s_max, period_s=model.period_s)
    fresh = with_process(base, basins(base, rng))
    return np.concatenate([values[None, :len(BASE)], base.values(fresh).T])


def with_effect(fit: Fitted, name: str, pool: FloatArray, rng: np.random.Generator) -> tuple[Model, FloatArray, float]:
    """The model with effect `name` added, its best values (d,) and cost; neutral where nothing better was found."""
    before = fit.model
    spec = replace(before.spec, effects=(*before.spec.effects, name))
    model = Model(before.loop, spec, s_max=before.s_max, period_s=before.period_s,
                  residual=np.nan_to_num(fit.best.residual))
    coarse = search_model(model)
    effect, option = parse(name)
    guesses = effect.guess(model._context(option)) if effect.guess else np.zeros((1, 0))
    others = fit.best.values
    starts = []
    for base in pool:
        for guess in guesses:
            named = {**others, **dict(zip(BASE, base, strict=True))}
            vector = coarse.vector(named)
            vector[coarse._slices[coarse.names.index(name)]] = guess
            starts.append(vector)
    cube = coarse.cube(np.array(starts).T)
    warm = cube[np.argsort(coarse.costs(cube), kind="stable")[:_WARM]]
    fresh = _valve_basins(coarse, name, rng) if effect.kind in "FT" else np.empty((0, model.space.size))
    roam = swarm(coarse.costs, coarse.space.size, rng, groups=1, particles=40, rounds=20, scouts=_SCOUTS)
    starts_cube = np.concatenate([warm, fresh, roam.points[:_ROAM]])
    found = refine(coarse.costs, with_start(coarse, starts_cube), rng, spread=spreads(coarse), rounds=40,
                   population=14, settle=_SETTLED)
    near = with_start(coarse, found.points[:2])
    if model.spec.between == "hold":
        near = np.concatenate([near, along_ridge(coarse, found.points[:1]),
                               with_other_start(coarse, found.points[0], 2)])
    last = refine(coarse.costs, near, rng, spread=spreads(coarse, 0.4), rounds=60, population=16, settle=_SETTLED)
    best, cost = polish_smooth(coarse, with_start(coarse, last.points[:1])[0], rng)
    for _ in range(_TURNS):
        again = refine(coarse.costs, with_start(coarse, best[None]), rng, spread=spreads(coarse, 0.2), rounds=60,
                       population=20, settle=_SETTLED)
        best, now = polish_smooth(coarse, with_start(coarse, again.points[:1])[0], rng)
        if now > cost * (1.0 - _WORTH):
            break
        cost = now
    final = refine(model.costs, best[None], rng, spread=spreads(model, 0.1), rounds=60, population=16, settle=_SETTLED)
    point, cost = polish_smooth(model, final.points[0], rng)
    return model, model.values(point[None])[:, 0], cost


def _valve_basins(model: Model, name: str, rng: np.random.Generator) -> FloatArray:
    """Starts from swarms on the one-step error over valve and effect parameters, which stays local in time."""
    rows = model._slices[model.names.index(name)]
    columns = [0, 1, 2, *range(rows.start, rows.stop)]
    period = model.period_s / model.step_s
    ladder = np.unique(np.round(np.geomspace(1, int(np.clip(0.4 * period, 1, 60)) + 1, 6) - 1).astype(int))
    arx = Arx(model, 2, tuple(int(d) for d in ladder))
    middle = np.full(model.space.size, 0.5)

    def whole(part: FloatArray) -> FloatArray:
        cube = middle[None].repeat(len(part), axis=0)
        cube[:, columns] = part
        return cube

    found = swarm(lambda part: arx.costs(model.values(whole(part)))[0], len(columns), rng, groups=2, particles=32,
                  rounds=20, scouts=_SCOUTS)
    starts = whole(found.points[:3])
    return with_process(model, starts)


def complete(model: Model, values: FloatArray, pool: FloatArray | None, rng: np.random.Generator, *,
             random_walk: bool = False, order: int = LARGEST_ORDER) -> Refit:
    """The model with an autoregression for its residual, refitted in prewhitened form where there is one.

    With `random_walk` model and data are fitted in differences, on which the autoregression sits.
    """
    evaluated = model.evaluate(values)
    increments = random_walk or model.spec.increments
    taps = _taps(evaluated, increments, order)
    if taps.size == 0 and increments == model.spec.increments:
        return _refit(model, values, evaluated, taps, increments)
    best: Refit | None = None
    for _ in range(3):
        white = Model(model.loop, replace(model.spec, taps=tuple(taps), increments=increments), s_max=model.s_max,
                      period_s=model.period_s, residual=np.nan_to_num(evaluated.residual))
        starts = [values]
        if pool is not None and best is None:
            starts += [white.vector({**model.named(values), **dict(zip(BASE, base, strict=True))}) for base in pool[1:]]
        coarse = search_model(white)
        cube = with_start(coarse, coarse.cube(np.array(starts).T))
        found = refine(coarse.costs, cube, rng, spread=spreads(coarse, 0.5), rounds=40, population=14, settle=_SETTLED)
        if white.spec.between == "hold" and best is None:
            near = np.concatenate([found.points[:1], along_ridge(coarse, found.points[:1])])
            found = refine(coarse.costs, near, rng, spread=spreads(coarse, 0.4), rounds=40, population=14,
                           settle=_SETTLED)
        point, _ = polish_smooth(white, found.points[0], rng)
        values = white.values(point[None])[:, 0]
        evaluated = white.evaluate(values)
        now = _refit(white, values, evaluated, taps, increments)
        if best is not None and now.innovation_sd > 0.999 * best.innovation_sd:
            break
        best = now
        taps = _taps(evaluated, increments, order)
    assert best is not None
    return best


def _taps(evaluated: Evaluated, increments: bool, order: int) -> FloatArray:
    residual = np.nan_to_num(evaluated.residual)
    good = evaluated.counted > 0
    if increments:
        residual = np.diff(residual, prepend=residual[0])
        good = good & np.roll(good, 1)
    return autoregression(residual, good, order)


def _refit(model: Model, values: FloatArray, evaluated: Evaluated, taps: FloatArray, increments: bool) -> Refit:
    polynomial = np.concatenate([[1.0], taps])
    if increments:
        polynomial = np.convolve(polynomial, [1.0, -1.0])
    residual = np.nan_to_num(evaluated.residual)
    innovation = np.convolve(residual, polynomial)[:residual.size]
    good = evaluated.counted > 0
    for lag in range(1, polynomial.size):
        good[lag:] &= (evaluated.counted > 0)[:-lag]
    good[:model.skip + polynomial.size] = False
    count = model.space.size - len(model.spec.fixed) + len(evaluated.own) + model.shared.freedom + taps.size
    return Refit(model, values, evaluated, taps, increments, innovation, good, count)


def block_gains(before: Refit, after: Refit, good: BoolArray) -> FloatArray:
    """Relative drop of the one-step error on each of BLOCKS contiguous blocks (BLOCKS,), on common samples."""
    rows = np.flatnonzero(good)
    gains = []
    for part in np.array_split(rows, BLOCKS):
        a = float(np.sqrt(np.mean(before.innovation[part] ** 2)))
        b = float(np.sqrt(np.mean(after.innovation[part] ** 2)))
        gains.append(1.0 - b / a if a else 0.0)
    return np.array(gains)
