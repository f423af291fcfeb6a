"""One round: a look at every effect, full refits of those that may win, and the base put right where that is better.

A wrong basin of the base looks exactly like a missing effect, so fresh restarts of the base come first and every
refit's S, J, start and process are handed back to it. Source: CRITICISM.md sections 1.3 and 7, steps 3 to 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import catalogue, parse
from ..fit import Fitted, polish_smooth, search_model, spreads, with_start
from ..heldout import Held, held_out
from ..loop import FloatArray, Loop
from ..refit import Refit, at_thresholds, block_gains, complete, starting_pool
from ..restarts import bound
from ..search import refine
from ..spec import BASE
from .steps import variants
from .work import Answer, Ground, Workers, base_values, finish, look, noise

Progress = Callable[[str, float], None]
# Full refits: at most so many, of looks whose BIC is within so much (or this share of the best gain) of the best look.
_FINALISTS, _WITHIN, _WITHIN_SHARE = 6, 150.0, 0.12
# Where no look gains this much in BIC a few full refits will do.
_NOTHING, _FEW = 0.0, 3
# A better optimum of the base: twice the log-likelihood it must gain (CRITICISM.md section 7, step 5), how often the
# round starts again, and how many refits are handed back.
_BETTER_LR, _AGAIN, _HANDED = 2.0, 2, 6
# Likelihood-ratio gain from which a moving command is taken for a held one after all.
_HELD_LR = 10.0


@dataclass(frozen=True, slots=True)
class Tried:
    """One candidate: its name in a study, its refit (None: it failed, and why), and what it gained over the model.

    `full` says that it was refitted to the end; `held` are its held-out errors, block by block.
    """

    name: str
    refit: Refit | None
    delta_bic: float
    gains: FloatArray
    noise: bool
    full: bool = True
    held: Held | None = None
    failed: str = ""


@dataclass(frozen=True, slots=True)
class Round:
    """All candidates, best first, and the model without any; `fit` is the base, put right where `better` says so."""

    fit: Fitted
    reference: Refit
    held: Held | None
    tried: tuple[Tried, ...]
    better: bool


def try_all(loop: Loop, fit: Fitted, seed: int, jobs: int, tell: Progress) -> Round:
    """Every effect of the catalogue that the model does not have, on one loop's stretch."""
    rng = np.random.default_rng(seed)
    names = candidate_names(loop, fit.model.spec.effects)
    tell("restarting the model so far", 0.02)
    pool = starting_pool(fit.model, fit.values, rng)
    first = fit.sse
    fit = better_base(fit, [*pool[1:]], rng)
    held = held_command(fit, rng)
    if held is not None:
        fit, pool = held, starting_pool(held.model, held.values, rng)
    answers: list[Answer] = []
    for _ in range(1 + _AGAIN):
        ground = Ground(fit, np.concatenate([fit.values[None, :len(BASE)], pool[1:]]), seed)
        answers = _round(ground, names, jobs, tell)
        told = sorted((a for a in answers if not a.failed), key=lambda a: a.cost)[:_HANDED]
        now = better_base(fit, [base_values(a) for a in told], rng)
        if now is fit:
            break
        fit = now
    reference = complete(fit.model, fit.values, None, rng, order=0)
    return _judged(fit, reference, held_out(reference, rng), ground, answers, fit.sse < first)


def held_command(fit: Fitted, rng: np.random.Generator) -> Fitted | None:
    """The same model under a command that is held between samples, where that fits clearly better than a moving one.

    A scanned command taken for a continuous one leaves errors after every slip, which look like a missing effect.
    """
    spec = fit.model.spec
    if spec.between != "corner":
        return None
    model = bound(fit.model.loop, replace(spec, between="hold", substeps=1), s_max=fit.model.s_max,
                  period_s=fit.model.period_s, residual=fit.model.context.residual)
    best = model.evaluate(fit.values)
    start = Fitted(model, fit.values, best.sse, fit.runs, fit.agree, best, None, {}, fit.values[None, :2])
    pool = starting_pool(model, fit.values, rng)
    found = better_base(start, [*pool], rng)
    gain = float(fit.best.rows) * float(np.log(max(fit.sse, 1e-300) / max(found.sse, 1e-300)))
    return found if gain > _HELD_LR else None


def candidate_names(loop: Loop, present: Sequence[str]) -> list[str]:
    """Names under which effects are tried: variants and tags one by one, without what the model has already."""
    have = {name.partition("@")[0].partition(":")[0] for name in present}
    return [name for effect in catalogue().values()
            if effect.name not in have and not ("extra" in effect.needs and not loop.extras)
            for name in variants(effect.name, loop)]


