"""Valves found along paths of slips, from any start: plain, and beside a level that no slow disturbance bends.

A free run by the law misses slips on slow exports, and then no search by law finds the valve (`paths/any_valve.py`).
While a load is missing, a free run also fits the load with its valve: its S may end near 0. A piecewise straight level
takes up what is slower than a few slips, whatever it is. The slips placed beside it then show the valve. A disturbance
is looked at along these slips, in place of the level.

Wrong where a disturbance is as fast as the slips. Source: docs/details.md, section 14.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import ModelError
from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import FIRST_ORDER, INTEGRATOR, Spec
from ..paths.any_valve import any_valve, climb_slips, settle_near
from ..paths.command_error import error_range, hides_scans, likely_errors
from ..paths.likelihood import path_possible
from ..paths.settle import Settled, score_path, settle_path
from ..typing import FloatArray
from .noise.completion import TOO_FAR, Refit, along_slips, better_refit
from .points.fitted import Fitted, as_it_stands
from .starts.beside_effect import RESTING, RESTS
from .with_effect import descend_guesses, widen_by

# Corners of a level that wanders.
WANDERS = 10
# Processes to begin with: time constants by kind and dead times, in periods of the loop.
_TIME_CONSTANTS = {FIRST_ORDER: (0.03, 0.1, 0.3, 1.0), INTEGRATOR: (0.03, 0.1, 0.3)}
_DEAD_TIMES = (0.03, 0.1, 0.25)
# A time constant of so many periods is that of an integrator.
_ENDLESS = 2.0
# Multiple of the noise that no path to a valve leaves with the widest scatter. BIC that a valve settled once may lie
# behind a rival, or behind the other kind, and still be sought more closely: on 15 building loops a closer search
# gained at most 400, and what became likelier than its rival lay at most 240 behind before.
_HOPELESS, _BEHIND = 3.0, 500.0


def valves_by_paths(models: Iterable[Model], process: str, *, rests: Sequence[bool] = (False, True),
                    noise: float = np.inf, knots: int = 0, beside: Refit | None = None,
                    rival: Refit | None = None) -> list[Refit]:
    """Models along the likeliest slips of any valve: one for each kind, and the likeliest kind under other commands.

    `rests` says of each kind whether its valve rests. `models` have the possible courses of the command, the likeliest
    first; their effects are left out, but for those of a model `beside` whose effects the valves are sought. The slips
    are placed beside a level with so many `knots`; no other course is tried there, nor one under which the likeliest
    valve is far less likely. A `process` of first order that is as slow as an integrator becomes one, where that is
    likelier. A valve far behind the `rival` is not sought closely. None where every one leaves far more than the
    `noise`, in the unit of y.
    """
    kept = tuple(n for n in beside.model.spec.effects if n != RESTING) if beside else ()
    named = {} if beside is None else {name: value for name, value in beside.model.named(beside.values).items()
                                       if name.partition(":")[0] in kept}
    kinds = [(*kept, RESTING) if rest else kept for rest in rests]
    likeliest, *courses = models
    first = _first_course(likeliest, courses)

    def of_kinds(process: str) -> list[Refit]:
        placed = [p for effects in kinds if (p := _placed(first, process, effects, knots, _HOPELESS * noise, named))]
        return _of_kinds(placed, rival)

    found, free = of_kinds(process), not likeliest.spec.fixed
    if not found and free and process == INTEGRATOR:
        found = of_kinds(FIRST_ORDER)
    if not found:
        return []
    best = found[0]
    if free and process == FIRST_ORDER and best.evaluated.values["time_constant_s"] > _ENDLESS * best.model.period_s:
        found = min((found, of_kinds(INTEGRATOR)), key=lambda each: min(map(_cost, each), default=np.inf))
        best = found[0]
    others = [] if knots else [_under(best, model) for model in (likeliest, *courses) if model is not first]
    return [*found, *(done for done in others if done)]


def _first_course(likeliest: Model, courses: list[Model]) -> Model:
    """The course that explains slips best: one rebuilt at unseen scans, or one that hides scans, or any.

    A command that is held from one sample to the next explains no slip where scans are hidden.
    """
    if not likeliest.spec.held:
        return likeliest
    hiding = sorted(filter(hides_scans, (likeliest, *courses)), key=lambda m: m.parts)
    rebuilt = [m for m in hiding if m.parts > 1]
    return next(iter(rebuilt or ([] if hides_scans(likeliest) else hiding)), likeliest)


def _cost(done: Refit) -> float:
    return done.bic(done.good)


def _of_kinds(placed: Sequence[list[Settled]], rival: Refit | None) -> list[Refit]:
    """The likeliest slips of every kind of valve that was placed, the likeliest kind first.

    Each is settled once. One that is far behind the rival or the best kind then is not sought more closely. Such a one
    gets no noise model of its own, nor does one that is far less likely in the end.
    """
    once = [_settle_once(found[0]) for found in placed]
    most = min((_cost(done) for _, done in once), default=np.inf) + _BEHIND
    near = [_cost(done) <= most and (rival is None or rival.gain_over(done) <= _BEHIND) for _, done in once]
    settled = [_sought_closely(found, one) if close else one
               for found, one, close in zip(placed, once, near, strict=True)]
    limit = min((_cost(done) for _, done in settled), default=np.inf) + TOO_FAR
    coloured = [_in_colour(one, done) if close and _cost(done) <= limit else done
                for (one, done), close in zip(settled, near, strict=True)]
    return sorted((d for d in coloured if d.model.spec.paths is not None and np.isfinite(d.prior)), key=_cost)


def _settle_once(one: Settled) -> tuple[Settled, Refit]:
    """A placed valve settled from its own slips, and completed."""
    now = settle_path(one.model, one.values, error=one.paths.error, begin=one.paths,
                      within=error_range(one.model, one.values))
    return now, along_slips(now)


def _sought_closely(found: list[Settled], once: tuple[Settled, Refit]) -> tuple[Settled, Refit]:
    """The best valve near those that were found, and completed; the one settled `once` where that is likelier."""
    one = found[0]
    near = settle_near(found, one.paths.error, error_range(one.model, one.values))
    return min(((near, along_slips(near)), once), key=lambda pair: _cost(pair[1]))


def _start(model: Model, lag: float, late: float, beside: Mapping[str, float]) -> FloatArray:
    """Values (d,) of any valve and of a process with a lag and a dead time in periods, within their ranges."""
    values = model.vector({"S": model.s_max, "J": model.s_max, "initial_residual_force": 0.0,
                           "time_constant_s": lag * model.period_s, "dead_time_s": late * model.period_s,
                           **(RESTS if RESTING in model.spec.effects else {}), **beside})
    return model.values(np.clip(model.cube(values[:, None]), 0.0, 1.0))[:, 0]


def _placed(model: Model, process: str, effects: tuple[str, ...], knots: int, most: float,
            beside: Mapping[str, float]) -> list[Settled]:
    """Valves of every size of one kind beside one process, along their likeliest slips, the likeliest first."""
    spec = replace(model.spec, process=process, effects=effects, increments=False, taps=(), paths=None, guides=(),
                   knots=knots)
    free = rebind_model(model, spec, None)
    # (beside a level that wanders every start leaves little, so that fewer do)
    inner = slice(1, -1) if knots else slice(None)
    starts = [_start(free, lag, late, beside) for lag in _TIME_CONSTANTS[process][inner]
              for late in _DEAD_TIMES[:-1 if knots else None]]
    return any_valve(free, starts, likely_errors(free, starts[0])[0], most) if path_possible(free, starts[0]) else []


def _in_colour(found: Settled, done: Refit) -> Refit:
    """A model along its slips, settled anew beside its noise model: slips take up what is coloured in the noise."""
    if not done.taps.size:
        return done
    model = rebind_model(found.model, replace(found.model.spec, taps=tuple(done.taps.tolist())), None)
    beside = settle_near([score_path(model, found.values, found.paths)], found.paths.error,
                         error_range(model, found.values), tries=1)
    plain = rebind_model(model, replace(model.spec, taps=()), None)
    return better_refit(done, along_slips(score_path(plain, beside.values, beside.paths)))


def move_all_slips(done: Refit) -> Refit:
    """A completed model along slips, or a likelier one with all of them moved together, beside its noise model.

    Between two samples PV shows hardly where a slip is, and S makes up for the place of all of them. White noise tells
    less of that than the noise of the answer.
    """
    paths = done.model.spec.paths
    if paths is None or done.increments != done.model.spec.increments:
        return done
    model = rebind_model(done.model, replace(done.spec, paths=None), done.evaluated.left)
    found = climb_slips(score_path(model, done.values, paths), error_range(model, done.values))
    plain = rebind_model(model, replace(done.model.spec, paths=None), done.evaluated.left)
    return better_refit(done, along_slips(score_path(plain, found.values, found.paths)))


def _under(done: Refit, other: Model) -> Refit | None:
    """The same valve settled under another course of its command, from its values; None where that is far behind."""
    spec = replace(done.model.spec, between=other.spec.between, substeps=other.spec.substeps, guides=(), paths=None)
    model = rebind_model(other, spec, None)
    values, error = done.values, likely_errors(model, done.values)[0]
    found = settle_path(model, values, error=error, within=error_range(model, values))
    if along_slips(found).gain_over(done) < -TOO_FAR:
        return None
    near = settle_near([found], error, error_range(model, values))
    return _in_colour(near, along_slips(near))


def without_level(done: Refit) -> Fitted:
    """A model along its slips without the level that wanders."""
    model = rebind_model(done.model, replace(done.model.spec, knots=0), None)
    return as_it_stands(model, model.vector(done.model.named(done.values)))


def look_beside_wander(fit: Fitted, name: str = "") -> Refit:
    """One effect in place of a level that wandered, settled along the slips of a fit; without a `name` none."""
    model, paths = widen_by(fit, name) if name else fit.model, fit.model.spec.paths
    values = model.vector(fit.best.values)
    if name:
        near = descend_guesses(model, name, values)
        values[model.rows_of(name)] = model.values(near.points[:1])[model.rows_of(name), 0]
    assert paths is not None
    return along_slips(settle_path(model, values, error=paths.error, begin=paths, within=error_range(model, values)))


def along_path_of(done: Refit, spec: Spec) -> Fitted | None:
    """A model of a specification along the slips of a completed one; None without a path, or one its valve can't take.
    """
    if done.model.spec.paths is None:
        return None
    model = rebind_model(done.model, replace(spec, paths=done.model.spec.paths), None)
    with suppress(ModelError, np.linalg.LinAlgError):
        return as_it_stands(model, model.vector(done.model.named(done.values)))
    return None
