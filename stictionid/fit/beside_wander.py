"""Valves and slips that no slow disturbance bends: found beside a level of y that wanders, then without it.

While a load is missing, a free run fits the load with its valve: its S may end near 0. A piecewise straight level takes
up what is slower than a few slips, whatever it is. The slips placed beside it (paths/settle.py) then show the valve,
from other valves and with a scatter that shrinks. A disturbance is looked at along these slips, in place of the level.

Measured on eight loops of benchmarks/plants whose load shifts or drifts, at the true structure and from one start: S
within 9 % in six and 24 % off at the most. By the free run S ended up to 98 % too small, or no valve was found.
Wrong where a disturbance is as fast as the slips. Source: docs/details.md, section 14.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import FIRST_ORDER, INTEGRATOR, Spec
from ..paths.command_error import error_range, likely_errors
from ..paths.likelihood import path_possible
from ..paths.settle import Settled, settle_beside, settle_from_any_valve, settle_path
from .noise.completion import Refit, along_slips
from .points.fitted import Fitted, as_it_stands
from .starts.beside_effect import RESTING, RESTS
from .with_effect import descend_guesses, widen_by

# Corners of the level.
_KNOTS = 10
# Processes to begin with: the time constant by kind and the dead time, in periods; S and J as shares of the largest S.
_TIME_CONSTANT, _DEAD_TIME, _S, _J = {FIRST_ORDER: 0.25, INTEGRATOR: 0.05}, 0.05, 0.6, 0.3
# A time constant of so many periods is that of an integrator.
_ENDLESS = 2.0


def valves_beside_wander(models: Iterable[Model], *, may_rest: bool) -> list[Fitted]:
    """Models along slips that were placed beside a level that wanders, without that level, under the likeliest command.

    `models` have the possible courses of the command; their effects are left out. There is one result for each kind of
    valve, or one alone where the valve may not rest. A process as slow as an integrator is one.
    """
    kinds = [(), (RESTING,)] if may_rest else [()]
    each = [[s for effects in kinds if (s := _placed(model, FIRST_ORDER, effects)) is not None] for model in models]
    found = min(filter(None, each), key=lambda kind: min(s.deviance for s in kind), default=[])
    if not found:
        return []
    best = min(found, key=lambda s: s.deviance)
    if best.model.named(best.values)["time_constant_s"] > _ENDLESS * best.model.period_s and not best.model.spec.fixed:
        found = [s for effects in kinds if (s := _placed(best.model, INTEGRATOR, effects)) is not None]
    return [_without_level(s) for s in found]


def _placed(model: Model, process: str, effects: tuple[str, ...]) -> Settled | None:
    """The likeliest slips of one kind of valve and process beside a level that wanders; None where it has none."""
    spec = replace(model.spec, process=process, effects=effects, increments=False, taps=(), paths=None, guides=(),
                   knots=_KNOTS)
    free = rebind_model(model, spec, None)
    period = free.period_s
    values = free.vector({"S": _S * free.s_max, "J": _J * free.s_max, "initial_residual_force": 0.0,
                          "time_constant_s": _TIME_CONSTANT[process] * period, "dead_time_s": _DEAD_TIME * period,
                          **(RESTS if effects else {})})
    if not path_possible(free, values):
        return None
    within = error_range(free, values)
    found = settle_from_any_valve(free, values, likely_errors(free, values)[0], within)
    # (with a wide scatter S and the dead time make up for each other)
    found = settle_beside(found, within=within)
    return found if np.isfinite(found.deviance) else None


def _without_level(found: Settled) -> Fitted:
    """A model along its slips without the level that wanders."""
    model = rebind_model(found.model, replace(found.model.spec, knots=0, paths=found.paths), None)
    return as_it_stands(model, model.vector(found.model.named(found.values)))


def look_beside_wander(fit: Fitted, name: str = "") -> Refit:
    """One effect in place of a level that wandered, settled along the slips of a fit; without a `name` none."""
    model, paths = widen_by(fit, name)[0] if name else fit.model, fit.model.spec.paths
    values = model.vector(fit.best.values)
    if name:
        near = descend_guesses(model, name, values)
        values[model.rows_of(name)] = model.values(near.points[:1])[model.rows_of(name), 0]
    assert paths is not None
    return along_slips(settle_path(model, values, error=paths.error, begin=paths, within=error_range(model, values)))


def without_effect(done: Refit, spec: Spec) -> Fitted:
    """A model of a specification along the slips of a completed one that has an effect more."""
    model = rebind_model(done.model, replace(spec, paths=done.model.spec.paths), None)
    return as_it_stands(model, model.vector(done.model.named(done.values)))
