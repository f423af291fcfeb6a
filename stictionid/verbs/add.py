"""The verb `add`: one more effect in a study, and the verdict of the new model."""

from __future__ import annotations

from ..errors import UsageError
from ..record.loop import Finding, Loop
from ..record.study import Study
from ..selection.node import plain_name, variants
from ..selection.run import resume_search
from ..selection.score import is_noise
from ..typing import Progress
from .by_hand import asked_for, entered, needless, of_effects, rises, with_finding
from .support import SOURCE
from .valve_changes import with_change


def add(loop: Loop, study: Study, effect: str, *, seed: int = 0, prune: bool = False,
        progress: Progress | None = None) -> Study:
    """The study with one more effect, its model as `diagnose --apply` would have it, and the verdict of that model.

    `effect` may name a variant ("step-disturbance@load"). The new step says whether the record supports the effect. The
    noise is completed anew, and parts that a search put in go where they are needless. Effects that were added by hand
    and are superfluous now are named in a finding, and left out with `prune`. Raises UsageError for an unknown effect,
    one that the model has already, or one that needs a signal that is not there; DataError for an abstained study.
    """
    tell = progress or (lambda text, share: None)
    names = variants(effect, loop)
    on = resume_search(loop, study, seed=seed, progress=progress)
    have = on.fit.model.spec.effects
    if any(plain_name(name) == plain_name(old) for name in names for old in have):
        raise UsageError(f"the model has {effect} already", "choose another effect; stictionid effects lists them")
    asked = asked_for(study)
    noise = next((n for n in (*names, *asked) if is_noise(n)), "") if is_noise(names[0]) or not prune else ""
    tell(f"refitting with {effect}", 0.1)
    entry = on.here if is_noise(names[0]) else entered(on, names, asked)
    keep = names if prune else (*names, *asked)
    after, found = of_effects(loop, on, entry, keep=keep, asked=(*asked, *names), noise=noise, new=names)
    after = with_change(loop, after)
    if rises(study, after):
        after = with_finding(after, _worse(effect, study, after), effect)
    if prune:
        return after
    tell("looking for effects that are superfluous now", 0.9)
    spare = needless(on.search, found, names[0], asked)
    return with_finding(after, _superfluous(spare, effect), effect) if spare else after


def _worse(effect: str, before: Study, after: Study) -> Finding:
    """The finding on an effect with which the free run is further from the measurement than without it."""
    errors = [study.steps[-1].error.best for study in (before, after)]
    said = f"the free-run error rises from {errors[0]:.4g} to {errors[1]:.4g} with {effect}"
    return Finding("worse", "warning", said,
                   {"effect": effect, "rmse_before": errors[0], "rmse_after": errors[1]}, (), SOURCE)


def _superfluous(spare: tuple[str, ...], effect: str) -> Finding:
    """The finding on effects that were added by hand and that the newest one makes superfluous."""
    return Finding("superfluous", "warning",
                   f"{', '.join(spare)} no longer helps beside {effect}: "
                   f"stictionid remove {plain_name(spare[0])} leaves it out", {"effects": list(spare)}, (), SOURCE)
