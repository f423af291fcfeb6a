"""Looks and fits beside a node whose slips PV placed: along its path the cost is smooth, and a descent will do.

A search that places slips by the law alone would have to find the node's whole path again before an effect could show.
So effects are tried along the parent's path, and the path is settled anew with each of the best.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects import parse
from ..fit.fit import Fitted
from ..fit.moves import descended
from ..fit.noise.completion import Refit, likelier, quick
from ..fit.own_scan import scanned_starts
from ..fit.with_effect import widened_by
from ..model.segments import bound
from ..model.spec import Spec
from ..typing import FloatArray

# Turns and fall of the cost of a descent along the parent's path, and the rounds that settle a look's own.
_TURNS, _STILL, _ROUNDS = 4, 1e-3, 2


def looked_along(fit: Fitted, name: str) -> Refit:
    """One effect added to a fit along its path: from its neutral value and its guesses, the path settled anew."""
    model, _ = widened_by(fit, name)
    effect, option = parse(name)
    here = model.vector(fit.best.values)
    starts = [here]
    for guess in effect.guess(model.context_of(option)) if effect.guess else ():
        starts.append(here.copy())
        starts[-1][model.rows_of(name)] = guess
    cube = model.cube(np.array(starts).T)
    if effect.scan is not None:
        cube = np.concatenate([cube, scanned_starts(model, name, here, False)])
    near = descended(model, cube, turns=_TURNS, settle=_STILL)
    values = list(model.values(near.points[:1]).T)
    if effect.friction is not None:
        # (an effect on break-away forces alone does not show along a path that is given)
        values.append(here)
    found = [likelier(quick(model, v), rounds=_ROUNDS) for v in values]
    return min(found, key=lambda done: done.bic(done.good))


def fitted_along(fit: Fitted, spec: Spec, values: FloatArray) -> Refit:
    """A node of another structure along the path of a fit, settled from values (d,)."""
    before = fit.model
    model = bound(before.loop, replace(spec, paths=before.spec.paths), s_max=before.s_max, period_s=before.period_s,
                  residual=fit.best.left)
    return likelier(quick(model, values))
