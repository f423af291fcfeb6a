"""The verb: ranked candidates, the effect to add next, and with `apply` one after the other until none is accepted.

Every candidate is completed with the noise its residual asks for and compared by the innovations of the complete model
on the same samples. Source: METHODS.md section 6; CRITICISM.md sections 1 and 7.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..effects import parse
from ..loop import Finding, Loop
from ..results import Study
from .judge import candidates, winner_of
from .steps import add, finished_step, opened, polished, with_steps
from .tries import Round, try_all

MOST_ADDITIONS = 4
Progress = Callable[[str, float], None]


def diagnose(loop: Loop, study: Study, *, everything: bool = False, apply: bool = False, seed: int = 0, jobs: int = 1,
             bootstrap: int = 0, progress: Progress | None = None) -> Study:
    """The study with ranked candidates and the effect to add next; with `apply` added, and so on until none helps.

    An adequate model is left alone unless `everything` asks for the catalogue. `jobs` processes share the refits;
    `bootstrap` replicates give the named effect a p-value. Raises DataError for an abstained study, and ModelError when
    it can't be rebuilt.
    """
    tell = progress or (lambda text, share: None)
    added: list[str] = []
    while True:
        if study.steps and study.adequate and not everything:
            return replace(study, candidates=() if not added else study.candidates, missing=tuple(added))
        run, fit = opened(loop, study, seed)
        found = try_all(run.loop, fit, seed, jobs, tell)
        if found.better:
            study = _replaced(study, run, found)
        winner = winner_of(found)
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


def _replaced(study: Study, run, found: Round) -> Study:
    """The study with its last step put right: a restart found a better optimum of the same model."""
    before = study.steps[-1]
    after = polished(found.fit.model, found.fit.values, run.rng)
    note = Finding("better-optimum", "warning",
                   f"a restart found a better optimum of the same model: the error falls from "
                   f"{before.error.rmse:.4g} to {after.best.rmse:.4g}, S is {after.best.values['S']:.4g}, "
                   f"J {after.best.values['J']:.4g}; it "
                   "replaces the model, so that no effect is named for it",
                   {"rmse_before": before.error.rmse, "rmse": after.best.rmse}, (), "CRITICISM.md section 7, step 5")
    kept = tuple(f for f in before.findings if f.code != note.code)
    step = finished_step(run, after, before.added, (*kept, note))
    return replace(with_steps(study, run, (*study.steps[:-1], step), after), missing=study.missing)
