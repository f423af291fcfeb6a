"""The ladder of a study: the winner's effects added one by one in the order of their gain, each step a nested fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..fit.noise.completion import complete_quickly, place_slips
from ..fit.points.moves import descend_values
from ..fit.rung import Rung
from ..model.segments import rebind_model
from ..model.spec import INTEGRATOR, Spec
from ..typing import FloatArray
from .entry import Entry
from .node import drop_from, key, node, physical_effects, with_effect
from .score import complete_as_is
from .search import Search


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
    model = rebind_model(best.model, spec, best.evaluated.left)
    starts = [model.vector(best.model.named(best.values))]
    known = search.memo.get(key(spec))
    if known is not None and not known.failed:
        done = known.scored.done
        if done.model.spec.paths is not None:
            # (slips that PV placed belong to these values)
            return replace(spec, paths=done.model.spec.paths), done.values, done.bic(done.good)
        starts.append(model.vector(done.model.named(done.values)))
    values = descend_values(model, np.stack(starts, axis=1))
    if best.model.spec.paths is not None:
        done = place_slips(complete_quickly(model, values), *starts)
        return replace(spec, paths=done.model.spec.paths), done.values, done.bic(done.good)
    done = complete_as_is(model, values)
    return spec, values, done.bic(done.good)
