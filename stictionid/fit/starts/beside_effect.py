"""Starts for a model with one more effect: pools of base parameters, and valves that fit the effect.

A missing effect moves S and J into a wrong basin. Its refit therefore starts warm from the model so far and fresh from
new basins. Source: docs/details.md, sections 6.3 and 11.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...effects import built_in, parse
from ...effects.contract import Effect, Place
from ...model.model import Model
from ...model.segments import bind_model, rebind_model
from ...model.spec import BASE, INTEGRATOR, SOFT, Spec, own_taps
from ...typing import FloatArray
from ..points.fitted import Fitted
from ..points.moves import cheapest_apart, neutral_point, valve_grid, with_start
from .basins import basins, grow_starts, with_process
from .continuation import grown_valves

# Basins of the base that refits start from: from swarms, and from a search on growing parts of the record.
_SWARMED, _GROWN = 2, 2
# A grid across valves: shares of S, of J as a share of S, and steps of the effect (shares of its range).
_ACROSS_STEP = 0.01
_ACROSS_S = 1.0 + _ACROSS_STEP * np.arange(-16, 17)
_ACROSS_J, _ACROSS_EFFECT = np.array([0.7, 0.85, 1.0, 1.15, 1.35]), np.array([-0.1, -0.04, -0.015, 0.015, 0.04, 0.1])
# A grid for another S of a valve that rests: shares of S and of J.
_BAND_S, _BAND_J = np.exp(0.004 * np.arange(-30, 31)), np.array([0.97, 0.985, 1.0, 1.015, 1.03])
# A grid of every valve with each guess of an effect: S from this share of its limit, J as shares of S, and number of S.
# Then valves that get a start of their own, and valves kept, apart in S or J by a share.
_ALL_S, _ALL_J, _ALL_STEPS = 0.08, np.array([0.1, 0.3, 0.5, 0.7, 0.9, 1.1]), 40
_ALL_STARTED, _ALL_KEPT, _ALL_APART = 12, 2, 0.02
# Valves with another S beside a point.
_STICKBANDS = 4
# The effects of a further lag of the process, with the name of its value, and of a valve that rests between the scans
# of a held command.
LAG = built_in(lambda effect: effect.by_itself and effect.place is Place.PROCESS)
SECOND_LAG = f"{LAG}:{parse(LAG)[0].parameters[0].name}"
RESTING = built_in(lambda effect: effect.by_itself and effect.place is Place.FRICTION)
# The law of a valve that rests at every sample.
_RESTS_ALWAYS = "he"
# Parameters of a valve that rests at every scan: a speed above that of any command, in % / s. A model cuts it to its
# own range, which is that of its part of the record.
RESTS = {f"{RESTING}:{p.name}": 1e9 for p in parse(RESTING)[0].parameters}


def resting_valves(model: Model, rng: np.random.Generator, *, sometimes: bool = False) -> list[dict[str, float]]:
    """Named values for a valve that rests, with the process and the further lags of a model, whatever valve it has.

    Under a held command it rests at every scan. One search has a law without a sliding state and the process of the
    model. It begins on a tenth of the record, where the basins of a valve are wide. Another one assumes no process.
    Where the command moves, and for a valve that rests `sometimes`, the speed at which it does is searched, too: with
    one number more right valves are missed.
    """
    spec = model.spec
    lags = tuple(n for n, effect in zip(model.names, model.effects, strict=True) if effect.place is Place.PROCESS)
    always = spec.held and not sometimes

    def valve_model(law: str, effects: tuple[str, ...]) -> Model:
        soft = spec.process == INTEGRATOR
        plain = Spec(law=law, process=spec.process, effects=effects, between=spec.between, substeps=spec.substeps,
                     increments=soft, taps=SOFT if soft else (), fixed=spec.fixed, guides=spec.guides)
        return rebind_model(model, plain)

    slides = valve_model(spec.law, (*lags, RESTING))
    names = () if always else (RESTING,)
    known = slides.named(slides.values(neutral_point(slides)[None])[:, 0]) | RESTS
    found = grown_valves(slides, names, rng, slides.vector(known) if always else None)
    valves = [slides.named(column) for column in slides.values(found).T]
    if always:
        law = valve_model(_RESTS_ALWAYS, lags)
        valves += [{**law.named(column), **RESTS} for column in law.values(grow_starts(law, rng)).T]
    return valves


def starting_pool(model: Model, values: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Values (k, 5) of the base parameters to start refits from: the fit so far and fresh basins."""
    spec = Spec(law=model.spec.law, process=model.spec.process, between=model.spec.between,
                substeps=model.spec.substeps, increments=model.spec.increments, taps=own_taps(model.spec),
                fixed=model.spec.fixed, guides=model.spec.guides)
    base = rebind_model(model, spec)
    # Swarms on the one-step error, and a search that assumes no process: they fail on different records.
    plain = take_out_disturbances(base, model, values)
    far = np.concatenate([basins(plain, rng)[:_SWARMED], grown_valves(plain, (), rng)[:_GROWN]])
    fresh = base.values(with_process(base, far))[:len(BASE)].T
    friction = tuple(x.name for x in model.effects if x.friction is not None and not x.at_once)
    if friction:
        # A valve that rests has other basins than one that slides.
        own = rebind_model(model, replace(spec, effects=friction))
        plain = take_out_disturbances(own, model, values)
        found = with_process(own, grown_valves(plain, friction, rng)[:_GROWN])
        fresh = np.concatenate([own.values(found)[:len(BASE)].T, fresh])
    return np.concatenate([values[None, :len(BASE)], fresh])


