"""Choice between two commands that a valve may have followed: the output as recorded, and as it was computed.

A historian rounds what it stores, and the valve got the full output. A coarse output card rounds what the valve gets.
Only y can tell: the base model is searched under both commands and completed with noise.
"""

from __future__ import annotations

from ..model.spec import Spec
from .context import Run
from .noise.completion import Refit, complete_model, place_slips


def full_over_rounded(full: Run, rounded: Run) -> float:
    """BIC by which the full command explains y better than the one recorded in steps; below 0 where it does worse."""
    return _complete_fit(full).gain_over(_complete_fit(rounded))


def _complete_fit(run: Run) -> Refit:
    fit = run.fit(Spec(law=run.law, fixed=dict(run.options.fixed)))
    return place_slips(complete_model(fit.model, fit.values, None, run.rng, descent=True), other_valves=True)
