"""The verb behind `study`: identify a loop, then add every effect that the search finds."""

from __future__ import annotations

from collections.abc import Callable

from ..fit.options import Options
from ..record.loop import Loop
from ..record.study import Study
from ..selection.policy import Policy
from ..typing import Progress
from .diagnose import diagnose
from .identify import identify

# Share of the work that identify takes, on average. Unit: 1.
_IDENTIFY = 0.6


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
