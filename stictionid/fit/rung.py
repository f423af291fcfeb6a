"""The last fit of one model, as a rung of a study's ladder: polish, intervals, unnamed noise, and its step.

Source: docs/details.md, section 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects import noises_in, parse
from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import FIRST_ORDER, Spec, has_noise, own_taps
from ..record.loop import Finding
from ..record.study import Step
from ..typing import FloatArray
from .adequacy import CONDITIONAL, LOAD_OR_OUTPUT, NOISE_MODEL
from .context import Run
from .fit import finish_fit, include_intervals
from .intervals.along_path import finish_along
from .noise.completion import Refit, complete_model
from .noise.prewhitening import whiten_model
from .points.fitted import Fitted
from .starts.beside_effect import starting_pool
from .with_effect import scout_effect, settle_look

# Refits after which an effect that follows y has settled, and independent refits with an added effect.
_FOLLOWED, _REFITS = 3, 2
# Specification of a model and its values (d,).
Rung = tuple[Spec, FloatArray]


def fit_rung(model: Model, values: FloatArray, rng: np.random.Generator, *, last: bool, spans: bool = True) -> Fitted:
    """A rung with its last polish and errors; the `last` one also gets intervals, unless `spans` is False."""
    if model.spec.paths is not None:
        return finish_along(model, values, last=last and spans)
    if last:
        return polish_last(model, values, rng, spans=spans)
    point = model.cube(values[:, None])
    return finish_fit(model, point, model.costs(point), rng, reach=False)


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


def fit_with_added(fit: Fitted, name: str, rng: np.random.Generator) -> Fitted:
    """The fit of the same model with effect `name` added, ready for a step of the study.

    It is completed with the noise model that its residual asks for. That one is a step of its own, never part of an
    effect's.
    """
    before, noise, pool = fit.model, parse(name)[0].noise, starting_pool(fit.model, fit.values, rng)
    if noise is not None:
        done = complete_model(before, fit.values, pool, rng, noise=noise)
    else:
        # Two independent refits: the study should not depend on a single search.
        model, values, _ = min((settle_look(scout_effect(fit, name, pool, rng), rng) for _ in range(_REFITS)),
                               key=lambda r: r[2])
        done = complete_model(model, values, None, rng)
    stored = done.spec if noise is not None or has_noise(before.spec) else \
        replace(before.spec, taps=own_taps(before.spec))
    spec = replace(stored, effects=tuple(dict.fromkeys((*before.spec.effects, name))))
    return polish_last(rebind_model(before, spec, done.evaluated.left), done.values, rng)


def in_colour(model: Model, values: FloatArray, done: Refit) -> Rung:
    """A first-order process refitted under the autoregression of its residual; unchanged for a white residual.

    Least squares assume a white residual. A coloured one distorts process and slips, whether its noise is named or not.
    The refit starts from the given values and from those of the completed model. An integrator is fitted to differences
    already. A noise model with a root near 1 may lose the level; a refit that doubles the free-run error is discarded.
    Errors of arithmetic have no noise model.
    """
    if model.spec.paths is not None:
        return done.spec, done.values
    if model.spec.process != FIRST_ORDER or model.spec.increments:
        return model.spec, values
    starts, left = (values, model.vector(done.model.named(done.values))), model.evaluate(values).rmse
    if left <= model.loop.arithmetic_error:
        return model.spec, values
    tried = (whiten_model(model, start) for start in starts)
    found = [w for w in tried if w.model.spec.taps and w.evaluated.rmse <= 2 * left]
    best = min(found, key=lambda w: w.innovation_sd, default=None)
    return (model.spec, values) if best is None else (best.model.spec, best.values)


def with_levels(run: Run, fit: Fitted, rng: np.random.Generator) -> Fitted:
    """A fit under a noise model without a name, its intervals widened to those of a fit without that noise model.

    Innovations of a wrong model are far smaller than its error, so that intervals from them alone would be too narrow.
    """
    spec = fit.model.spec
    if not spec.taps or spec.increments or spec.paths is not None or noises_in(spec.effects) or not fit.intervals:
        return fit
    levels = fit_rung(run.model(replace(spec, taps=())), fit.values, rng, last=True)
    return include_intervals(fit, levels.intervals, levels.pieces)


def step_of(run: Run, fit: Fitted, added: str | None, findings: Sequence[Finding] = ()) -> Step:
    """A fit as a step of its own; the finding on conditional intervals is that of this fit."""
    step = run.step(replace(fit, runs=1, agree=1), added)
    return replace(step, findings=(*step.findings, *(f for f in findings if f.code != CONDITIONAL)))


def noise_finding(fit: Fitted, alike: str = "") -> Finding:
    """The finding on the noise model of a fit: its kind and its size, and another noise that looks `alike`."""
    spec, e = fit.model.spec, fit.best
    taps, sd = np.asarray(spec.taps), float(np.sqrt(fit.sse / max(e.rows, 1)))
    walks = spec.increments and spec.process == FIRST_ORDER
    how = ("white steps that add up under measurement noise" if walks else
           f"an autoregression of order {taps.size}" if taps.size else "white")
    if (pace := fit.model.pace) > 1.0:
        how += f" from one PV to the next ({pace * fit.model.step_s:.3g} s on average)"
    said = f"; it is {LOAD_OR_OUTPUT}: {alike} explains it alike" if alike else ""
    return Finding(NOISE_MODEL, "info",
                   f"the noise is not white but {how}: the one-step error with it is {sd:.4g}{said}",
                   {"innovation_sd": sd, "order": int(taps.size), "kind": "random walk" if walks else "autoregression"}
                   | ({"alike": alike} if alike else {}), (), "docs/details.md, section 6.2")
