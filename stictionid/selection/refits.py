"""Full fits of a known node: without one of its effects, from the values of its children, or once more.

Source: docs/details.md, section 11.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from ..effects import parse
from ..errors import ModelError
from ..fit.noise.completion import Refit, place_slips
from ..fit.points.fitted import Fitted, as_it_stands
from ..fit.points.moves import descend_model, with_start
from ..fit.starts.beside_effect import LAG, SECOND_LAG, on_valve
from ..fit.with_effect import Scouted, fit_along, out_of_basin, settle_look
from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import FIRST_ORDER, Spec
from ..typing import FloatArray
from .looks import Ground, bound_as, rng_of
from .node import BASE_EFFECTS, key, node
from .policy import Policy
from .score import Scored, complete_as_is, complete_fit, complete_with_noise


def refit_in_full(model: Model, values: FloatArray, rng: np.random.Generator, *,
                  basins: bool = False) -> tuple[Model, FloatArray, float]:
    """A model, its values (d,) and cost, fitted in full from values that another set of effects gave.

    A slip that is a sample late looks like noise, and a polish does not move it. With `basins`, under a held command, a
    population also searches the neighbouring basins, which moves it.
    """
    points = with_start(model, model.cube(values[:, None]))
    if basins and model.spec.held:
        points = out_of_basin(model, points, rng).points
    name = next((n for n in reversed(model.spec.effects) if on_valve(parse(n)[0])), "")
    return settle_look(Scouted(model, points, np.inf, np.inf, name), rng)


def fit_without(fit: Fitted, spec: Spec, name: str, rng: np.random.Generator, policy: Policy,
                instead: Mapping[str, float] | None = None) -> Refit:
    """A node without one of its effects (`spec`), fitted from its own values and from those of what is there `instead`.

    Without an effect of the base the node gets a full fit, because that effect distorted the valve.
    """
    model = rebind_model(fit.model, spec, fit.best.left)
    named = {**fit.model.named(fit.values), **(instead or {})}
    if name == LAG and spec.process == FIRST_ORDER:
        # Either of two lags in series may be the longer one, which stays.
        named["time_constant_s"] = max(named["time_constant_s"], named[SECOND_LAG])
    values = model.vector(named)
    if fit.model.spec.paths is not None:
        return fit_along(fit, spec, values)
    first = complete_as_is(model, values)
    if name in BASE_EFFECTS:
        model, values, _ = refit_in_full(model, values, rng)
    else:
        start = model.cube(values[:, None])
        values = model.values(descend_model(model, np.concatenate([start, with_start(model, start)])).points[:1])[:, 0]
    done = complete_with_noise(model, values, rng, policy)
    # In differences of y one slip in a wrong sample costs little. Beside a rest that hardly rests the fit stays put.
    return complete_with_noise(model, first.values, rng, policy) if first.gain_over(done) > 0.0 else done


def from_children(ground: Ground, spec: Spec, parent: Scored, children: Sequence[Scored]) -> Scored:
    """A node refitted from the values and from the paths of its children; unchanged where no refit is better."""
    found = _hand_back_values(ground.fit, children, ground.policy)
    done = None
    with suppress(ModelError, np.linalg.LinAlgError):  # (a valve on the way may not take the path)
        done = found and complete_with_noise(*found, rng_of(ground.seed, key(spec), 1), ground.policy,
                                             lambda: ground.pool)
    for better in (done, _hand_back_path(parent, spec, children, ground.policy)):
        if better is not None and better.gain_over(parent.done) > 0.0:
            parent = Scored(better)
    return parent


def _hand_back_values(fit: Fitted, children: Sequence[Scored], policy: Policy) -> tuple[Model, FloatArray] | None:
    """A node's model and values (d,) from those of its children, polished or not; None where none is better.

    A node fitted to differences of y is also fitted to levels.
    """
    known, before, best = fit.model.named(fit.values), complete_fit(fit), None
    levels = node(fit.model.spec)
    for model in (fit.model, *(bound_as(fit, spec) for spec in (levels,) if spec != fit.model.spec)):
        starts = np.stack([model.vector({n: v for n, v in c.done.model.named(c.done.values).items()
                                         if n in known}) for c in children], axis=1)
        cube = model.cube(starts)
        # A descent on the free-run error may leave a basin that only the innovations show, so both points are tried.
        for values in model.values(np.concatenate([descend_model(model, cube).points[:1], cube])).T:
            found = complete_as_is(model, values)
            if found.gain_over(before) > policy.better_fit:
                # (by its law, or along its slips, whichever is likelier there)
                before, best = found, (model.along(found.model.spec.paths), values)
    return best


def _hand_back_path(parent: Scored, spec: Spec, children: Sequence[Scored], policy: Policy) -> Refit | None:
    """A node of a spec settled from the path and the values of its best child; None where no child has a better path.

    A path depends on the values that it was found from. So a parent in another basin looks like a missing effect.
    """
    found = [c.done for c in children if c.done.model.spec.paths is not None
             and c.done.gain_over(parent.done) > policy.better_fit]
    if not found:
        return None
    best = max(found, key=lambda done: done.gain_over(parent.done))
    model = rebind_model(best.model, spec, best.evaluated.left)
    return fit_along(as_it_stands(best.model, best.values), spec, model.vector(best.model.named(best.values)))


def settle_again(scored: Scored, spec: Spec, seed: int, policy: Policy) -> Scored:
    """A node fitted once more from its own point, in levels and in the form that it has; the best of them."""
    done, rng = scored.done, rng_of(seed, key(spec), 2)
    if done.model.spec.paths is not None:
        again = place_slips(done, other_valves=True)
        return Scored(again) if again.gain_over(done) > 0.0 else scored
    for soft in dict.fromkeys((False, done.increments)):
        model = rebind_model(done.model, node(spec, soft=soft), done.evaluated.left)
        model, values, cost = refit_in_full(model, model.vector(done.model.named(done.values)), rng, basins=True)
        if not np.isfinite(cost):
            continue
        again = complete_with_noise(model, values, rng, policy)
        if again.gain_over(scored.done) > 0.0:
            scored = Scored(again)
    return scored
