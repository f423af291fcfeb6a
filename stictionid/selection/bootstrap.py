"""A p-value for the named effect: how often would the same search gain as much on records without it?

Replicates keep the command and the model's output and draw new innovations; the base is polished again on each, and
the effect gets the same first look. A neutral value on the edge of its range makes χ² wrong, so p comes from here or
is not given. Source: CRITICISM.md section 3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..effects import parse
from ..fit.fit import Fitted, as_it_stands
from ..fit.moves import search_model, spreads, with_start
from ..fit.noise.completion import Refit, quick
from ..model.segments import bound
from ..numerics.population import refine
from .tries import Round, Tried
from .work import Answer, Ground, Workers, look, noise


@dataclass(frozen=True, slots=True)
class _Draw:
    """One replicate's task: which effect, under which null model, and its number."""

    name: str
    null: Refit
    number: int


def p_of(found: Round, winner: Tried, replicates: int, seed: int, jobs: int,
         tell: Callable[[str, float], None]) -> float:
    """Share of replicates, the record itself included, in which the effect gains at least as much in BIC."""
    noises = [t.refit for t in found.tried if t.noise and t.refit is not None and t.delta_bic > 0.0]
    null = found.reference if winner.noise or not noises else min(noises, key=lambda r: r.innovation_sd)
    ground = Ground(found.fit, found.fit.values[None, :5], seed)
    goal = _gain(ground, winner.name, found.fit)
    reached = 0
    with Workers(ground, jobs) as workers:
        tasks = [_Draw(winner.name, null, i) for i in range(replicates)]
        for i, answer in enumerate(workers.map(_replicate, tasks)):
            reached += answer.cost >= goal
            tell(f"bootstrap {i + 1} of {replicates}", (i + 1) / replicates)
    return (1 + reached) / (replicates + 1)


def _gain(ground: Ground, name: str, fit: Fitted) -> float:
    """What the effect gains in BIC over the white base by the same first look that replicates get."""
    answer = noise(ground, name) if parse(name)[0].noise is not None else look(ground, name)
    if answer.failed:
        return -np.inf
    after = answer.refit(ground)
    return after.gain_over(quick(fit.model, fit.values, order=0))


def _replicate(ground: Ground, draw: _Draw) -> Answer:
    """One replicate; its gain travels as the answer's cost."""
    rng = np.random.default_rng([ground.seed, 9, draw.number])
    null, fit = draw.null, ground.fit
    pool = null.innovation[null.good]
    rows = np.flatnonzero(fit.model.good())
    sparse = fit.model.pace > 1.0
    white = rng.choice(pool - pool.mean(), rows.size if sparse else null.innovation.size)
    polynomial = np.concatenate([[1.0], null.white_model().taps])
    residual = np.empty_like(white)
    for k in range(white.size):
        back = residual[max(k - polynomial.size + 1, 0):k][::-1]
        residual[k] = white[k] - polynomial[1:1 + back.size] @ back
    if sparse:
        # The noise model goes from one sample that counts to the next.
        there = np.zeros(null.innovation.size)
        there[rows] = residual
        residual = there
    loop = replace(fit.model.loop, process_value=null.evaluated.model + residual)
    model = bound(loop, fit.model.spec, s_max=fit.model.s_max, period_s=fit.model.period_s)
    coarse = search_model(model)
    polish = refine(coarse.costs, with_start(coarse, coarse.cube(fit.values[:, None])), rng,
                    spread=spreads(coarse, 0.5), rounds=40, population=14, settle=1e-4)
    values = coarse.values(polish.points[:1])[:, 0]
    again = as_it_stands(model, values)
    gain = _gain(Ground(again, values[None, :5], ground.seed + draw.number + 1), draw.name, again)
    return Answer(draw.name, cost=gain)
