"""Every picture of one study, in reading order."""

from __future__ import annotations

import numpy as np

from . import evidence_pictures, residual_pictures, tree_picture
from .contribution_picture import contributions
from .curves import Case
from .picture import Picture
from .study_pictures import (
    candidates,
    characteristic,
    closeup,
    cost_map,
    fit,
    ladder,
    phase,
    trend,
    window,
)


def pictures(case: Case) -> dict[str, Picture]:
    """Every picture of one case by key, in reading order; empty without data except for those of the study itself."""
    study, loop = case.study, case.loop
    found = [ladder(study), cost_map(study), candidates(study), tree_picture.tree(study)]
    if loop is not None and loop.samples > 1:
        last = case.curves[-1] if case.curves else None
        found.append(trend(study, loop, last))
        shown = loop.output[window(study, loop)]
        if shown.size and np.ptp(shown) > 0:  # else it is a line without information
            found.append(phase(study, loop))
        if last is not None:
            found += [characteristic(study, loop, last), fit(study, loop, last), closeup(study, loop, last),
                      *residual_pictures.both(study, loop, last)]
        found += [evidence_pictures.film(case), *evidence_pictures.evidence(case)]
        if study.steps and study.steps[-1].model:
            found.append(contributions(study, study.steps[-1], loop))
    return {p.key: p for p in found if p is not None}
