"""Choice between two commands that a valve may have followed: the output as recorded, and as it was computed.

A historian rounds what it stores, and the valve got the full output. A coarse output card rounds what the valve gets.
Only y can tell: the base model is fitted under both commands and completed with noise.
"""

from __future__ import annotations

import numpy as np

from ..model.spec import Spec
from .context import Run
from .moves import descended
from .noise.completion import Refit, complete

# Stickbands from which the fit under the recorded command starts, about that under the full one, in steps of rounding.
_SHIFTS = np.linspace(-1.0, 1.0, 9)
_DESCENDED = 3


def full_over_rounded(full: Run, rounded: Run, step: float) -> float:
    """BIC by which the full command explains y better than the one recorded in steps; below 0 where it does worse.

    The rounded one starts from the optimum of the full one: a valve that followed it breaks away within one step of
    that.
    """
    spec = Spec(law=full.law, fixed=dict(full.options.fixed))
    fit = full.fit(spec)
    other = rounded.model(spec)
    starts = other.vector(other.named(fit.values))[:, None].repeat(_SHIFTS.size, axis=1)
    starts[0] = np.maximum(starts[0] + step * _SHIFTS, 0.0)
    cube = other.cube(starts)
    near = descended(other, cube[np.argsort(other.costs(cube))[:_DESCENDED]])
    values = other.values(near.points[:1])[:, 0]

    def completed(run: Run, values: np.ndarray) -> Refit:
        return complete(run.model(spec), values, None, run.rng, descent=True)

    return completed(full, fit.values).gain_over(completed(rounded, values))