def take_out_disturbances(model: Model, before: Model, values: FloatArray) -> Model:
    """A model without its linear effects, on the record less the disturbances of `before` at values (d,).

    A search that assumes no process knows no disturbances either: a sine that is already known would mislead it.
    """
    known = {name for name, effect in zip(before.names, before.effects, strict=True) if effect.columns}
    if not known:
        return model
    loop = model.loop
    rest = loop.process_value - before.disturbance(values, before.evaluate(values).own)
    return bind_model(replace(loop, process_value=rest),
                      replace(model.spec, effects=tuple(name for name in model.spec.effects if name not in known)),
                      s_max=model.s_max, period_s=model.period_s)


def on_valve(effect: Effect) -> bool:
    """True where an effect acts on the valve: on its friction, its stem or its trim."""
    return effect.place.value <= Place.TRIM.value


def open_valves(model: Model, name: str, fit: Fitted, rng: np.random.Generator) -> FloatArray:
    """Starts (k, d) whose valve fits effect `name`, each with its process, from searches that assume no process.

    They assume no disturbances either: those that the fit knows are taken out of y. A valve that may rest is searched
    together with the speed at which it does. Under a held command it rests at every scan or at none: one number less to
    search.
    Other effects on the valve stay as they are in the fit. Measured with the true specification on 43 loops of
    benchmarks/plants under a held command, with a valve that rests and another effect on it: 30 valves are found, and
    27 where the speed is searched, too. Under a command that moves 17 of 36 are, and 24 with the speed.
    """
    plain = take_out_disturbances(model, fit.model, fit.values)
    names = [n for n in plain.names if n in (name, RESTING)]
    known = {n: v for n, v in fit.best.values.items() if n.partition(":")[0] not in names}
    slides = np.empty((0, plain.space.size))
    if plain.spec.held and len(names) > 1:
        # While the effect is missing, a valve that slides may look like one that rests. It is found easily: with a stop
        # in a tank (seeds 31000 to 31011, 74013 to 74023) by 36 of 36 generators, one that rests by 8 of 16.
        names, never = [name], dict.fromkeys(RESTS, 0.0)
        slides = grown_valves(plain, names, rng, plain.vector({**known, **never}), once=True)
        known |= RESTS
    found = plain.values(np.concatenate([grown_valves(plain, names, rng, plain.vector(known)), slides]))
    # The linear effects stay as they are in the fit.
    named = [{**fit.best.values, **plain.named(column)} for column in found.T]
    return with_process(model, model.cube(np.stack([model.vector(n) for n in named], axis=1)))


def valves_across(model: Model, point: FloatArray, name: str, count: int) -> FloatArray:
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
    trial = model.cube(valve_grid(values, values[0] * S.ravel(), values[0] * S.ravel() * share * J.ravel()))
    trial[:, rows] = np.clip(trial[:, rows] + moves[E.ravel()], 0.0, 1.0)
    return cheapest_apart(model, trial, S.reshape(-1, 1), count, 1.5 * _ACROSS_STEP)


def guessed_valves(model: Model, name: str, guesses: FloatArray, known: FloatArray) -> FloatArray:
    """The best few valves (k, d) of an even grid, each with the best guess of the effect; the process is a known one.

    A missing effect bends S and J far, but the process little: values `known` (d,) are those of the model so far.
    """
    S, share, k = (g.ravel() for g in np.meshgrid(np.geomspace(_ALL_S, 1.0, _ALL_STEPS), _ALL_J,
                                                  np.arange(len(guesses)), indexing="ij"))
    grid = valve_grid(known, model.s_max * S, model.s_max * S * share)
    grid[model.rows_of(name)] = guesses[k].T
    found = model.cube(grid)
    found = with_start(model, cheapest_apart(model, found, found[:, :2], _ALL_STARTED, _ALL_APART))
    return cheapest_apart(model, found, found[:, :2], _ALL_KEPT, _ALL_APART)


def stickbands(model: Model, point: FloatArray) -> FloatArray:
    """The best few valves (k, d) with another S beside a point (d,), each with its start, distinct in S.

    The slips of a valve that rests between scans determine J at once. Every S has a start that fits most of the slips;
    only the right S fits all.
    """
    values = model.values(point[None])[:, 0]
    S, J = (g.ravel() for g in np.meshgrid(_BAND_S, _BAND_J, indexing="ij"))
    trial = with_start(model, model.cube(valve_grid(values, values[0] * S, values[1] * J)))
    return cheapest_apart(model, trial, S[:, None], _STICKBANDS, 1.5 * _ACROSS_STEP)
