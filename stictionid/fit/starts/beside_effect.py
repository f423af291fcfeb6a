"""Starts for a model with one more effect: pools of base parameters, and valves that fit the effect.

A missing effect moves S and J into a wrong basin. Its refit therefore starts warm from the model so far and fresh from
new basins. Source: METHODS.md section 4, trap 3, and section 6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...effects import built_in, parse
from ...effects.contract import Effect, Place
from ...model.model import Model
from ...model.segments import bound
from ...model.spec import BASE, INTEGRATOR, Spec
from ...numerics.population import swarm, together
from ...typing import FloatArray
from ..fit import Fitted, search
from ..moves import first_distinct, longest_piece, search_model, with_start
from ..noise.completion import at_noise, own_taps, quick
from .basins import basins, grown, valve_costs, with_process
from .continuation import distinct, grown_beside, grown_valves
from .reparametrised import followed, ridge_of
from .windows import resting_valves, windowed_valves

# Basins of the base that refits start from: from swarms, and from a search on growing parts of the record.
_SWARMED, _GROWN = 2, 2
# A scan across valves: shares of S, of J as a share of S, and steps of the effect (shares of its range).
_ACROSS_STEP = 0.01
_ACROSS_S = 1.0 + _ACROSS_STEP * np.arange(-16, 17)
_ACROSS_J, _ACROSS_EFFECT = np.array([0.7, 0.85, 1.0, 1.15, 1.35]), np.array([-0.1, -0.04, -0.015, 0.015, 0.04, 0.1])
# A scan for another S of a valve that rests: shares of S and of J.
_BAND_S, _BAND_J = np.exp(0.004 * np.arange(-30, 31)), np.array([0.97, 0.985, 1.0, 1.015, 1.03])
# Rounds and scouts of the swarm over the valve for each guess of an effect, and most guesses that get a swarm.
_SWARM, _SCOUTS, _GUESSES = 14, 250, 6
# A scan of every valve with each guess of an effect: S from this share of its limit, and J as shares of S. A quick one
# and a long one have so many S, valves that get a start of their own, and valves kept, apart in S or J by a share.
_ALL_S, _ALL_J, _ALL_APART = 0.08, np.array([0.1, 0.3, 0.5, 0.7, 0.9, 1.1]), 0.02
_QUICK_SCAN, _LONG_SCAN = (40, 12, 2), (80, 60, 16)
# Valves with another S beside a point.
_STICKBANDS = 4
# Searches along a curve of equal cost. Another one needs a first cost below this share of that of the model so far. The
# last number is the J, as a share of S, above which it is tried in any case (J > S is a kinetic friction below 0).
_GROWTHS, _PROMISES, _BEYOND = 3, 0.8, 0.9
# The effect of a valve that rests between the scans of a held command.
RESTING = built_in(lambda effect: effect.by_itself and effect.place is Place.FRICTION)
# The law of a valve that rests at every sample.
_RESTS_ALWAYS = "he"
# Above any speed of a command; a model cuts it to its own range, which is that of its part of the record. Unit: % / s.
_ANY_SPEED = 1e9


def valves_of(model: Model, rng: np.random.Generator) -> list[dict[str, float]]:
    """Named values for the valve of a model with its effects and further lags, whatever valve it has now.

    The search begins on a tenth of the record, where the basins of a valve are wide, and goes on to longer parts. A
    valve that rests is searched with a law that has no sliding state. Where nothing else acts on it a second search
    begins on the whole record. A valve may also slide for a while: a further search has the speed
    at which it comes to rest.
    """
    spec = model.spec
    resting = RESTING in spec.effects
    own = tuple(name for name, effect in zip(model.names, model.effects, strict=True)
                if effect.place is Place.PROCESS or on_valve(effect))
    always = tuple(name for name in own if name != RESTING)

    def law_of(name: str, effects: tuple[str, ...]) -> Model:
        return search_model(bound(model.loop, Spec(law=name, process=spec.process, effects=effects,
                                                   between=spec.between, substeps=spec.substeps,
                                                   increments=spec.increments, taps=own_taps(spec), fixed=spec.fixed,
                                                   guides=spec.guides), s_max=model.s_max, period_s=model.period_s))

    law = law_of(_RESTS_ALWAYS if resting else spec.law, always)
    found = grown(law, rng)
    if resting and not any(on_valve(effect) for effect in law.effects):
        found = np.concatenate([search(law, rng)[0], found])
    rests = {f"{RESTING}:{p.name}": _ANY_SPEED for p in parse(RESTING)[0].parameters} if resting else {}
    valves = [{**law.named(column), **rests} for column in law.values(found).T]
    if resting:
        slides = law_of(spec.law, own)
        valves += [slides.named(column) for column in slides.values(grown(slides, rng)).T]
    return valves


def starting_pool(model: Model, values: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Values (k, 5) of the base parameters to start refits from: the fit so far and fresh basins."""
    spec = Spec(law=model.spec.law, process=model.spec.process, between=model.spec.between,
                substeps=model.spec.substeps, increments=model.spec.increments, taps=own_taps(model.spec),
                fixed=model.spec.fixed, guides=model.spec.guides)
    base = bound(model.loop, spec, s_max=model.s_max, period_s=model.period_s)
    # Swarms on the one-step error, and a search that assumes no process: they fail on different records.
    plain = undisturbed(base, model, values)
    far = np.concatenate([basins(plain, rng)[:_SWARMED], grown_valves(plain, _valve_of(base, ()), rng)[:_GROWN]])
    fresh = base.values(with_process(base, far))[:len(BASE)].T
    friction = tuple(x.name for x in model.effects if x.friction is not None)
    if friction:
        # A valve that rests has other basins than one that slides.
        own = bound(model.loop, replace(spec, effects=friction), s_max=model.s_max, period_s=model.period_s)
        plain = undisturbed(own, model, values)
        found = with_process(own, grown_valves(plain, _valve_of(plain, friction), rng)[:_GROWN])
        fresh = np.concatenate([own.values(found)[:len(BASE)].T, fresh])
    return np.concatenate([values[None, :len(BASE)], fresh])


