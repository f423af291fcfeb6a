"""Fit of the noise family to a residual: kind and order by BIC of the exact likelihood.

A survey gives starts for every kind and order (survey.py). The best of each kind is polished (exact.py), then its
neighbours in order, while BIC falls. Slow AR(1) noise, a walk and plain A start one another in the end. Source:
docs/details.md, section 7.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...typing import BoolArray, FloatArray
from ..autoregression import Starts
from .exact import DIFFERENCES, Fitted, Record, group_of, resize_order
from .family import AUTOREGRESSION, MEASURED, WALK, Noise
from .survey import survey_noise

LARGEST_ORDER = 8
# BIC that a random walk must gain over the best stationary noise: at most 1 % false in 1,500 samples, by
# benchmarks/noise_family.py. A gain is about ln(rows) at most, because slow AR(1) noise imitates a walk. Unit: 1.
WALK_MARGIN = 2.0
# Rows per order of A, and the fewest rows from which more than white noise is estimated.
_ROWS_PER_ORDER, _FEWEST = 10, 20
# Most rows in which orders are searched; a longer record is searched in a part and polished in full.
_SEARCHED = 20_000
# BIC by which the start that one kind is to another may be worse than what it has; 1 - rho of a slow start, in rows.
_CROSSED, _SLOW = 5.0, 5.0
# Falls of BIC in favour of another order below which the search for the order stops; steps of the order that it tries.
_BETTER, _AWAY, _AWAY_WITH_GAPS = 1e-6, (-1, 1), (-1, 1, 2)
# BIC behind the best kind beyond which a kind's order is not searched further: without gaps, and with gaps, where the
# survey is coarse.
_NEAR, _NEAR_WITH_GAPS = 20.0, 60.0


def _climb_orders(record: Record, starts: list[Fitted], largest: int, goal: float) -> Fitted:
    """The best order of one group: polished from the best of the survey, then from its neighbours.

    Its neighbours are left out where the polished one is far behind the BIC `goal`.
    """
    away, near = (_AWAY, _NEAR) if record.whole else (_AWAY_WITH_GAPS, _NEAR_WITH_GAPS)
    have = {len(f.noise.taps): f for f in starts}
    first = min(starts, key=lambda f: f.bic)
    best = record.polish_noise(first.noise)
    tried = {len(first.noise.taps)}
    while best.bic < goal + near:
        at = len(best.noise.taps)
        orders = [at + step for step in away if 0 <= at + step <= largest and at + step not in tried]
        if not orders:
            break
        found = []
        for order in orders:
            tried.add(order)
            start = record.with_likelihood(resize_order(best.noise, order))
            if order in have:
                start = min(start, have[order], key=lambda f: f.deviance)
            found.append(record.polish_noise(start.noise))
        now = min(found, key=lambda f: f.bic)
        if not now.bic < best.bic - _BETTER:
            break
        best = now
    return best


def _cross_groups(record: Record, best: Fitted, other: Noise, largest: int, goal: float) -> Fitted:
    """The better of a group's best fit and what the best noise of another group leads to."""
    group = group_of(best.noise)
    near = Noise(other.taps)
    if group != AUTOREGRESSION:
        near = replace(other, rho=1.0 if group == WALK else 1.0 - _SLOW / record.rows)
        if near.theta >= near.rho:
            return best
    start = record.with_likelihood(near)
    if not start.bic < best.bic + _CROSSED:
        return best
    return min(best, _climb_orders(record, [start], largest, goal), key=lambda f: f.bic)


def fits_of(residual: FloatArray, good: BoolArray, starts: Starts = (0,)) -> dict[str, Fitted]:
    """The best fit of each kind: AUTOREGRESSION (white noise included), MEASURED and WALK.

    All have the same rows: the level of every segment is integrated out. Empty for a residual of too few samples, or
    one that is 0.
    """
    record = Record(residual, good, starts)
    largest = min(LARGEST_ORDER, record.rows // _ROWS_PER_ORDER)
    if record.rows < _FEWEST or not np.ptp(record.y[record.good]) > 0.0:
        return {}
    searched = record if record.y.size <= _SEARCHED else _part(record)
    groups: dict[str, list[Fitted]] = {}
    for (group, _), noise in survey_noise(searched, largest).items():
        fitted = searched.with_likelihood(noise)
        if np.isfinite(fitted.bic):
            groups.setdefault(group, []).append(fitted)
    best: dict[str, Fitted] = {}
    for group in sorted(groups, key=lambda group: min(f.bic for f in groups[group])):
        goal = min((f.bic for f in best.values()), default=np.inf)
        best[group] = _climb_orders(searched, groups[group], largest, goal)
    for group, other in ((WALK, MEASURED), (MEASURED, WALK), (AUTOREGRESSION, MEASURED), (AUTOREGRESSION, WALK)):
        if group in best and other in best:
            best[group] = _cross_groups(searched, best[group], best[other].noise, largest,
                                        min(f.bic for f in best.values()))
    walks = [best.pop(group) for group in (WALK, DIFFERENCES) if group in best]
    if walks:
        best[WALK] = min(walks, key=lambda f: f.bic)
    if searched is not record:
        best = {group: record.polish_noise(fitted.noise, 3) for group, fitted in best.items()}
    return best


def _part(record: Record) -> Record:
    """So many rows from the middle of the record as orders are searched in."""
    first = (record.y.size - _SEARCHED) // 2
    inner = record.starts[(record.starts > first) & (record.starts < first + _SEARCHED)] - first
    rows = slice(first, first + _SEARCHED)
    return Record(record.y[rows], record.good[rows], (0, *inner.tolist()))


def fit_noise(residual: FloatArray, good: BoolArray, starts: Starts = (0,), *,
              walk_margin: float = WALK_MARGIN) -> Noise:
    """The noise model of a residual (n,) with the least BIC; white noise where there are too few samples.

    A random walk must gain `walk_margin` over the best stationary noise.
    """
    found = fits_of(residual, good, starts)
    stationary = [fit for kind, fit in found.items() if kind != WALK]
    if not stationary:
        return found[WALK].noise if found else Noise()
    best = min(stationary, key=lambda f: f.bic)
    walk = found.get(WALK)
    return walk.noise if walk is not None and walk.bic + walk_margin < best.bic else best.noise
