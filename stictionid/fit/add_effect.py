"""One effect added to a fitted model: refit, choice of the model for the study, last polish with errors and intervals.

Source: docs/details.md, section 11.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects import parse
from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import has_noise, own_taps
from ..typing import FloatArray
from .fit import finish_fit
from .noise.completion import Refit, complete_model
from .points.fitted import Fitted
from .starts.beside_effect import starting_pool
from .with_effect import scout_effect, settle_look

# Refits after which an effect that follows y has settled, and independent refits with the added effect.
_FOLLOWED, REFITS = 3, 2


def fit_with_added(fit: Fitted, name: str, rng: np.random.Generator) -> Fitted:
    """The fit of the same model with effect `name` added, ready for a step of the study."""
    done = refit_with_effect(fit, name, starting_pool(fit.model, fit.values, rng), rng)
    return polish_last(carrier(done, name, fit.model), done.values, rng)


def polish_last(model: Model, values: FloatArray, rng: np.random.Generator, *, spans: bool = True) -> Fitted:
    """Last polish of `values`, with errors, hold-out and intervals; repeated where an effect follows the model's own y.
    """
    point = model.cube(values[:, None])
    after = finish_fit(model, point, model.costs(point), rng, spans=spans)
    for _ in range(_FOLLOWED if model.follows_y else 0):
        model = rebind_model(model, model.spec, after.best.left)
        point = model.cube(after.values[:, None])
        again = finish_fit(model, point, model.costs(point), rng, spans=spans)
        # Compare models that follow their own y. One that follows the y of the fit before may predict y from y.
        if not again.best.sse < after.best.sse:
            break
        after = again
    return after


def refit_with_effect(fit: Fitted, name: str, pool: FloatArray, rng: np.random.Generator) -> Refit:
    """A fit with effect `name` added, at its best, completed with the noise model that its residual asks for."""
    noise = parse(name)[0].noise
    if noise is not None:
        return complete_model(fit.model, fit.values, pool, rng, noise=noise)
    # Two independent refits: the study should not depend on a single search.
    model, values, _ = min((settle_look(scout_effect(fit, name, pool, rng), rng) for _ in range(REFITS)),
                           key=lambda r: r[2])
    return complete_model(model, values, None, rng)


def carrier(done: Refit, name: str, before: Model) -> Model:
    """The model that a study stores after a refit; a noise model is a step of its own, never part of an effect's."""
    effects = tuple(dict.fromkeys((*before.spec.effects, name)))
    if parse(name)[0].noise is not None or has_noise(before.spec):
        spec = replace(done.spec, effects=effects)
    else:
        spec = replace(before.spec, effects=effects, taps=own_taps(before.spec))
    return rebind_model(before, spec, done.evaluated.left)