def _valve_of(model: Model, names: Sequence[str]) -> list[int]:
    """Columns of the unit cube that decide how the valve moves, the parameters of the named effects included."""
    rows = (model.rows_of(name) for name in names)
    return [0, 1, model.forces[longest_piece(model)], *(i for r in rows for i in range(r.start, r.stop))]


def undisturbed(model: Model, before: Model, values: FloatArray) -> Model:
    """A model without its linear effects, on the record less the disturbances of `before` at values (d,).

    A search that assumes no process knows no disturbances either: a sine that is already known would mislead it.
    """
    known = {name for name, effect in zip(before.names, before.effects, strict=True) if effect.columns}
    if not known:
        return model
    loop = model.loop
    rest = loop.process_value - before.disturbance(values, before.evaluate(values).own)
    return bound(replace(loop, process_value=rest),
                 replace(model.spec, effects=tuple(name for name in model.spec.effects if name not in known)),
                 s_max=model.s_max, period_s=model.period_s)


def narrow(name: str) -> bool:
    """True where an effect has its valves in basins that no even scan of S and J meets under a held command.

    A valve that rests has a basin for each sample of a slip; one that overshoots has an oblique curve.
    """
    return bool(name) and (name == RESTING or parse(name)[0].natural is not None)


def changes(name: str) -> bool:
    """True where an effect is friction that changes along the record."""
    return parse(name)[0].profile is not None


def on_valve(effect: Effect) -> bool:
    """True where an effect acts on the valve: on its friction, its stem or its trim."""
    return effect.place.value <= Place.TRIM.value


