"""Which physical effect is missing: refit the model with each one, rank them, accept what clearly helps, and repeat.

Every candidate is completed with the noise its residual asks for and compared by the innovations of the complete model
on the same samples: the one-step error decides, the free-run error must not get worse, the information criterion and
the blocks of the record must agree. A disturbance or valve effect must also beat the best pure noise model, because an
autoregression can imitate anything one step ahead. Source: METHODS.md section 6; CRITICISM.md sections 1 and 7.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .effects import catalogue, parse
from .errors import DataError, ModelError, UsageError
from .fit import Fitted, finish
from .loop import Loop
from .methods import get as get_method
from .methods.options import Options
from .methods.run import ADEQUATE, Run
from .model import Model, rebuild_model
from .oscillation import find_range
from .refit import Refit, block_gains, complete, starting_pool, with_effect
from .results import Candidate, Estimate, ParameterValue, Step, Study

# BIC by which an effect must win to be named, and within which two are equivalent (CRITICISM.md section 7, step 7).
NAMED, ALIKE = 10.0, 10.0
# Blocks in which the one-step error must fall, and the median drop that counts (step 6).
_BLOCKS_BETTER, _MEDIAN_GAIN = 4, 0.005
# The free-run error may not get worse by more than this share.
_NO_WORSE = 1.02
MOST_ADDITIONS = 4
# Refits after which an effect that follows y has settled.
_FOLLOWED = 3
_NOISE = {"autoregressive": False, "random-walk": True}

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class _Tried:
    """One candidate: its name in a study, the completed refit, and what it gained over the model so far."""

    name: str
    refit: Refit
    delta_bic: float
    gains: np.ndarray
    noise: bool


def diagnose(loop: Loop, study: Study, *, everything: bool = False, apply: bool = False, seed: int = 0,
             progress: Progress | None = None) -> Study:
    """The study with ranked candidates and the effect to add next; with `apply` added, and so on until none helps.

    An adequate model is left alone unless `everything` asks for the catalogue. Raises DataError for an abstained
    study, and ModelError when it can't be rebuilt.
    """
    if not study.steps:
        raise DataError("the study abstained, so there is no model to diagnose", study.verdict.reason)
    tell = progress or (lambda text, share: None)
    added: list[str] = []
    while True:
        if study.adequate and not everything:
            return replace(study, candidates=() if not added else study.candidates, missing=tuple(added))
        tried, reference = _try_all(loop, study, seed, tell)
        winner = _accepted(tried, reference)
        study = replace(study, candidates=_ranked(tried, reference, winner, study),
                        missing=(winner.name,) if winner else ())
        if not apply or winner is None or len(added) >= MOST_ADDITIONS:
            return replace(study, missing=tuple(added)) if apply else study
        study = add(loop, study, winner.name, seed=seed, progress=progress)
        added.append(winner.name)


def add(loop: Loop, study: Study, effect: str, *, seed: int = 0, progress: Progress | None = None) -> Study:
    """The study with one more step: the model refitted with `effect` ("step-disturbance@load" names a variant).

    Raises UsageError for an unknown effect, one that is in the model already, or one that needs what is not there.
    """
    if not study.steps:
        raise DataError("the study abstained, so there is no model to add to", study.verdict.reason)
    names = variants(effect, loop)
    present = study.steps[-1].model.get("effects", [])
    if any(name.partition("@")[0] == have.partition("@")[0] for name in names for have in present):
        raise UsageError(f"the model has {effect} already", "choose another effect; stictionid effects lists them")
    run, fit, rng = _rebuilt(loop, study, seed)
    pool = starting_pool(fit.model, fit.values, rng)
    best = min((_refitted(fit, name, pool, rng) for name in names), key=lambda r: r[1].innovation_sd)
    name, refit = best
    model = refit.model
    if parse(name)[0].noise:
        model = Model(loop.longest_segment(), replace(model.spec, effects=(*fit.model.spec.effects, name)),
                      s_max=model.s_max, period_s=model.period_s)
    point = model.cube(refit.values[:, None])
    after = finish(model, point, model.costs(point), rng)
    for _ in range(_FOLLOWED if any(e.follows_y for e in model.effects) else 0):
        # The effect follows the model's own y, and the model has just changed.
        model = Model(model.loop, model.spec, s_max=model.s_max, period_s=model.period_s,
                      residual=np.nan_to_num(after.best.residual))
        point = model.cube(after.values[:, None])
        after = finish(model, point, model.costs(point), rng)
    after = replace(after, runs=1, agree=1)
    step = run.step(after, name)
    adequate, why = run.adequate(step)
    if parse(name)[0].noise:
        adequate, why = True, f"the one-step error {step.error.rmse_one_step:.4g} is that of white innovations"
    return replace(study, steps=(*study.steps, step), estimate=_estimate(study, step, after), adequate=adequate,
                   adequate_reason=why, missing=())


def variants(effect: str, loop: Loop) -> tuple[str, ...]:
    """The names under which an effect is tried: one for each variant, or for each further tag of the record."""
    found, option = parse(effect)
    if option:
        return (effect,)
    if "extra" in found.needs:
        if not loop.extras:
            raise UsageError(f"{found.name} needs a further tag of the export", "read it with --extra TAG")
        return tuple(f"{found.name}:{tag}" for tag in loop.extras)
    return tuple(f"{found.name}@{v}" for v in found.variants) or (found.name,)


def _rebuilt(loop: Loop, study: Study, seed: int) -> tuple[Run, Fitted, np.random.Generator]:
    piece = loop.longest_segment()
    model, values = rebuild_model(piece, study.steps[-1].model)
    rng = np.random.default_rng(seed)
    options = Options(law=model.spec.law, seed=seed)
    run = Run(piece, find_range(loop), options, get_method("auto"), rng=rng, tell=lambda text, share: None)
    best = model.evaluate(values)
    fit = Fitted(model, values, best.sse, 1, 1, best, None, {}, values[None, :2])
    return run, fit, rng


def _refitted(fit: Fitted, name: str, pool: np.ndarray, rng: np.random.Generator) -> tuple[str, Refit]:
    noise = parse(name)[0].noise
    if noise is not None:
        return name, complete(fit.model, fit.values, pool, rng, random_walk=_NOISE.get(noise, False))
    model, values, _ = with_effect(fit, name, pool, rng)
    return name, complete(model, values, None, rng)


def _try_all(loop: Loop, study: Study, seed: int, tell: Progress) -> tuple[list[_Tried], Refit]:
    _, fit, rng = _rebuilt(loop, study, seed)
    pool = starting_pool(fit.model, fit.values, rng)
    present = {name.partition("@")[0].partition(":")[0] for name in fit.model.spec.effects}
    names = [name for effect in catalogue().values() if effect.name not in present
             and not ("extra" in effect.needs and not loop.extras) and effect.noise not in ("resonant",)
             for name in variants(effect.name, loop)]
    reference = complete(fit.model, fit.values, None, rng, order=0)
    refits: list[tuple[str, Refit]] = []
    for i, name in enumerate(names):
        tell(f"refitting with {name}", (i + 0.5) / len(names))
        try:
            refits.append(_refitted(fit, name, pool, rng))
        except ModelError:
            continue  # an effect that can't be combined with the model's own, such as a second drift
    good = np.logical_and.reduce([reference.good, *(r.good for _, r in refits)])
    base = reference.bic(good)
    tried = [_Tried(name, r, base - r.bic(good), block_gains(reference, r, good), parse(name)[0].noise is not None)
             for name, r in refits]
    return sorted(tried, key=lambda t: -t.delta_bic), reference


def _clearly_better(t: _Tried, reference: Refit) -> bool:
    steady = (t.gains > 0).sum() >= _BLOCKS_BETTER and float(np.median(t.gains)) >= _MEDIAN_GAIN
    return t.delta_bic >= NAMED and bool(steady)


def _accepted(tried: list[_Tried], reference: Refit) -> _Tried | None:
    """The candidate to name: physics before noise, but only physics that beats the noise models."""
    noise = [t for t in tried if t.noise and _clearly_better(t, reference)]
    floor = max((t.delta_bic for t in noise), default=0.0)
    for t in tried:
        worse = t.refit.evaluated.rmse > _NO_WORSE * reference.evaluated.rmse
        if not t.noise and not worse and _clearly_better(t, reference) and t.delta_bic >= floor + NAMED:
            return t
    return noise[0] if noise else None


def _ranked(tried: list[_Tried], reference: Refit, winner: _Tried | None, study: Study) -> tuple[Candidate, ...]:
    base_rmse, base_step = study.steps[-1].error.rmse, reference.innovation_sd
    out = []
    for t in sorted(tried, key=lambda t: (t is not winner, -t.delta_bic)):
        rmse, step = t.refit.evaluated.rmse, t.refit.innovation_sd
        alike = tuple(o.name for o in tried if o is not t and abs(o.delta_bic - t.delta_bic) < ALIKE
                      and o.delta_bic >= NAMED)[:2] if winner is t else ()
        out.append(Candidate(
            t.name, t is winner, rmse, None, None, 100.0 * (1.0 - rmse / base_rmse), 100.0 * (1.0 - step / base_step),
            t.delta_bic, alike, None, _values(t), _statement(t, winner, base_step)))
    return tuple(out)


def _values(t: _Tried) -> tuple[ParameterValue, ...]:
    effect, _ = parse(t.name)
    named = t.refit.model.named(t.refit.values)
    mine = {k.rpartition(":")[2]: v for k, v in named.items() if k.startswith(t.name + ":")}
    if effect.report and mine:
        sizes = t.refit.model.sizes_of(t.name, t.refit.values, t.refit.evaluated.own)
        mine = effect.report(mine, sizes, {**named, "length_s": t.refit.model.context.length_s})
    units = {p.name: (p.unit, p.meaning) for p in effect.parameters}
    return tuple(ParameterValue(t.name, k, v, units.get(k, ("", ""))[0], meaning=units.get(k, ("", ""))[1])
                 for k, v in mine.items())


def _statement(t: _Tried, winner: _Tried | None, before: float) -> str:
    change = f"one-step error {before:.4g} to {t.refit.innovation_sd:.4g}, BIC {t.delta_bic:+.0f}"
    if t is winner:
        return f"{t.name} explains it: {change}"
    if t.delta_bic < NAMED:
        return f"{t.name} does not help: {change}"
    return f"{t.name} helps less than the effect named: {change}" if winner else f"{t.name} is not sure: {change}"


def _estimate(study: Study, step: Step, fit: Fitted) -> Estimate | None:
    if study.estimate is None:
        return None
    v = fit.best.values
    lags = [v["time_constant_s"], *(x for k, x in v.items() if k.endswith("second_time_constant_s"))]
    return replace(study.estimate, S=v["S"], J=v["J"], S_interval=fit.intervals.get("S"),
                   J_interval=fit.intervals.get("J"), gain=fit.best.gain, time_constants_s=tuple(lags),
                   dead_time_s=v["dead_time_s"], initial_residual_force=v["initial_residual_force"])


__all__ = ["ADEQUATE", "add", "diagnose", "variants"]
