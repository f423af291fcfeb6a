"""The ladder of a study: the winner's effects added one by one in the order of their gain, each step a nested fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects import noises_in
from ..fit.add_effect import polish_last
from ..fit.adequacy import CONDITIONAL
from ..fit.context import Run
from ..fit.fit import finish_fit, include_intervals
from ..fit.intervals.along_path import finish_along
from ..fit.noise.completion import Refit, complete_quickly, place_slips
from ..fit.noise.prewhitening import whiten_model
from ..fit.points.fitted import Fitted
from ..fit.points.moves import descend_model
from ..model.model import Model
from ..model.segments import bind_model
from ..model.spec import FIRST_ORDER, INTEGRATOR, Spec
from ..record.loop import Finding
from ..record.study import Step
from ..typing import FloatArray
from .entry import Entry
from .node import drop_from, key, node, physical_effects, with_effect
from .score import Scored, complete_as_is
from .search import Search

Rung = tuple[Spec, FloatArray]


def order_ladder(search: Search, winner: Entry, base: Sequence[str] = (),
                 given: Sequence[str] = ()) -> tuple[tuple[str, ...], list[Rung]]:
    """The winner's effects in the order of their gain, and specification and values (d,) of every rung, the base first.

    Effects of the `base` are in every rung. Those with a `given` order keep it, and come before the others. A rung is
    the node that the search fitted, or the winner without the later effects, polished. A first-order process is fitted
    to levels of y in every rung; only the step that names a random walk is fitted to differences. An integrator is
    fitted to differences, because errors of wrong slips add up, and so is a lag of many periods. The last rung of an
    integrator is fitted to levels where the winner, fitted so, leaves hardly more than noise.
    """
    left = [name for name in physical_effects(winner.spec) if name not in base]
    order: list[str] = []
    first = [name for name in given if name in left]
    spec = node(drop_from(winner.spec, left),
                soft=winner.scored.done.increments and winner.scored.acts_as_integrator(search.policy))
    rungs = [_rung(search, winner, spec)[:2]]
    while left:
        asked = first[len(order):len(order) + 1] or left
        tried = {name: _rung(search, winner, node(with_effect(spec, name), soft=spec.increments)) for name in asked}
        name = min(tried, key=lambda n: tried[n][2])
        left.remove(name)
        order.append(name)
        spec = tried[name][0]
        rungs.append(tried[name][:2])
    scored = winner.scored
    at_noise = scored.free_run_at_noise or scored.only_noise(search.policy)
    if spec.process == INTEGRATOR and at_noise and not scored.done.increments:
        rungs[-1] = _rung(search, winner, replace(spec, increments=False, taps=()))[:2]
    return tuple(order), rungs


def _rung(search: Search, winner: Entry, spec: Spec) -> tuple[Spec, FloatArray, float]:
    """Specification, values (d,) and BIC of one rung in the winner's form."""
    best = winner.scored.done
    model = bind_model(best.model.loop, spec, s_max=best.model.s_max, period_s=best.model.period_s,
                       residual=best.evaluated.left)
    starts = [model.vector(best.model.named(best.values))]
    known = search.memo.get(key(spec))
    if known is not None and not known.failed:
        starts.append(model.vector(known.scored.done.model.named(known.scored.done.values)))
    if known is not None and not known.failed and known.scored.done.model.spec.paths is not None:
        # (slips that PV placed belong to these values)
        done = known.scored.done
        return replace(spec, paths=done.model.spec.paths), done.values, done.bic(done.good)
    found = descend_model(model, model.cube(np.stack(starts, axis=1)))
    values = model.values(found.points[:1])[:, 0]
    if best.model.spec.paths is not None:
        done = place_slips(complete_quickly(model, values), *starts)
        return replace(spec, paths=done.model.spec.paths), done.values, done.bic(done.good)
    done = complete_as_is(model, values)
    return spec, values, done.bic(done.good)


def fit_rung(model: Model, values: FloatArray, rng: np.random.Generator, *, last: bool, spans: bool = True) -> Fitted:
    """A rung with its last polish and errors; the `last` one also gets intervals, unless `spans` is False."""
    if model.spec.paths is not None:
        return finish_along(model, values, last=last and spans)
    if last:
        return polish_last(model, values, rng, spans=spans)
    point = model.cube(values[:, None])
    return finish_fit(model, point, model.costs(point), rng, reach=False)


def step_of(run: Run, fit: Fitted, added: str | None, findings: Sequence[Finding] = ()) -> Step:
    """A fit as a step of its own; the finding on conditional intervals is that of this fit."""
    step = run.step(replace(fit, runs=1, agree=1), added)
    return replace(step, findings=(*step.findings, *(f for f in findings if f.code != CONDITIONAL)))


def in_colour(model: Model, values: FloatArray, scored: Scored) -> Rung:
    """A first-order process refitted under the autoregression of its residual; unchanged for a white residual.

    Least squares assume a white residual. A coloured one distorts process and slips, whether its noise is named or not.
    The refit starts from the given values and from those of the completed node. An integrator is fitted to differences
    already. A noise model with a root near 1 may lose the level; a refit that doubles the free-run error is discarded.
    """
    if model.spec.paths is not None:
        return scored.done.spec, scored.done.values
    if model.spec.process != FIRST_ORDER or model.spec.increments:
        return model.spec, values
    starts = values, model.vector(scored.done.model.named(scored.done.values))
    most = 2 * model.evaluate(values).rmse
    found = [w for w in (whiten_model(model, start) for start in starts) if w.order and w.evaluated.rmse <= most]
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


def with_noise(done: Refit, name: str, spec: Spec) -> Model:
    """The model of a node with its noise model as an effect of its own."""
    full = replace(done.spec, effects=(*physical_effects(spec), name))
    return bind_model(done.model.loop, full, s_max=done.model.s_max, period_s=done.model.period_s,
                      residual=done.evaluated.left)


def noise_finding(fit: Fitted) -> Finding:
    """The finding on the noise model of a fit: its kind and its size."""
    spec, e = fit.model.spec, fit.best
    taps, sd = np.asarray(spec.taps), float(np.sqrt(fit.sse / max(e.rows, 1)))
    walks = spec.increments and spec.process == FIRST_ORDER
    how = ("white steps that add up under measurement noise" if walks else
           f"an autoregression of order {taps.size}" if taps.size else "white")
    if (pace := fit.model.pace) > 1.0:
        how += f", from one PV to the next, which is {pace * fit.model.step_s:.3g} s on average,"
    return Finding("noise-model", "info", f"the noise is not white but {how}: the one-step error with it is {sd:.4g}",
                   {"innovation_sd": sd, "order": int(taps.size),
                    "kind": "random walk" if walks else "autoregression"}, (), "docs/method.md, section 6.2")
