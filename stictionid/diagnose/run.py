"""The verb: ranked candidates, the effect to add next, and with `apply` one after the other until none is accepted.

Every candidate is completed with the noise its residual asks for and compared by the innovations of the complete model
on the same samples. Source: METHODS.md section 6; CRITICISM.md sections 1 and 7.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..effects import parse
from ..loop import Finding, Loop
from ..methods.run import Run
from ..refit import quick
from ..rerun import rebuild_model
from ..results import Study
from .judge import candidates, winner_of
from .steps import add, finished_step, opened, polished, with_steps
from .tries import NAMED, Round, Tried, try_all

MOST_ADDITIONS = 4
Progress = Callable[[str, float], None]


def diagnose(loop: Loop, study: Study, *, everything: bool = False, apply: bool = False, seed: int = 0, jobs: int = 1,
             bootstrap: int = 0, progress: Progress | None = None) -> Study:
    """The study with ranked candidates and the effect to add next; with `apply` added, and so on until none helps.

    An adequate model is left alone unless `everything` asks for the catalogue, or only its noise model makes it so.
    `jobs` processes share the refits; `bootstrap` replicates give the named effect a p-value. Raises DataError for an
    abstained study, and ModelError when it can't be rebuilt.
    """
    tell = progress or (lambda text, share: None)
    added: list[str] = []
    while True:
        silent = None if added else before_noise(study)
        if study.steps and study.adequate and not everything and silent is None:
            return replace(study, candidates=() if not added else study.candidates, missing=tuple(added))
        run, fit = opened(loop, silent or study, seed)
        found = try_all(run.loop, fit, seed, jobs, tell)
        winner = winner_of(found)
        if silent is not None and not _beats(winner, study, run):
            # The noise stays: what it could hide does no better.
            kept = tuple(c for c in candidates(found, winner) if c.effect not in study.steps[-1].effects)
            return replace(study, candidates=kept, missing=())
        if silent is not None or found.better:
            study = _replaced(silent or study, run, found, winner if silent is not None else None)
        p_value = None
        if bootstrap and winner is not None:
            from .bootstrap import p_of

            p_value = p_of(found, winner, bootstrap, seed, jobs, tell)
        study = replace(study, candidates=candidates(found, winner, p_value),
                        missing=(parse(winner.name)[0].name,) if winner else ())
        if not apply or winner is None or len(added) >= MOST_ADDITIONS:
            return replace(study, missing=tuple(added)) if apply else study
        ranking = study.candidates
        # What an addition makes superfluous goes (CRITICISM.md section 7, step 8); a finding of the step says so.
        study = replace(add(loop, study, winner.name, seed=seed, prune=True, progress=progress), candidates=ranking)
        added.append(parse(winner.name)[0].name)


def before_noise(study: Study) -> Study | None:
    """The study as it was before a noise model came in, None where there is none to do without.

    An autoregression can imitate anything one step ahead, so a noise model that was chosen before any physics was
    tried has to stand against the whole catalogue first.
    """
    for k, step in enumerate(study.steps[1:], 1):
        if step.added and parse(step.added)[0].noise is not None:
            return replace(study, steps=study.steps[:k])
    return None


def _beats(winner: Tried | None, study: Study, run: Run) -> bool:
    """Whether a physical effect does clearly better than the study's last model, noise and all, on the same samples."""
    if winner is None or winner.noise or winner.refit is None:
        return False
    model, values = rebuild_model(run.loop, study.steps[-1].model)
    now = quick(model, values)
    good = now.good & winner.refit.good
    return parse(winner.name)[0].name not in study.steps[-1].effects \
        and now.bic(good) - winner.refit.bic(good) >= NAMED


def _replaced(study: Study, run: Run, found: Round, instead: Tried | None) -> Study:
    """The study with its last step put right: a restart found a better optimum of the same model, or the noise model
    that followed it gives way to an effect that does better (`instead`)."""
    before = study.steps[-1]
    after = polished(found.fit.model, found.fit.values, run.rng)
    notes = []
    if found.better:
        notes.append(Finding(
            "better-optimum", "warning",
            f"a restart found a better optimum of the same model: the error falls from {before.error.rmse:.4g} to "
            f"{after.best.rmse:.4g}, S is {after.best.values['S']:.4g}, J {after.best.values['J']:.4g}; it replaces "
            "the model, so that no effect is named for it",
            {"rmse_before": before.error.rmse, "rmse": after.best.rmse}, (), "CRITICISM.md section 7, step 5"))
    if instead is not None:
        notes.append(Finding(
            "noise-gave-way", "info",
            f"the noise model is left out again: {instead.name} explains what it had imitated",
            {"effect": instead.name}, (parse(instead.name)[0].name,), "CRITICISM.md section 7, step 7"))
    codes = {note.code for note in notes}
    kept = tuple(f for f in before.findings if f.code not in codes)
    step = finished_step(run, after, before.added, (*kept, *notes))
    return replace(with_steps(study, run, (*study.steps[:-1], step), after), missing=study.missing)
