"""The verbs `diagnose`, the effects that the model of a study misses, and `study`, which identifies a loop before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..fit.noise.unexplained import judged_by
from ..options import Options
from ..record.loop import Loop
from ..record.study import Study
from ..selection.policy import Policy
from ..selection.run import select
from ..typing import Progress
from .by_hand import judged_anew, with_carrier, with_sizes
from .identify import identify
from .valve_changes import with_change

# Share of the work that identify takes, on average. Unit: 1.
_IDENTIFY = 0.6


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
    judged = with_sizes(loop, with_carrier(replace(found, adequate=adequate, adequate_reason=why)))
    return _with_what_was_asked(study, with_change(loop, judged))


def _with_what_was_asked(before: Study, after: Study) -> Study:
    """The study with candidates and tree of an earlier search, where a new one added nothing to the same model."""
    same = set(after.steps[-1].effects) == set(before.steps[-1].effects) and not after.missing
    if not same or not before.candidates:
        return after
    known = {c.effect for c in before.candidates}
    return replace(after, candidates=(*before.candidates, *(c for c in after.candidates if c.effect not in known)),
                   tree=max(before.tree, after.tree, key=len))


def whole_study(loop: Loop, *, options: Options, policy: Policy | None = None, jobs: int = 1,
                progress: Progress | None = None, tell: Callable[[str, Study], None] | None = None) -> Study:
    """The study of a loop with the effects that it misses; an abstention is a study too.

    `tell` gets the name of each stage that is done, "identify" and "diagnose", and the study so far. Errors are those
    of `identify`.
    """
    say, done = progress or (lambda text, share: None), tell or (lambda stage, study: None)
    study = identify(loop, options=options, policy=policy,
                     progress=lambda text, share: say(f"identify: {text}", _IDENTIFY * share))
    done("identify", study)
    if not study.steps or not study.steps[-1].model:
        return study
    study = diagnose(loop, study, apply=True, seed=options.seed, jobs=jobs, policy=policy,
                     progress=lambda text, share: say(f"diagnose: {text}", _IDENTIFY + (1.0 - _IDENTIFY) * share))
    done("diagnose", study)
    return study
