"""The verb `diagnose`: the effects that the model of a study misses, ranked, and added on request."""

from __future__ import annotations

from dataclasses import replace

from ..effects import parse
from ..fit.noise.completion import quick
from ..fit.noise.unexplained import judged_by
from ..model.restore import described, rebuild_model
from ..record.loop import Loop
from ..record.study import Study
from ..selection.policy import Policy
from ..selection.run import select
from ..typing import Progress
from ..verdict.detectable import detectable
from .add import judged_anew


def diagnose(loop: Loop, study: Study, *, everything: bool = False, apply: bool = False, seed: int = 0, jobs: int = 1,
             bootstrap: int = 0, policy: Policy | None = None, progress: Progress | None = None) -> Study:
    """The study with ranked candidates and the effect to add next; `apply` adds all that the search finds.

    `everything` asks for the whole catalogue even where the model is adequate. `jobs` processes share the fits, and
    `bootstrap` replicates give the named effect a p-value. `policy` holds the numbers of the search; None means
    the defaults. Raises DataError for an abstained study, and for one whose model cannot be built again.
    """
    found = select(loop, study, judged_anew, everything=everything, apply=apply, seed=seed, jobs=jobs,
                   bootstrap=bootstrap, policy=policy or Policy(), progress=progress)
    adequate, why = judged_by(found.unexplained, found.adequate, found.adequate_reason)
    judged = _with_sizes(loop, replace(found, adequate=adequate, adequate_reason=why))
    return _with_what_was_asked(study, judged)


def _with_what_was_asked(before: Study, after: Study) -> Study:
    """The study with candidates and tree of an earlier search, where a new one added nothing to the same model."""
    same = set(after.steps[-1].effects) == set(before.steps[-1].effects) and not after.missing
    if not same or after.candidates or not before.candidates:
        return after
    return replace(after, candidates=before.candidates, tree=max(before.tree, after.tree, key=len))


def _with_sizes(loop: Loop, study: Study) -> Study:
    """The study with the smallest size of every effect that was not named which its record would have shown."""
    if not study.candidates:
        return study
    piece, _ = described(loop, study.steps[-1].model)
    names = {c: c.effect + (f"@{c.variant}" if c.variant and c.variant in parse(c.effect)[0].variants else
                            f":{c.variant}" if c.variant else "") for c in study.candidates if not c.accepted}
    have = {parse(name)[0].name for name in study.steps[-1].effects}
    sizes = detectable([n for c, n in names.items() if c.effect not in have],
                       quick(*rebuild_model(piece, study.steps[-1].model)))
    return replace(study, candidates=tuple(
        replace(c, detectable_from=sizes.get(names[c])) if c in names else c for c in study.candidates))
