"""One round: a look at every effect, full refits of those that may win, and the base put right where that is better.

A wrong basin of the base looks exactly like a missing effect, so fresh restarts of the base come first and every
refit's S, J, start and process are handed back to it. Source: CRITICISM.md sections 1.3 and 7, steps 3 to 5.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import catalogue, noises_in, parse
from ..fit.cross_validation import Held, held_out
from ..fit.fit import Fitted, polish_smooth
from ..fit.moves import search_model, spreads, with_start
from ..fit.noise.completion import (
    AUTOREGRESSIVE,
    LARGEST_ORDER,
    Refit,
    at_noise,
    better,
    block_gains,
    complete,
    has_noise,
    has_walk,
    quick,
)
from ..fit.starts.beside_effect import on_valve, starting_pool
from ..fit.starts.intersample import surely_moves
from ..fit.with_effect import at_thresholds
from ..model.segments import bound
from ..model.spec import BASE
from ..numerics.population import refine
from ..record.loop import Loop
from ..typing import FloatArray, Progress
from .steps import variants
from .work import Answer, Ground, Workers, base_values, finish, look, look_beside, look_in_windows, noise, without_it

# Full refits: at most so many, so many at a time whatever the jobs, of looks whose BIC is within so much (or this share
# of the best gain) of the best full refit so far.
_FINALISTS, _BATCH, _WITHIN, _WITHIN_SHARE = 6, 2, 150.0, 0.12
# Times the squared error that another effect left at the noise, up to which a look gets a full refit. A full refit
# lowered the squared error of the look that won by a factor of 1.8 at most in 12 loops (measured).
_REACH = 6.0
# What a look must gain in BIC, or twice the log-likelihood of the free run, to be worth a full refit (CRITICISM.md
# section 7, step 7: the gain that names an effect).
NAMED = 10.0
# A better optimum of the base: twice the log-likelihood it must gain (CRITICISM.md section 7, step 5), how often the
# round starts again, and how many refits are handed back; the round stays where the base gained less than this share of
# what the best effect gains.
_BETTER_LR, _AGAIN, _HANDED, _MATTERS = 2.0, 2, 6, 0.1
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

    @property
    def noise_gain(self) -> float:
        """BIC that the best noise model gains; 0 where none could be refitted."""
        return max((t.delta_bic for t in self.tried if t.noise and t.refit is not None), default=0.0)


def try_all(loop: Loop, fit: Fitted, seed: int, jobs: int, tell: Progress, noise_sd: float = np.inf, *,
            moving: bool = False) -> Round:
    """Every effect of the catalogue that the model does not have, on one loop's stretch.

    Only effects that may bring the free run to a noise of `noise_sd` (unit of y) are refitted in full. A command that
    is `moving` stays so: beside a missing effect a held one may do better.
    """
    rng = np.random.default_rng(seed)
    names = candidate_names(loop, fit.model.spec.effects)
    tell("restarting the model so far", 0.02)
    pool = starting_pool(fit.model, fit.values, rng)
    first = fit.sse
    fit = better_base(fit, [*pool[1:]], rng)
    held = None if moving else held_command(fit, rng)
    if held is not None:
        fit, pool = held, starting_pool(held.model, held.values, rng)
    answers: list[Answer] = []
    # Values that the base has left, because alone it does better elsewhere, may be those that go with what is missing.
    left = pool[1:] if fit.sse == first else pool
    for _ in range(1 + _AGAIN):
        ground = Ground(fit, np.concatenate([fit.values[None, :len(BASE)], left]), seed)
        answers = _round(ground, names, jobs, tell, noise_sd)
        told = sorted((a for a in answers if not a.failed), key=lambda a: a.cost)[:_HANDED]
        plain = (a for a in answers if _came_out_white(a))
        now = better_base(fit, [without_it(a, ground) for a in (*plain, *told)], rng)
        if now is fit:
            break
        gained = _likelihood(fit, fit.sse, now.sse)
        fit = now
        # Where the best effect gains far more than the base did, the base's own optimum decides nothing.
        if told and gained < _MATTERS * _likelihood(fit, fit.sse, told[0].cost):
            break
    order = LARGEST_ORDER if has_noise(fit.model.spec) else 0
    reference = _plain_model(ground, answers, complete(fit.model, fit.values, None, rng, order=order))
    return _judged(fit, reference, held_out(reference), ground, answers, fit.sse < first)


def _plain_model(ground: Ground, answers: Sequence[Answer], reference: Refit) -> Refit:
    """The model without any effect, as good as it was met: a noise model that came out white is one, too.

    The model of an integrator is searched in changes of y and completed in levels, where a search for its noise may
    settle a valve that a descent leaves a slip away; against the worse one every candidate would gain the same.
    """
    for a in filter(_came_out_white, answers):
        reference = better(reference, a.refit(ground))
    return reference


def _came_out_white(answer: Answer) -> bool:
    """Whether a noise model is none in the end: its search only found the model so far in another basin."""
    return not answer.failed and parse(answer.name)[0].noise is not None and answer.taps is not None \
        and not answer.taps.size and not answer.increments


def _likelihood(fit: Fitted, before: float, after: float) -> float:
    """Twice the log-likelihood gained between two sums of squared errors of one record."""
    return max(float(fit.best.rows), 1.0) * float(np.log(max(before, 1e-300) / max(after, 1e-300)))


def held_command(fit: Fitted, rng: np.random.Generator) -> Fitted | None:
    """The same model under a command that is held between samples, where that fits clearly better than a moving one.

    A scanned command taken for a continuous one leaves errors after every slip, which look like a missing effect.
    """
    spec = fit.model.spec
    if spec.between != "corner" or surely_moves(fit.model.loop):
        return None
    model = bound(fit.model.loop, replace(spec, between="hold", substeps=1), s_max=fit.model.s_max,
                  period_s=fit.model.period_s, residual=fit.model.context.residual)
    best = model.evaluate(fit.values)
    start = Fitted(model, fit.values, best.sse, fit.runs, fit.agree, best, None, {}, fit.values[None, :2])
    pool = starting_pool(model, fit.values, rng)
    found = better_base(start, [*pool], rng)
    return found if _likelihood(fit, fit.sse, found.sse) > _HELD_LR else None


def candidate_names(loop: Loop, present: Sequence[str]) -> list[str]:
    """Names under which effects are tried: variants and tags one by one, without what the model has already.

    Errors have one noise model: every refit estimates it anew, and a second would only take the first one's place.
    """
    have = {name.partition("@")[0].partition(":")[0] for name in present}
    noisy = bool(noises_in(present))
    return [name for effect in catalogue().values()
            if effect.name not in have and not (noisy and effect.noise is not None)
            and not ("extra" in effect.needs and not loop.moving_extras)
            for name in variants(effect.name, loop)]


def _round(ground: Ground, names: Sequence[str], jobs: int, tell: Progress, noise_sd: float) -> list[Answer]:
    """The noise models, first looks, then the full refits; finished answers replace looks.

    A noise model takes what a slow disturbance does to y, so that the valve shows: looks start from its valve, too.
    Where it leaves nothing but noise, the valve is found: looks go no further, and only those that do better than the
    noise are refitted in full, and the best of them. So it is where a look beyond the valve leaves nothing but white
    noise: basins of valves are what costs most of a round, and looks at effects on the valve need none but that one.
    """
    noises = noises_in(names)
    physical = [n for n in names if n not in noises]
    answers: dict[str, Answer] = {}
    total = len(physical) + len(noises) + _FINALISTS
    with Workers(ground, jobs) as workers:
        for answer in workers.map(noise, noises):
            answers[answer.name] = answer
            tell(f"fitted {answer.name}", 0.05 + 0.9 * len(answers) / total)
    told = [base_values(a) for a in answers.values() if not a.failed]
    alone = _noise_alone(ground, answers.values())
    ground = replace(ground, pool=np.concatenate([ground.pool, *(values[None] for values in told)]),
                     near=alone is not None)
    beyond = [n for n in physical if not on_valve(parse(n)[0])]
    with Workers(ground, jobs) as workers:
        for answer in workers.map(look, beyond):
            answers[answer.name] = answer
            tell(f"looked at {answer.name}", 0.05 + 0.9 * len(answers) / total)
    if whole := [base_values(answers[n])[None] for n in beyond if _explains_all(ground, answers[n])]:
        ground = replace(ground, pool=np.concatenate([ground.pool, *whole]), near=True)
    with Workers(ground, jobs) as workers:
        for answer in workers.map(look, [n for n in physical if n not in beyond]):
            answers[answer.name] = answer
            tell(f"looked at {answer.name}", 0.05 + 0.9 * len(answers) / total)
        looks = [answers[n] for n in physical]
        for i, answer in enumerate(_finished(workers, ground, looks, noise_sd, alone)):
            answers[answer.name] = answer
            tell(f"refitted with {answer.name}", 0.05 + 0.9 * (len(physical) + len(noises) + i + 1) / total)
        base = quick(ground.fit.model, ground.fit.values)
        there = [answers[n].refit(ground) for n in physical if not answers[n].failed]
        again: list[Answer] = []
        if has_walk(ground.fit.model.spec):
            if _unsettled(base, there):
                tell("looking for friction that changes along the record", 0.95)
                again = list(workers.map(look_in_windows, looks))
        elif alone is None and not has_noise(ground.fit.model.spec) and not any(map(at_noise, [base, *there])):
            # Nothing explains the record: two effects on a valve hide each other.
            tell("looking for two effects on the valve at once", 0.95)
            again = list(workers.map(look_beside, looks))
        further = [a for a in again if a.cost < answers[a.name].cost]
        for answer in _finished(workers, ground, further, noise_sd, alone):
            if not answer.failed and answer.refit(ground).gain_over(answers[answer.name].refit(ground)) > 0.0:
                answers[answer.name] = answer
    return [answers[n] for n in (*noises, *physical)]


def _explains_all(ground: Ground, look: Answer) -> bool:
    """Whether what a look leaves passes every test for chance without any noise model."""
    if look.failed:
        return False
    refit = look.refit(ground)
    return not refit.taps.size and at_noise(refit) and refit.noise_alone


def _unsettled(base: Refit, there: Sequence[Refit]) -> bool:
    """Whether the changes of y show that something is missing beside a walk, and no effect leaves nothing but noise.

    A valve that is wrong under a walk may leave what passes every test; then what effects gain has to tell.
    """
    helping = [r for r in there if r.gain_over(base) > NAMED]
    return bool(helping) if base.walk_alone else not any(r.walk_alone for r in helping)


def _noise_alone(ground: Ground, answers: Iterable[Answer]) -> Refit | None:
    """The model with an autoregression, where that leaves nothing but noise; None elsewhere."""
    for a in answers:
        if a.failed or a.taps is None or not a.taps.size or parse(a.name)[0].noise != AUTOREGRESSIVE:
            continue
        if (done := a.refit(ground)).noise_alone:
            return done
    return None


def _finished(workers: Workers, ground: Ground, looks: Sequence[Answer], noise_sd: float,
              alone: Refit | None) -> Iterator[Answer]:
    """Full refits of the looks that deserve one, a few at a time: the best by innovations and the best by the free run
    first, then those that the best full refit so far does not leave far behind.

    None of those whose squared error is out of reach of white noise of `noise_sd`, as the model filters it; nor, but
    for the best, of those that do no better than a noise which is `alone` in what the model leaves.
    """
    fit = ground.fit
    refits = {a.name: a.refit(ground) for a in looks if not a.failed}
    good = [a for a in looks if a.name in refits]
    if not good:
        return
    base, silent = quick(fit.model, fit.values), quick(fit.model, fit.values, order=0)
    gains = {name: refit.gain_over(silent) for name, refit in refits.items()}
    queue = sorted(good, key=lambda a: -gains[a.name])
    first, top = min(good, key=lambda a: a.cost), queue[0]
    # A look that gains nothing, neither in the free run nor beside the noise model of the base, shows nothing to refit.
    queue = [a for a in queue if a is top or a.gain > NAMED or refits[a.name].gain_over(base) > 0.0]
    if alone is not None:
        queue = good = [a for a in queue if a is top or refits[a.name].gain_over(alone) > 0.0]
    if first in queue[2:]:
        queue.remove(first)
        queue.insert(1, first)
    best, ahead = -np.inf, ""
    finished: set[str] = set()
    # Once an effect is at the noise, one whose free run is far from it only has a noise model to thank.
    most = _REACH * noise_sd**2 * fit.best.rows * float(1.0 + fit.model.taps @ fit.model.taps)
    if at_noise(refits[top.name]):
        most = min(most, _REACH * top.cost)
    queue = [a for a in queue if a.cost <= most]
    while queue and len(finished) < _FINALISTS:
        batch, queue = queue[:_BATCH], queue[_BATCH:]
        for answer in workers.map(finish, batch):
            finished.add(answer.name)
            done = None if answer.failed else answer.refit(ground)
            if done is not None and (gain := done.gain_over(silent)) > best:
                best, ahead = gain, answer.name
                most = min(most, _REACH * answer.cost) if at_noise(done) else most
            yield answer
        queue = [a for a in queue if gains[a.name] >= best - max(_WITHIN, _WITHIN_SHARE * best) and a.cost <= most]
    # What is known to look like the best one is said beside it, so it must have had the same chance.
    like = parse(ahead)[0].confused_with if ahead else ()
    rivals = [a for a in good if a.name not in finished and parse(a.name)[0].name in like and a.cost <= most]
    yield from workers.map(finish, sorted(rivals, key=lambda a: -gains[a.name])[:_BATCH])


def better_base(fit: Fitted, starts: Sequence[FloatArray], rng: np.random.Generator) -> Fitted:
    """The model polished from other values, (d,) or (5,) of the base alone; the same object unless twice the
    log-likelihood gains enough."""
    model = fit.model
    coarse = search_model(model)
    vectors = [fit.values]
    for base in starts:
        vector = fit.values.copy()
        vector[:base.size] = base
        vectors.append(vector)
    cube = coarse.cube(np.array(vectors).T)
    cube = cube[np.argsort(coarse.costs(cube), kind="stable")[:4]]
    found = refine(coarse.costs, with_start(coarse, cube), rng, spread=spreads(coarse, 0.5), rounds=40, population=14,
                   settle=1e-4)
    near = np.concatenate([with_start(model, found.points[:1]), model.cube(fit.values[:, None])])
    near = near[[int(np.argmin(model.costs(near)))]]
    last = refine(model.costs, near, rng, spread=spreads(model, 0.15), rounds=60, population=16, settle=1e-4)
    point, cost = polish_smooth(model, last.points[0])
    if model.spec.held:
        point, cost = at_thresholds(model, point, rng)
    if _likelihood(fit, fit.sse, cost) <= _BETTER_LR:
        return fit
    values = model.values(point[None])[:, 0]
    guided = bound(model.loop, model.spec, s_max=model.s_max, period_s=model.period_s,
                   residual=model.context.residual)
    best = guided.evaluate(values)
    # An effect that follows y is searched on the y of the fit before; what counts is the one that follows its own.
    if _likelihood(fit, fit.best.sse, best.sse) <= _BETTER_LR:
        return fit
    return replace(fit, values=values, sse=best.sse, best=best, searched=values[None, :2])


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
