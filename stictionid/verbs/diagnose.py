"""The verb `diagnose`: the effects that the model of a study misses, ranked, and added on request."""

from __future__ import annotations

from ..record.loop import Loop
from ..record.study import Study
from ..selection.policy import Policy
from ..selection.run import select
from ..typing import Progress
from .add import judged_anew


def diagnose(loop: Loop, study: Study, *, everything: bool = False, apply: bool = False, seed: int = 0, jobs: int = 1,
             bootstrap: int = 0, policy: Policy | None = None, progress: Progress | None = None) -> Study:
    """The study with ranked candidates and the effect to add next; `apply` adds one after the other until none helps.

    `everything` refits the whole catalogue even where the model is adequate. `jobs` processes share the refits, and
    `bootstrap` replicates give the named effect a p-value. `policy` holds the numbers of the search; None means
    the defaults. Raises DataError for an abstained study, and for one whose model cannot be built again.
    """
    return select(loop, study, judged_anew, everything=everything, apply=apply, seed=seed, jobs=jobs,
                bootstrap=bootstrap, policy=policy or Policy(), progress=progress)
