"""The verb `add`: one more effect in a study, and the verdict of the new model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects import parse
from ..errors import ModelError, UsageError
from ..fit.add_effect import REFITS, carrier, polished, refitted
from ..fit.context import Run
from ..fit.fit import Fitted
from ..fit.moves import descended, search_model, spreads, with_start
from ..fit.noise.completion import complete, has_noise, quick
from ..fit.noise.unexplained import judged_by, said_missing, unexplained
from ..fit.starts.beside_effect import starting_pool
from ..fit.starts.intersample import moved_after_all
from ..fit.with_effect import together_on_valve
from ..model.model import Model
from ..model.segments import bound
from ..numerics.population import refine
from ..process.scan import DECIMATED
from ..record.loop import Finding, Loop
from ..record.preconditions import swing_of
from ..record.study import Study
from ..selection.ladder import step_of
from ..selection.node import plain, variants
from ..selection.policy import Policy
from ..selection.run import unseen_scans
from ..selection.steps import opened, with_steps
from ..typing import FloatArray, Progress
from ..verdict.from_position import from_position
from ..verdict.judge import judge
from ..verdict.severity import with_controller
from ..verdict.swing import meaning_of
from .support import support_of

# An earlier effect is superfluous when the model without it loses less than this in BIC (CRITICISM.md section 7).
SUPERFLUOUS = 2.0
# Twice the log-likelihood that a disturbance must gain by entering elsewhere (CRITICISM.md section 7, step 7: "named").
_ELSEWHERE = 10.0


def add(loop: Loop, study: Study, effect: str, *, seed: int = 0, prune: bool = False,
        progress: Progress | None = None) -> Study:
    """The study with one more step, the model refitted with `effect`, and the verdict of that model.

    `effect` may name a variant ("step-disturbance@load"). The new step says whether the record supports the effect.
    Earlier effects that the new one makes superfluous are named in a finding, and left out with `prune`. Raises
    UsageError for an unknown effect, one that the model has already, or one that needs a signal that is not there;
    DataError for an abstained study.
    """
    return asked_anew(loop, _extended(loop, study, effect, seed=seed, prune=prune, progress=progress), seed)


def judged_anew(loop: Loop, study: Study, seed: int) -> Study:
    """The study with the verdict and the severity of its last model: an effect in the model no longer hides the valve.

    Raises DataError for an abstained study.
    """
    run, fit = opened(loop, study, seed)
    main = study.estimate
    if main is not None and any(effect.friction is not None for effect in fit.model.effects):
        position = from_position(run.loop.longest_segment(), law=run.law, s_max=swing_of(run.loop, run.found),
                                 rng=np.random.default_rng(seed), fit=fit)
        main = replace(main, from_position=position)
    verdict = judge(run, fit, loop, main.from_position if main else None)
    severity, swing = meaning_of(run.loop, main, fit, verdict) if main else (None, None)
    severity = severity and with_controller(severity, study.controller)
    return replace(study, estimate=main, verdict=verdict, severity=severity, swing=swing)


def asked_anew(loop: Loop, study: Study, seed: int) -> Study:
    """The study with verdict and severity of its last model, and with the shape of what that model misses.

    Raises DataError for an abstained study.
    """
    study = judged_anew(loop, study, seed)
    run, fit = opened(loop, study, seed)
    if unseen_scans(run) and fit.model.spec.between != DECIMATED:
        return replace(study, unexplained=None)
    done = quick(fit.model, fit.values)
    shape = unexplained(done)
    adequate, why = judged_by(shape, study.adequate, study.adequate_reason)
    return replace(study, unexplained=shape, missing_reason=said_missing(shape, done) if shape else "",
                   adequate=adequate, adequate_reason=why)


def _extended(loop: Loop, study: Study, effect: str, *, seed: int = 0, prune: bool = False,
              progress: Progress | None = None) -> Study:
    """The study with one more step: the model refitted with `effect` ("step-disturbance@load" names a variant).

    Verdict and severity are still those of the study before.
    """
    tell = progress or (lambda text, share: None)
    run, fit = opened(loop, study, seed)
    names = variants(effect, loop)
    if any(plain(name) == plain(have) for name in names for have in fit.model.spec.effects):
        raise UsageError(f"the model has {effect} already", "choose another effect; stictionid effects lists them")
    tell(f"refitting with {effect}", 0.1)
    pool = starting_pool(fit.model, fit.values, run.rng)
    refits = [(name, refitted(fit, name, pool, run.rng, REFITS)) for name in names]
    name, done = min(refits, key=lambda r: r[1].innovation_sd)
    if not np.isfinite(done.innovation_sd):
        raise ModelError(f"the refit with {effect} did not converge",
                         "try another effect; stictionid diagnose ranks them")
    tell("polishing", 0.6)
    model = carrier(done, name, fit.model)
    after = polished(model, together_on_valve(model, done.values, run.rng), run.rng)
    after = _as_it_moved(run, after)
    after, findings = _entering_elsewhere(after, name, run.rng)
    tell("looking for effects that are superfluous now", 0.85)
    spare = _superfluous(after, name, run.rng)
    if spare and prune:
        after = polished(*_without(after, spare), run.rng)
        findings.append(Finding("pruned", "info",
                                f"left out, because {name} explains what they did: {', '.join(spare)}",
                                {"effects": list(spare)}, (), "CRITICISM.md section 7, step 8"))
    elif spare:
        findings.append(Finding("superfluous", "warning",
                                f"{', '.join(spare)} no longer helps beside {name}: without it BIC "
                                f" changes by less than {SUPERFLUOUS:g}; add again with --prune to leave it out",
                                {"effects": list(spare)}, (), "CRITICISM.md section 7, step 8"))
    tell("judging the effect", 0.95)
    support = support_of(run, study, fit, after, name, Policy())
    step = replace(step_of(run, after, name, [support.finding, *findings]), supported=support.supported)
    return with_steps(study, run, (*study.steps, step), after)


def _as_it_moved(run: Run, fit: Fitted) -> Fitted:
    """The fit under a command that moves between samples, where the fit is for a held one and does worse.

    The motion of the command cannot be seen beside a missing effect. Taken for held, the command leaves a lag of half a
    sample.
    """
    moved = moved_after_all(fit, run.options.scan_s)
    if moved is None:
        return fit
    after = polished(*moved, run.rng)
    return after if after.sse < fit.sse else fit


def _entering_elsewhere(fit: Fitted, newest: str, rng: np.random.Generator) -> tuple[Fitted, list[Finding]]:
    """The fit with earlier disturbances moved between output and load, where that explains more beside the newest one.

    Their place was chosen while the newest effect was missing.
    """
    findings = []
    for name in fit.model.spec.effects:
        effect, at = parse(name)
        for other in effect.variants:
            if name == newest or other == at:
                continue
            before, there = fit.model, f"{effect.name}@{other}"
            model = bound(before.loop, replace(before.spec, effects=tuple(
                there if n == name else n for n in before.spec.effects)), s_max=before.s_max, period_s=before.period_s,
                residual=fit.best.left)
            named = {k.replace(f"{name}:", f"{there}:"): v for k, v in before.named(fit.values).items()}
            near = descended(model, model.cube(model.vector(named)[:, None]))
            if fit.best.rows * np.log(fit.sse / max(float(near.costs[0]), 1e-300)) < _ELSEWHERE:
                continue
            after = polished(model, model.values(near.points[:1])[:, 0], rng)
            if fit.best.rows * np.log(fit.sse / max(after.sse, 1e-300)) < _ELSEWHERE:
                continue
            findings.append(Finding(
                "entering-elsewhere", "info",
                f"{effect.name} enters at the {other} and no more at the {at}: beside {newest} that explains more, the "
                f"error falls from {fit.best.rmse:.4g} to {after.best.rmse:.4g}",
                {"effect": effect.name, "before": at, "variant": other}, (effect.name,), "CRITICISM.md section 6"))
            fit = after
            break
    return fit, findings


def _superfluous(after: Fitted, newest: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Earlier physical effects without which the refitted model loses less than SUPERFLUOUS."""
    spec = after.model.spec
    found: list[str] = []
    full = complete(after.model, after.values, None, rng, order=0) if not has_noise(spec) else None

    def loss(model: Model, values: FloatArray) -> float:
        if full is not None:
            return complete(model, values, None, rng, order=0).bic(full.good) - full.bic(full.good)
        rows = float(after.best.rows)
        fewer = after.model.space.size - model.space.size
        return rows * float(np.log(model.evaluate(values).sse / after.sse)) - fewer * float(np.log(rows))

    for name in spec.effects:
        if name == newest or parse(name)[0].noise is not None:
            continue
        model, values = _without(after, (name,))
        coarse = search_model(model)
        polish = refine(coarse.costs, with_start(coarse, coarse.cube(values[:, None])), rng, spread=spreads(coarse),
                        rounds=60, population=16, settle=1e-4)
        # The model with the effect had its last polish; compared with an unpolished one, a lag of a fifth of a sample
        # gained 314.
        if loss(model, coarse.values(polish.points[:1])[:, 0]) < SUPERFLUOUS \
                or loss(model, polished(model, values, rng).values) < SUPERFLUOUS:
            found.append(name)
    return tuple(found)


def _without(after: Fitted, names: Sequence[str]) -> tuple[Model, FloatArray]:
    """The model without some of its effects, its other values unchanged."""
    before = after.model
    spec = replace(before.spec, effects=tuple(n for n in before.spec.effects if n not in names))
    model = bound(before.loop, spec, s_max=before.s_max, period_s=before.period_s,
                  residual=after.best.left)
    return model, model.vector(before.named(after.values))
