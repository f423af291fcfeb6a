"""The verb `add`: one more effect in a study, and the verdict of the new model."""

from __future__ import annotations

from dataclasses import replace

from ..record.loop import Loop
from ..record.study import Study
from ..selection.steps import extended, opened
from ..typing import Progress
from ..verdict.judge import judge
from ..verdict.severity import severity_of


def add(loop: Loop, study: Study, effect: str, *, seed: int = 0, prune: bool = False,
        progress: Progress | None = None) -> Study:
    """The study with one more step, the model refitted with `effect`, and the verdict of that model.

    `effect` may name a variant ("step-disturbance@load"). Earlier effects that the new one makes superfluous are named
    in a finding, and left out with `prune`. Raises UsageError for an unknown effect, one that the model has already, or
    one that needs a signal that is not there; DataError for an abstained study.
    """
    return judged_anew(loop, extended(loop, study, effect, seed=seed, prune=prune, progress=progress), seed)


def judged_anew(loop: Loop, study: Study, seed: int) -> Study:
    """The study with the verdict and the severity of its last model: an effect in the model no longer hides the valve.

    Raises DataError for an abstained study.
    """
    run, fit = opened(loop, study, seed)
    main = study.estimate
    return replace(study, verdict=judge(run, fit, loop, main.from_position if main else None),
                   severity=severity_of(run.loop, main, fit) if main else None)
