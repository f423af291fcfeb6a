"""Refit of a model with one more effect: a first look, a joint search with other effects, and the full polish.

An effect's refit starts warm from the model so far and fresh from new basins (starts/beside_effect.py): a missing
effect moves S and J into a wrong basin. Source: docs/details.md, sections 10 and 11.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..effects import parse
from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import BASE, Spec
from ..numerics.population import Found, join_found, refine
from ..typing import FloatArray
from .noise.completion import Refit, complete_quickly, place_slips
from .points.fitted import Fitted
from .points.moves import (
    cheapest_apart,
    descend_model,
    distinct_points,
    polish_smooth,
    spreads,
    valve_grid,
    with_start,
)
from .starts.basins import along_ridge, with_other_start, with_process
from .starts.beside_change import valves_after, valves_of_ends
from .starts.beside_effect import RESTING, guessed_valves, on_valve, open_valves, stickbands, valves_across
from .starts.intersample import QUICK_SETTLE, QUICK_TURNS
from .starts.niches import ALONE, PATIENCE, beyond_rest, evolve_points
from .starts.own_scan import scanned_starts
from .starts.reparametrised import follow_ridge, ridge_of

_SETTLED = 1e-4
# Turns of the first descent from every start, and the relative fall of the cost at which it ends.
_GLANCE, _GLANCED = 3, 1e-2
# Starts that then get a population.
_KEPT = 4
# Gain of the descent from which a look is polished. Unit: 2 log L.
_PROMISING = 10.0
# Points of a look that are polished under its noise, and their least distance in S or J as a share of the range.
_LIKELY, _APART = 4, 0.01
# Rounds of the first look at an effect.
_LOOK = 25
# Further polishes go on while each lowers the cost by this share, at most _TURNS times.
_WORTH, _TURNS = 0.01, 4
# Fine grids of S for the interval that all slips allow: reach either way as a share of S, and points.
_THRESHOLD_REACH, _THRESHOLDS = (0.02, 0.003), 241
# Slip jumps tried on these grids, as shares of the known one.
_THRESHOLD_J = np.array([0.95, 1.0, 1.06])
# Polishes on the model's own y, for effects that follow it.
_FOLLOWED = 3
# Most turns of grids along a curve of equal cost.
_RIDGED = 4
# Steps along the curve of equal cost (dead time against break-away) in a full refit.
_RIDGE_TURNS = 3
# Turns and fall of the cost of a descent along a path that PV placed, and the rounds that settle a look's own.
_ALONG, _ALONG_STILL, _PATH_ROUNDS = 4, 1e-3, 2


@dataclass(frozen=True, slots=True)
class Scouted:
    """A first look at one more effect: the model with it, and points (k, d), best first.

    `neutral` is the cost of the model so far, where the effect vanishes.
    """

    model: Model
    points: FloatArray
    cost: float
    neutral: float
    name: str = ""

    @property
    def gain(self) -> float:
        """Twice the log-likelihood of the free run that the effect has gained so far."""
        before, after = (float(np.log(max(cost, 1e-300))) for cost in (self.neutral, self.cost))
        return self.model.shared.rows * (before - after)

    @property
    def values(self) -> FloatArray:
        """Values (d,) of the best point so far."""
        return self.model.values(self.points[:1])[:, 0]


def scout_effect(fit: Fitted, name: str, pool: FloatArray, rng: np.random.Generator, *,
                 valves: FloatArray | None = None, far: bool = True, polish: bool = True) -> Scouted:
    """The model with effect `name` added, searched far enough to decide on a full refit.

    Starts are the neutral effect in the model so far and guesses of the effect in all basins of the pool. An effect on
    the valve also gets a grid of all valves with the known process. With `far` it gets a search on growing parts that
    assumes no process. `valves` (k, d) are values of such valves found before; each gets a process that fits it.
    Without `polish` the search ends after a descent, an eighth of the work.
    """
    model = widen_by(fit, name)
    effect, option = parse(name)
    guesses = effect.guess(model.context_of(option)) if effect.guess else np.zeros((1, 0))
    others = fit.best.values
    starts = [model.vector(others)]
    for base in pool:
        for guess in guesses:
            vector = model.vector({**others, **dict(zip(BASE, base, strict=True))})
            vector[model.rows_of(name)] = guess
            starts.append(vector)
    cube = model.cube(np.array(starts).T)
    costs = model.costs(cube)
    neutral = float(costs[0])
    # The best guess for each base: with the wrong size of an effect the right valve costs more than a wrong one.
    each = costs[1:].reshape(len(pool), len(guesses))
    best = 1 + np.arange(len(pool)) * len(guesses) + each.argmin(axis=1)
    warm = cube[np.append(best, 0)]
    fresh = np.empty((0, model.space.size))
    if valves is not None and len(valves):
        fresh = np.concatenate([model.cube(valves.T), with_process(model, model.cube(valves.T))])
    if effect.scan is not None:
        fresh = np.concatenate([scanned_starts(model, name, model.vector(others), polish), fresh])
    elif effect.dynamics is not None:
        # The pool was found with one lag. With a second one each of its valves needs another process.
        fresh = with_process(model, warm)
    elif on_valve(effect) and guesses.size:
        valve = guessed_valves(model, name, guesses, model.vector(others))
        fresh = np.concatenate([fresh, valve, with_process(model, valve)])
        if effect.at_once:
            fresh = np.concatenate([valves_of_ends(model, name, guesses, fit, rng), fresh])
        elif far:
            fresh = np.concatenate([open_valves(model, name, fit, rng), fresh])
    near = descend_model(model, with_start(model, np.concatenate([warm, fresh])), turns=_GLANCE, settle=_GLANCED)
    if len(fresh) and effect.friction is not None and model.spec.held:
        near = join_found(near, refine(model.costs, with_start(model, fresh[:_KEPT]), rng, spread=spreads(model),
                                       rounds=_LOOK, population=14, settle=_SETTLED))
    found = Scouted(model, near.points, float(near.costs[0]), neutral, name if effect.kind in "FT" else "")
    return polish_look(found, name, rng) if polish else found


def polish_look(found: Scouted, name: str, rng: np.random.Generator) -> Scouted:
    """A first look polished with a population, and one step along its curve of equal cost; else unchanged."""
    model, effect = found.model, parse(name)[0]
    if not found.gain > _PROMISING:
        return found
    polish = refine(model.costs, found.points[:_KEPT], rng, spread=spreads(model), rounds=_LOOK, population=14,
                    settle=_SETTLED)
    points, cost = polish.points, float(polish.costs[0])
    if effect.kind in "FT" and model.spec.held and cost < found.neutral * (1.0 - _SETTLED):
        # The effect helps, so the process it was fitted with may be wrong: one step along the curve of equal cost.
        beside = refine(model.costs, np.concatenate([along_ridge(model, points[:2])[:3],
                                                      valves_across(model, points[0], name, 3),
                                                      with_other_start(model, points[0], 2)]), rng,
                        spread=spreads(model, 0.5), rounds=_LOOK, population=14, settle=_SETTLED)
        both = join_found(polish, beside)
        points, cost = both.points, float(both.costs[0])
    return replace(found, points=points, cost=cost)


def settle_scouted(found: Scouted, name: str, rng: np.random.Generator) -> Scouted:
    """A first look polished and settled like a full refit, its points (k, d) first.

    Where friction changes along the record, a valve a little off misses slips from some time on. A look that ends there
    leaves ten times the noise, and says nothing of the effect.
    """
    found = polish_look(found, name, rng)
    model, values, cost = settle_look(found, rng)
    if not cost < found.cost:
        return found
    return replace(found, points=np.concatenate([model.cube(values[:, None]), found.points]), cost=cost)


def likeliest_point(found: Scouted, done: Refit) -> FloatArray:
    """Values (d,) of the point of a look that is likeliest under the noise model of its best point, `done`; polished.

    While an effect is missing, the free-run error is far from white and tells little of the valve.
    """
    white = done.white_model()
    named = (found.model.named(column) for column in found.model.values(found.points).T)
    cube = white.cube(np.array([white.vector(n) for n in named]).T)
    cube = cheapest_apart(white, cube, cube[:, :2], _LIKELY, _APART)
    near = descend_model(white, with_start(white, cube), turns=QUICK_TURNS, settle=QUICK_SETTLE)
    return found.model.vector(white.named(white.values(near.points[:1])[:, 0]))


def widen_by(fit: Fitted, name: str) -> Model:
    """The model of a fit with effect `name` added."""
    spec = replace(fit.model.spec, effects=(*fit.model.spec.effects, name))
    return rebind_model(fit.model, spec, fit.best.left)


def out_of_basin(model: Model, points: FloatArray, rng: np.random.Generator) -> Found:
    """Points in other basins: from an evolution strategy, beyond the limit of a drifting valve, and on a curve.

    The strategy runs longer for effects on the valve whose innovations are not white. They were fitted while something
    was missing. Slips a sample late, with a dead time a sample short, then look like one more effect. Along a curve of
    equal cost a population spreads step by step; a grid covers more of it at once.
    """
    valve = any(map(on_valve, model.effects))
    patience = ALONE if valve and not complete_quickly(model, model.values(points[:1])[:, 0]).white else PATIENCE
    found = evolve_points(model, points, rng, patience)
    beyond = beyond_rest(model, found.points[0], rng)
    if len(beyond):
        near = descend_model(model, beyond, turns=_GLANCE, settle=_GLANCED).points
        found = join_found(found, evolve_points(model, near, rng, patience))
    for _ in range(_RIDGED if ridge_of(model) is not None else 0):
        before, along = found.costs[0], follow_ridge(model, found.points[:_KEPT], rng).points[:_KEPT]
        found = evolve_points(model, np.concatenate([along, found.points]), rng)
        if found.costs[0] > before * (1.0 - _WORTH):
            break
    return found


def settle_look(look: Scouted, rng: np.random.Generator) -> tuple[Model, FloatArray, float]:
    """The scouted model at its best: values (d,) and cost."""
    model = look.model
    if model.follows_y:
        # The first look followed the y of the model without the effect, which may be far from the new one.
        own = model.evaluate(look.values).guide
        model = model.follow_guide(own)
    found = refine(model.costs, look.points[:6], rng, spread=spreads(model, 0.5), rounds=20, population=14,
                   settle=_SETTLED)
    points = found.points
    if model.spec.held and look.name and parse(look.name)[0].natural is not None:
        points = follow_ridge(model, points[:_KEPT], rng).points
    # The resting valve was found while an effect was missing, so its S may be wrong by several slips.
    others = stickbands(model, points[0]) if model.spec.held and RESTING in model.spec.effects else points[:0]
    for _ in range(_RIDGE_TURNS if model.spec.held else 1):
        near = np.concatenate([with_start(model, points[:2]), others])
        if look.name and parse(look.name)[0].at_once:
            # Another dead time asks for another valve on either side of the change.
            beside = [points[0], *(along_ridge(model, points[:1]) if model.spec.held else ())]
            near = np.concatenate([near, *(valves_after(model, p, look.name, 2) for p in beside)])
        if model.spec.held:
            near = np.concatenate([near, along_ridge(model, points[:1])[:4], with_other_start(model, points[0], 2)])
            if look.name:
                near = np.concatenate([near, valves_across(model, points[0], look.name, 4)])
        last = refine(model.costs, near, rng, spread=spreads(model, 0.4), rounds=50, population=14, settle=_SETTLED)
        before, after = model.costs(np.stack([points[0], last.points[0]]))
        points = last.points
        if after > before * (1.0 - _WORTH):
            break
    best, cost = polish_smooth(model, with_start(model, last.points[:1])[0])
    for _ in range(_TURNS):
        again = refine(model.costs, with_start(model, best[None]), rng, spread=spreads(model, 0.2), rounds=60,
                       population=16, settle=_SETTLED)
        best, now = polish_smooth(model, with_start(model, again.points[:1])[0])
        if now > cost * (1.0 - _WORTH):
            break
        cost = now
    if model.spec.held:
        best, cost = at_thresholds(model, best)
    return (*_follow_own_y(model, model.values(best[None])[:, 0]), cost)


def _follow_own_y(model: Model, values: FloatArray) -> tuple[Model, FloatArray]:
    """A model and its values (d,), polished on the y that it makes itself where an effect follows y."""
    if not model.follows_y:
        return model, values
    ends = []
    # A disturbance at the output may act on the process or behind it: each reading has an optimum of its own.
    for best in model.readings(values):
        at = values
        for _ in range(_FOLLOWED):
            own = model.follow_guide(best.guide)
            point, _ = polish_smooth(own, own.cube(at[:, None])[0])
            trial = own.values(point[None])[:, 0]
            now = own.evaluate(trial)
            if not now.sse < best.sse:
                break
            at, best = trial, now
        ends.append((best, at))
    best, values = min(ends, key=lambda end: end[0].sse)
    return model.follow_guide(best.guide), values


def at_thresholds(model: Model, point: FloatArray) -> tuple[FloatArray, float]:
    """Point (d,) with the stickband between the right samples, everything else polished; and its cost.

    Under a held command every slip allows S an interval as wide as one step of the command. All slips together allow
    one far narrower than a polish finds. A single slip a sample early or late costs more than most missing effects.
    """
    values = model.values(point[None])[:, 0]
    best, cost = point, float(model.costs(point[None])[0])
    for reach in _THRESHOLD_REACH:
        S, J = np.meshgrid(values[0] * (1.0 + np.linspace(-reach, reach, _THRESHOLDS)), values[1] * _THRESHOLD_J,
                           indexing="ij")
        grid = valve_grid(values, S.ravel(), J.ravel())
        cube = model.cube(grid)
        order = np.argsort(model.costs(cube), kind="stable")
        for k in order[distinct_points(grid[0, order, None], 2, 2.5 * reach / _THRESHOLDS * values[0])]:
            trial, now = polish_smooth(model, cube[k])
            if now < cost:
                best, cost = trial, now
        values = model.values(best[None])[:, 0]
    return best, cost


def descend_guesses(model: Model, name: str, here: FloatArray) -> Found:
    """Descents along the slips of a model from values (d,) as they are, and with each guess of one effect."""
    effect, option = parse(name)
    starts = [here]
    for guess in effect.guess(model.context_of(option)) if effect.guess else ():
        starts.append(here.copy())
        starts[-1][model.rows_of(name)] = guess
    cube = model.cube(np.array(starts).T)
    if effect.scan is not None:
        cube = np.concatenate([cube, scanned_starts(model, name, here, False)])
    return descend_model(model, cube, turns=_ALONG, settle=_ALONG_STILL)


def look_along(fit: Fitted, name: str) -> Refit:
    """One effect added to a fit along its path, from its neutral value and its guesses; the path is then settled."""
    model = widen_by(fit, name)
    here = model.vector(fit.best.values)
    near = descend_guesses(model, name, here)
    look = Scouted(model, near.points, float(near.costs[0]), float(model.costs(model.cube(here[:, None]))[0]))
    ends = [_with_force_of(model, look.values, here)]
    if parse(name)[0].friction is not None:
        # (an effect on break-away forces alone does not show along a path that is given)
        ends.append(here)
    elif not look.gain > _PROMISING:
        # The slips are those without the effect, so that what it gains along them is nearly all that it gains.
        return place_slips(complete_quickly(model, ends[0]), rounds=0, seek=False)
    found = [place_slips(complete_quickly(model, v), rounds=_PATH_ROUNDS) for v in ends]
    return min(found, key=lambda done: done.bic(done.good))


def look_under(before: Refit, model: Model, name: str) -> FloatArray:
    """Values (d,) of a model with one effect more than a completed one, found under the noise model of that."""
    white = before.white_model()
    wide = rebind_model(white, replace(white.spec, effects=model.spec.effects), before.evaluated.left)
    near = descend_guesses(wide, name, wide.vector(white.named(before.values)))
    return model.vector(wide.named(wide.values(near.points[:1])[:, 0]))


def _with_force_of(model: Model, values: FloatArray, before: FloatArray) -> FloatArray:
    """Values (d,) with the break-away force of others: PV alone says nothing of it along a path, and it drifts away.

    What a stem lands behind its command stays.
    """
    if model.law.one_parameter or not model.space.movable[:2].all():
        return values
    fs, fd = 0.5 * (before[0] + before[1]), 0.5 * (values[0] - values[1])
    found = values.copy()
    found[:2] = (fs + fd, fs - fd) if abs(fd) <= fs else before[:2]
    return found


def fit_along(fit: Fitted, spec: Spec, values: FloatArray) -> Refit:
    """A node of another structure along the path of a fit, settled from values (d,); no slip moves with all others.

    The path belongs to the node that gave it: one a command off makes up for what this structure lacks.
    """
    model = rebind_model(fit.model, replace(spec, paths=fit.model.spec.paths), fit.best.left)
    return place_slips(complete_quickly(model, values), beside=False)