def valve_basins(model: Model, name: str, guesses: FloatArray, fit: Fitted, rng: np.random.Generator) -> FloatArray:
    """Starts (k, d) whose valve fits the effect, each with its process.

    Effects on friction get a search on growing parts of the record, because their basins are narrow and far from the
    base's. Beside a valve that rests they get a search on windows, too. So do effects on the stem there and under a
    command that moves between samples. Other effects get swarms over the valve on the one-step error, which stays local
    in time. Each guess of the effect has its own swarm, because the right S and J differ.
    """
    rows, at = model.rows_of(name), longest_piece(model)
    effect = parse(name)[0]
    if effect.friction is not None or (effect.place is Place.STEM
                                          and (RESTING in model.spec.effects or not model.spec.held)):
        found = _grown_with(model, name, fit, rng)
        return found if ridge_of(model) is None or not model.spec.held else _ridges(model, name, fit, found, rng)
    costs = valve_costs(model.pieces[at])
    valve = [0, 1, model.forces[at]]
    middle = model.values(np.full((1, model.space.size), 0.5))
    middle[model.head:, 0] = model.vector(fit.best.values)[model.head:]
    starts: list[tuple[float, FloatArray]] = []
    for guess in guesses[:_GUESSES]:
        base = middle.copy()
        base[rows, 0] = guess
        fixed = model.cube(base)[0]

        def whole(part: FloatArray, fixed: FloatArray = fixed) -> FloatArray:
            cube = fixed[None].repeat(len(part), axis=0)
            cube[:, valve] = part
            return cube

        def cost(part: FloatArray, whole: Callable[[FloatArray], FloatArray] = whole) -> FloatArray:
            return costs(model.of(at, model.values(whole(part))))

        best = swarm(cost, 3, rng, groups=1, particles=24, rounds=_SWARM, scouts=_SCOUTS)
        starts.append((float(best.costs[0]), whole(best.points[:1])[0]))
    starts.sort(key=lambda f: f[0])
    return with_process(model, np.array([f[1] for f in starts[:3]]))


def _grown_with(model: Model, name: str, fit: Fitted, rng: np.random.Generator) -> FloatArray:
    """Starts (k, d) for an effect on friction or the stem, from growing parts of the record, each with its process.

    Beside a valve that rests, searches for such a valve are added. Friction that changes with time gets windows in an
    integrator. Parts that grow from the beginning found it in none of 5 scanned loops, windows in 3 of 3.
    """
    plain = undisturbed(model, fit.model, fit.values)
    cube = grown_valves(plain, _valve_of(plain, (name,)), rng)
    if RESTING in plain.spec.effects and name != RESTING and plain.spec.held and ridge_of(model) is None:
        cube = np.concatenate([resting_valves(plain, (name,), plain.rows_of(RESTING), rng), cube])
    elif changes(name) and plain.spec.held and plain.spec.process == INTEGRATOR:
        rows = plain.rows_of(name)
        cube = np.concatenate([windowed_valves(plain, [0, 1, *range(rows.start, rows.stop)], None, rng), cube])
    found = with_process(model, as_in(model, plain, cube, fit))
    if model.spec.held:
        return found
    beside = grown_beside(plain, _valve_of(plain, (name,)), plain.vector(fit.best.values), rng)
    return np.concatenate([as_in(model, plain, beside, fit), found])


def as_in(model: Model, plain: Model, points: FloatArray, fit: Fitted) -> FloatArray:
    """Points (k, d) of a model without its linear effects as points of the model, those effects as in a fit."""
    named = [{**fit.best.values, **plain.named(column)} for column in plain.values(points).T]
    return model.cube(np.stack([model.vector(n) for n in named], axis=1))


