"""One effect added to a study: refit, step with public parameter names, earlier effects that became superfluous."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects import parse
from ..errors import DataError, ModelError, UsageError
from ..fit.add_effect import REFITS, carrier, polished, refitted
from ..fit.context import CONDITIONAL, Run, process_numbers
from ..fit.fit import Fitted, as_it_stands
from ..fit.moves import descended, search_model, spreads, with_start
from ..fit.noise.completion import Refit, at_noise, complete, has_noise
from ..fit.options import Options
from ..fit.starts.beside_effect import starting_pool
from ..fit.starts.intersample import moved_after_all
from ..fit.with_effect import together_on_valve
from ..model.model import Model
from ..model.restore import rebuild_model
from ..model.segments import bound
from ..numerics.population import refine
from ..record.loop import Finding, Loop
from ..record.oscillation import find_range
from ..record.segments import described
from ..record.study import Estimate, Step, Study, intervals_withheld, without_intervals
from ..typing import FloatArray, Progress
from .node import variants

# An earlier effect is superfluous when the model without it loses less than this in BIC (CRITICISM.md section 7).
SUPERFLUOUS = 2.0
# Twice the log-likelihood that a disturbance must gain by entering elsewhere (CRITICISM.md section 7, step 7: "named").
_ELSEWHERE = 10.0


def opened(loop: Loop, study: Study, seed: int) -> tuple[Run, Fitted]:
    """The study's last model on its record, ready for refits; DataError for an abstained study."""
    if not study.steps or not study.steps[-1].model:
        raise DataError("the study abstained, so there is no model to work on", study.verdict.reason)
    piece, _ = described(loop, study.steps[-1].model)
    model, values = rebuild_model(piece, study.steps[-1].model)
    options = Options(law=model.spec.law, seed=seed)
    run = Run(piece, find_range(piece), options, law=model.spec.law, rng=np.random.default_rng(seed),
              tell=lambda text, share: None)
    return run, as_it_stands(model, values)


def extended(loop: Loop, study: Study, effect: str, *, seed: int = 0, prune: bool = False, known: Refit | None = None,
             progress: Progress | None = None) -> Study:
    """The study with one more step: the model refitted with `effect` ("step-disturbance@load" names a variant).

    Earlier effects that the new one makes superfluous are named in a finding, and left out with `prune`. A refit that
    is `known` already replaces one of two, or both where it leaves only noise. Verdict and severity are still those of
    the study before (`verbs.add.judged_anew`). Raises UsageError for an unknown effect, one that the model has already,
    or one that needs a signal that is not there.
    """
    tell = progress or (lambda text, share: None)
    run, fit = opened(loop, study, seed)
    names = variants(effect, loop)
    if any(_plain(name) == _plain(have) for name in names for have in fit.model.spec.effects):
        raise UsageError(f"the model has {effect} already", "choose another effect; stictionid effects lists them")
    tell(f"refitting with {effect}", 0.1)
    refits = [] if known is None else [(effect, known)]
    if known is None or not at_noise(known):
        pool = starting_pool(fit.model, fit.values, run.rng)
        refits = [(name, refitted(fit, name, pool, run.rng, 1 if known else REFITS)) for name in names] + refits
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
    spare = superfluous(after, name, run.rng)
    if spare and prune:
        after = polished(*without(after, spare), run.rng)
        findings.append(Finding("pruned", "info",
                                f"left out, because {name} explains what they did: {', '.join(spare)}",
                                {"effects": list(spare)}, (), "CRITICISM.md section 7, step 8"))
    elif spare:
        findings.append(Finding("superfluous", "warning",
                                f"{', '.join(spare)} no longer helps beside {name}: without it BIC "
                                f" changes by less than {SUPERFLUOUS:g}; add again with --prune to leave it out",
                                {"effects": list(spare)}, (), "CRITICISM.md section 7, step 8"))
    step = finished_step(run, after, name, findings)
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


def with_steps(study: Study, run: Run, steps: tuple[Step, ...], after: Fitted) -> Study:
    """The study with new steps: main values and adequacy are those of the last step's fit."""
    adequate, why = judged(run, steps[-1], after)
    main = estimate(study, after)
    if intervals_withheld(study.steps):
        steps = without_intervals(steps)
    return replace(study, steps=steps, estimate=main, adequate=adequate, adequate_reason=why, missing=())


def judged(run: Run, step: Step, after: Fitted) -> tuple[bool, str]:
    """True where a step is adequate (free run at the noise, or white innovations under a noise model); and the reason.
    """
    if has_noise(after.model.spec):
        return True, f"the one-step error {step.error.rmse_one_step:.4g} is that of white innovations"
    return run.adequate(step)


def finished_step(run: Run, after: Fitted, added: str | None, findings: Sequence[Finding] = ()) -> Step:
    """A fit as a step of its own.

    The finding on conditional intervals is that of this fit, not one of `findings`.
    """
    step = run.step(replace(after, runs=1, agree=1), added)
    return replace(step, findings=(*step.findings, *(f for f in findings if f.code != CONDITIONAL)))


def superfluous(after: Fitted, newest: str, rng: np.random.Generator) -> tuple[str, ...]:
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
        model, values = without(after, (name,))
        coarse = search_model(model)
        polish = refine(coarse.costs, with_start(coarse, coarse.cube(values[:, None])), rng, spread=spreads(coarse),
                        rounds=60, population=16, settle=1e-4)
        # The model with the effect had its last polish; compared with an unpolished one, a lag of a fifth of a sample
        # gained 314.
        if loss(model, coarse.values(polish.points[:1])[:, 0]) < SUPERFLUOUS \
                or loss(model, polished(model, values, rng).values) < SUPERFLUOUS:
            found.append(name)
    return tuple(found)


def without(after: Fitted, names: Sequence[str]) -> tuple[Model, FloatArray]:
    """The model without some of its effects, its other values unchanged."""
    before = after.model
    spec = replace(before.spec, effects=tuple(n for n in before.spec.effects if n not in names))
    model = bound(before.loop, spec, s_max=before.s_max, period_s=before.period_s,
                  residual=after.best.left)
    return model, model.vector(before.named(after.values))


def estimate(study: Study, fit: Fitted) -> Estimate | None:
    """The study's main values after a refit."""
    if study.estimate is None:
        return None
    v = fit.best.values
    if intervals_withheld(study.steps):
        fit = replace(fit, intervals={})
    spans = fit.intervals
    return replace(study.estimate, S=v["S"], J=v["J"], S_interval=spans.get("S"), J_interval=spans.get("J"),
                   initial_residual_force=v["initial_residual_force"], **process_numbers(fit))


def _plain(name: str) -> str:
    return name.partition("@")[0].partition(":")[0]



