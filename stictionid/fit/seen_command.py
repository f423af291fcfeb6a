"""Choice between two commands that a valve may have followed: the output as recorded, and as it was computed.

A historian rounds what it stores, and the valve got the full output. A coarse output card rounds what the valve gets.
Only y can tell: the base model is searched under both commands and completed with noise.
"""

from __future__ import annotations

from ..model.spec import Spec
from .context import Run
from .noise.completion import Refit, complete, likelier


def full_over_rounded(full: Run, rounded: Run) -> float:
    """BIC by which the full command explains y better than the one recorded in steps; below 0 where it does worse."""
    return _completed(full).gain_over(_completed(rounded))


def _completed(run: Run) -> Refit:
    fit = run.fit(Spec(law=run.law, fixed=dict(run.options.fixed)))
    return likelier(complete(fit.model, fit.values, None, run.rng, descent=True), anew=True)