def _ridges(model: Model, name: str, fit: Fitted, starts: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Starts (k, d) followed along their curve of equal cost, best first; repeated while it helps, above the noise.

    One search in two ends on the curve. Where the curve leads nowhere, more searches are useless. The exception is a
    model so far with a slip jump that no friction makes: only a stem that overshoots has slips that long.
    """
    found = followed(model, starts, rng)
    asked = fit.best.values["J"] > _BEYOND * fit.best.values["S"]
    for _ in range(_GROWTHS - 1):
        helps = asked or found.costs[0] < _PROMISES * fit.sse
        if not helps or at_noise(quick(model, model.values(found.points[:1])[:, 0])):
            break
        found = together(found, followed(model, _grown_with(model, name, fit, rng), rng))
    return found.points


def across(model: Model, point: FloatArray, name: str, count: int) -> FloatArray:
    """The best few valves (count, d) around a point (d,) with its process fixed, distinct in S.

    Break-away, slip jump and effect trade against each other. The cost has a step for every sample at which the valve
    might break away, and a polish cannot cross them.
    """
    rows = model.rows_of(name)
    values = model.values(point[None])[:, 0]
    share = np.clip(values[1] / max(values[0], 1e-12), 0.02, None)
    moves = np.zeros((1 + (rows.stop - rows.start) * _ACROSS_EFFECT.size, rows.stop - rows.start))
    for i in range(rows.stop - rows.start):
        moves[1 + i * _ACROSS_EFFECT.size:1 + (i + 1) * _ACROSS_EFFECT.size, i] = _ACROSS_EFFECT
    S, J, E = np.meshgrid(_ACROSS_S, _ACROSS_J, np.arange(len(moves)), indexing="ij")
    grid = values[:, None].repeat(S.size, axis=1)
    grid[0], grid[1] = values[0] * S.ravel(), values[0] * S.ravel() * share * J.ravel()
    trial = model.cube(grid)
    trial[:, rows] = np.clip(trial[:, rows] + moves[E.ravel()], 0.0, 1.0)
    order = np.argsort(model.costs(trial), kind="stable")
    return trial[order[distinct(S.ravel()[order, None], count, 1.5 * _ACROSS_STEP)]]


def guessed_valves(model: Model, name: str, guesses: FloatArray, known: FloatArray, far: bool) -> FloatArray:
    """The best few valves (k, d) of an even scan, each with the best guess of the effect; the process is a known one.

    A missing effect bends S and J far, but the process little: values `known` (d,) are those of the model so far. A far
    look takes a finer scan, and more valves of it.
    """
    steps, started, kept = _LONG_SCAN if far else _QUICK_SCAN
    S, share, k = (g.ravel() for g in np.meshgrid(np.geomspace(_ALL_S, 1.0, steps), _ALL_J, np.arange(len(guesses)),
                                                  indexing="ij"))
    grid = known[:, None].repeat(S.size, axis=1)
    grid[0] = model.s_max * S
    grid[1] = grid[0] * share
    grid[model.rows_of(name)] = guesses[k].T
    found = model.cube(grid)
    found = found[np.argsort(model.costs(found), kind="stable")]
    found = with_start(model, found[first_distinct(found, started, _ALL_APART)])
    found = found[np.argsort(model.costs(found), kind="stable")]
    return found[first_distinct(found, kept, _ALL_APART)]


def stickbands(model: Model, point: FloatArray) -> FloatArray:
    """The best few valves (k, d) with another S beside a point (d,), each with its start, distinct in S.

    The slips of a valve that rests between scans determine J at once. Every S has a start that fits most of the slips;
    only the right S fits all.
    """
    values = model.values(point[None])[:, 0]
    S, J = (g.ravel() for g in np.meshgrid(_BAND_S, _BAND_J, indexing="ij"))
    grid = values[:, None].repeat(S.size, axis=1)
    grid[0], grid[1] = values[0] * S, values[1] * J
    trial = with_start(model, model.cube(grid))
    order = np.argsort(model.costs(trial), kind="stable")
    return trial[order[distinct(S[order, None], _STICKBANDS, 1.5 * _ACROSS_STEP)]]
