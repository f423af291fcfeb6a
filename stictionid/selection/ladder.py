"""The ladder of a study: the winner's effects added one by one in the order of their gain, each step a nested fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..fit.add_effect import polished
from ..fit.context import CONDITIONAL, Run
from ..fit.fit import Fitted, finish
from ..fit.moves import descended
from ..model.model import Model
from ..model.segments import bound
from ..model.spec import Spec
from ..record.loop import Finding
from ..record.study import Step
from ..typing import FloatArray
from .node import key, node, physical, with_effect, without
from .score import Scored, glanced
from .search import Entry, Search

Rung = tuple[Spec, FloatArray]


def ordered(search: Search, winner: Entry) -> tuple[tuple[str, ...], list[Rung]]:
    """The winner's effects in the order of their gain, and specification and values (d,) of every rung, the base first.

    A rung is the node as the search met it, or the winner without the later effects, polished.
    """
    left, order = list(physical(winner.spec)), []
    spec = node(without(winner.spec, left), soft=winner.spec.increments)
    rungs = [_rung(search, winner, spec)[:2]]
    while left:
        tried = {name: _rung(search, winner, node(with_effect(spec, name), soft=winner.spec.increments))
                 for name in left}
        name = min(tried, key=lambda n: tried[n][2])
        left.remove(name)
        order.append(name)
        spec = tried[name][0]
        rungs.append(tried[name][:2])
    return tuple(order), rungs


def _rung(search: Search, winner: Entry, spec: Spec) -> tuple[Spec, FloatArray, float]:
    """Specification, values (d,) and BIC of one rung in the winner's form."""
    best = winner.scored.done
    model = bound(best.model.loop, spec, s_max=best.model.s_max, period_s=best.model.period_s,
                  residual=best.evaluated.left)
    starts = [model.vector(best.model.named(best.values))]
    known = search.memo.get(key(spec))
    if known is not None and not known.failed:
        starts.append(model.vector(known.scored.done.model.named(known.scored.done.values)))
    found = descended(model, model.cube(np.stack(starts, axis=1)))
    values = model.values(found.points[:1])[:, 0]
    done = glanced(model, values)
    return spec, values, done.bic(done.good)


def fitted(model: Model, values: FloatArray, rng: np.random.Generator, *, last: bool) -> Fitted:
    """A rung with its last polish and errors; the `last` one with intervals, too."""
    if last:
        return polished(model, values, rng)
    point = model.cube(values[:, None])
    return finish(model, point, model.costs(point), rng, reach=False)


def step_of(run: Run, fit: Fitted, added: str | None, findings: Sequence[Finding] = ()) -> Step:
    """A fit as a step of its own; the finding on conditional intervals is that of this fit."""
    step = run.step(replace(fit, runs=1, agree=1), added)
    return replace(step, findings=(*step.findings, *(f for f in findings if f.code != CONDITIONAL)))


def with_noise(scored: Scored, name: str, spec: Spec) -> Model:
    """The model of a node with the noise that completes it as an effect of its own."""
    done = scored.done
    full = replace(done.spec, effects=(*physical(spec), name))
    return bound(done.model.loop, full, s_max=done.model.s_max, period_s=done.model.period_s,
                 residual=done.evaluated.left)
