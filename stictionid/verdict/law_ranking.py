"""Ranking of stiction laws on one record: the best one, those not told apart from it, and the spread of S and J.

Laws are ranked by their held-out free-run error. Two laws are alike on a record when their errors differ by less than a
hundredth. They are also alike when Wilcoxon's signed rank test finds no difference between their squared errors, taken
in quarter periods. That is a paired comparison of models that are not nested; one odd period (a start-up, a
disturbance) cannot turn it.

Wrong where all laws miss the same thing (a further lag, a disturbance): the ranking then says which law hides it best.
Source: Wilcoxon 1945, signed ranks with the normal approximation; blocks because a residual is not white.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..fit.points.fitted import Fitted
from ..record.loop import AlikeLaws, Finding
from ..record.study import LawResult, Step
from ..typing import BoolArray, FloatArray

# Laws with errors this close are alike whatever the test says. Unit: share of the smaller error.
ALIKE_SHARE = 0.01
# Standard errors of the rank sum below which it is not significant (5 % of false distinctions).
ALIKE_ERRORS = 1.96
# Fewest blocks from which a standard error is taken.
_FEWEST_BLOCKS = 4
# Blocks in one period: short enough for a few periods to decide, long enough to hold a slip and its consequence.
_BLOCKS_PER_PERIOD = 4
PREFERRED = "chen"


@dataclass(frozen=True, slots=True)
class Ranking:
    """Laws best first, the one to keep, those that cannot be told from the best, and the finding about it."""

    laws: tuple[LawResult, ...]
    keep: str
    alike: tuple[str, ...]
    finding: Finding


def rank(fits: Mapping[str, tuple[Step, Fitted]], *, period: int) -> Ranking:
    """Rank the last step and fit of each law; `period` is in samples and sets the blocks of the comparison.

    The best law is kept, or the default law where its error is the same within `ALIKE_SHARE`. Laws without a held-out
    error rank by their error on all samples, and those that extrapolate rank last.
    """
    errors = {name: np.inf if step.extrapolates else
              step.error.best if step.error.rmse_holdout is None else step.error.rmse_holdout
              for name, (step, _) in fits.items()}
    order = sorted(fits, key=lambda name: (errors[name], name != PREFERRED, name))
    best = order[0]
    alike = tuple(n for n in order if n == best
                  or _errors_alike(fits[best][1], fits[n][1], errors[best], errors[n], period))
    tied = PREFERRED in fits and errors[PREFERRED] <= (1.0 + ALIKE_SHARE) * errors[best]
    keep = PREFERRED if tied else best
    laws = tuple(LawResult(n, fits[n][1].best.values["S"], fits[n][1].best.values["J"],
                           fits[n][0].error.rmse_holdout, fits[n][0].error.best) for n in order)
    return Ranking(laws, keep, alike, _finding(laws, alike, keep))


def _errors_alike(best: Fitted, other: Fitted, best_error: float, other_error: float, period: int) -> bool:
    if other_error <= (1.0 + ALIKE_SHARE) * best_error:
        return True
    counted = (best.best.counted > 0) & (other.best.counted > 0)
    difference = np.where(counted, np.nan_to_num(other.best.residual) ** 2 - np.nan_to_num(best.best.residual) ** 2,
                          0.0)
    means = _block_means(difference, counted, max(period // _BLOCKS_PER_PERIOD, 1))
    if means.size < _FEWEST_BLOCKS:
        return False
    return abs(_signed_ranks(means)) < ALIKE_ERRORS


def _signed_ranks(differences: FloatArray) -> float:
    """Wilcoxon's signed rank sum of differences (k,) in its standard errors; positive where most of them are."""
    k = differences.size
    ranks = np.empty(k)
    ranks[np.argsort(np.abs(differences), kind="stable")] = np.arange(1, k + 1)
    return float(np.sum(np.sign(differences) * ranks)) / np.sqrt(k * (k + 1) * (2 * k + 1) / 6.0)


def _block_means(values: FloatArray, counted: BoolArray, block: int) -> FloatArray:
    """Means of `values` over blocks of `block` samples in which something counts."""
    whole = values.size // block * block
    weights = counted[:whole].reshape(-1, block).sum(axis=1)
    sums = values[:whole].reshape(-1, block).sum(axis=1)
    return sums[weights > 0] / weights[weights > 0]


def _finding(laws: tuple[LawResult, ...], alike: tuple[str, ...], keep: str) -> Finding:
    near = [law for law in laws if law.law in alike]
    spans, everywhere = ({name: (min(values), max(values)) for name, values in
                          (("S", [x.S for x in these]), ("J", [x.J for x in these]))} for these in (near, laws))
    told = AlikeLaws(alike, keep, spans["S"], spans["J"], everywhere["S"], everywhere["J"])
    moves = "S moves from {:.4g} to {:.4g} % and J from {:.4g} to {:.4g} %"
    all_said = moves.format(*everywhere["S"], *everywhere["J"]) + f" over all {len(laws)} laws"
    if len(alike) == 1:
        return Finding("laws-told-apart", "info", f"the law {keep} fits this record better than any other; {all_said}",
                       source="stictionid identify --law all", laws=told)
    return Finding("laws-alike", "info",
                   f"these signals can't tell apart the laws {', '.join(alike)} ({keep} is kept): between them "
                   f"{moves.format(*spans['S'], *spans['J'])}; {all_said}",
                   source="stictionid identify --law all", laws=told)