def _round(ground: Ground, names: Sequence[str], jobs: int, tell: Progress) -> list[Answer]:
    """First looks, then the noise models and the full refits; finished answers replace looks."""
    physical = [n for n in names if parse(n)[0].noise is None]
    noises = [n for n in names if parse(n)[0].noise is not None]
    answers: dict[str, Answer] = {}
    total = len(physical) + len(noises) + _FINALISTS
    with Workers(ground, jobs) as workers:
        for answer in workers.map(look, physical):
            answers[answer.name] = answer
            tell(f"looked at {answer.name}", 0.05 + 0.9 * len(answers) / total)
        for answer in workers.map(noise, noises):
            answers[answer.name] = answer
            tell(f"fitted {answer.name}", 0.05 + 0.9 * len(answers) / total)
        for i, answer in enumerate(workers.map(finish, _finalists(ground, answers, physical))):
            answers[answer.name] = answer
            tell(f"refitted with {answer.name}", 0.05 + 0.9 * (len(physical) + len(noises) + i + 1) / total)
    return list(answers.values())


def _finalists(ground: Ground, answers: dict[str, Answer], physical: Sequence[str]) -> list[Answer]:
    """The looks that deserve a full refit: best by innovations, and best by the free run."""
    good = [answers[n] for n in physical if not answers[n].failed]
    if not good:
        return []
    refits = {a.name: a.refit(ground) for a in good}
    base = complete(ground.fit.model, ground.fit.values, None, np.random.default_rng(0), order=0)
    common = np.logical_and.reduce([base.good, *(r.good for r in refits.values())])
    gains = {name: base.bic(common) - r.bic(common) for name, r in refits.items()}
    ranked = sorted(good, key=lambda a: -gains[a.name])
    best = gains[ranked[0].name]
    near = [a for a in ranked if gains[a.name] >= best - max(_WITHIN, _WITHIN_SHARE * best)]
    by_cost = min(good, key=lambda a: a.cost)
    chosen = near[:_FINALISTS if best > _NOTHING else _FEW]
    return chosen if by_cost in chosen else [*chosen[:_FINALISTS - 1], by_cost]


def better_base(fit: Fitted, starts: Sequence[FloatArray], rng: np.random.Generator) -> Fitted:
    """The base polished from other values (5,); the same object unless twice the log-likelihood gains enough."""
    model = fit.model
    coarse = search_model(model)
    vectors = [fit.values]
    for base in starts:
        vector = fit.values.copy()
        vector[:len(BASE)] = base
        vectors.append(vector)
    cube = coarse.cube(np.array(vectors).T)
    cube = cube[np.argsort(coarse.costs(cube), kind="stable")[:4]]
    found = refine(coarse.costs, with_start(coarse, cube), rng, spread=spreads(coarse, 0.5), rounds=40, population=14,
                   settle=1e-4)
    rows = max(float(fit.best.rows), 1.0)
    near = np.concatenate([with_start(model, found.points[:1]), model.cube(fit.values[:, None])])
    near = near[[int(np.argmin(model.costs(near)))]]
    last = refine(model.costs, near, rng, spread=spreads(model, 0.15), rounds=60, population=16, settle=1e-4)
    point, cost = polish_smooth(model, last.points[0])
    if model.spec.between == "hold":
        point, cost = at_thresholds(model, point, rng)
    if rows * np.log(max(fit.sse, 1e-300) / max(cost, 1e-300)) <= _BETTER_LR:
        return fit
    values = model.values(point[None])[:, 0]
    guided = bound(model.loop, model.spec, s_max=model.s_max, period_s=model.period_s,
                   residual=model.context.residual)
    best = guided.evaluate(values)
    return replace(fit, values=values, sse=cost, best=best, searched=values[None, :2])


def _judged(fit: Fitted, reference: Refit, held: Held | None, ground: Ground, answers: Sequence[Answer],
            better: bool) -> Round:
    refits = {a.name: a.refit(ground) for a in answers if not a.failed}
    good = np.logical_and.reduce([reference.good, *(r.good for r in refits.values())])
    base = reference.bic(good)
    tried = []
    for a in answers:
        kind = parse(a.name)[0].noise is not None
        if a.failed:
            tried.append(Tried(a.name, None, -np.inf, np.zeros(0), kind, False, None, a.failed))
            continue
        r = refits[a.name]
        tried.append(Tried(a.name, r, base - r.bic(good), block_gains(reference, r, good), kind,
                           a.held is not None or kind, a.held))
    return Round(fit, reference, held, tuple(sorted(tried, key=lambda t: -t.delta_bic)), better)
