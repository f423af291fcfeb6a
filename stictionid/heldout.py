"""Held-out errors of a completed model, block by block, so that two models can be compared on the same blocks.

The valve runs through the whole record; only the rows of a block and a gap beside it are left out of the regression,
and each fold takes the best point of a cloud around the optimum for its own rows. Source: CRITICISM.md section 7, step
6.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .fit import _CLOUD, HOLDOUT_BLOCKS, _cloud, gap_rows
from .folds import best_of_fold
from .loop import FloatArray
from .refit import Refit
from .regression import whiten

# Points of the cloud that folds choose from.
_CHOICE = _CLOUD // 3


@dataclass(frozen=True, slots=True)
class Held:
    """Sums of squared held-out errors and rows of each block (B,): one step ahead, and of the free run."""

    one_step: FloatArray
    rows: FloatArray
    level: FloatArray
    level_rows: FloatArray

    @property
    def rmse_one_step(self) -> float:
        """Held-out one-step error in the unit of y."""
        return float(np.sqrt(self.one_step.sum() / max(self.rows.sum(), 1.0)))

    @property
    def rmse(self) -> float:
        """Held-out free-run error in the unit of y."""
        return float(np.sqrt(self.level.sum() / max(self.level_rows.sum(), 1.0)))


def held_out(done: Refit, rng: np.random.Generator) -> Held | None:
    """Held-out errors of a refit; None where the record is too short for the folds."""
    model = done.white_model()
    cube, cost = _cloud(model, model.cube(done.values[:, None])[0], rng)
    points = cube[np.argsort(cost, kind="stable")[:_CHOICE]]
    values = model.values(points)
    n = model.loop.samples
    base, offsets = model.responses(values, filtered=False)
    level = np.stack([base[o:o + n] for o in offsets])
    base, offsets = model.responses(values)
    white = np.stack([base[o:o + n] for o in offsets])
    keep = white.shape[0] - done.evaluated.transients
    y = model.context.process_value - done.evaluated.transient
    shared = model._columns()
    goal = whiten(y[:, None], model.taps)[:, 0]
    columns = whiten(shared, model.taps)
    if model.spec.increments:
        columns, shared = columns[:, 1:], shared[:, 1:]
    gap = gap_rows(model, done.values, model.skip)
    counted, sums = done.evaluated.counted > 0, []
    for a, b in pairwise(np.linspace(model.skip, n, HOLDOUT_BLOCKS + 1).astype(int).tolist()):
        inside = np.zeros(n, bool)
        inside[a:b] = True
        test, train = inside & (model.weight > 0), model.weight > 0
        train[max(a - gap, 0):b + gap] = False
        if test.sum() < 3 or train.sum() < 5 * (keep + columns.shape[1]):
            return None
        p, sizes, tail = best_of_fold(white[:keep], columns, goal, train, model.spec.fixed.get("gain"))
        error = goal - white[:keep, :, p].T @ sizes - columns @ tail
        rest = y - level[:keep, :, p].T @ sizes - shared @ tail
        if model.spec.increments:
            rest = rest - rest[train & counted].mean() if (train & counted).any() else rest
        sums.append((float(np.sum(error[test] ** 2)), float(test.sum()), float(np.sum(rest[inside & counted] ** 2)),
                     float((inside & counted).sum())))
    found = np.array(sums).T
    return Held(*found) if np.isfinite(found).all() else None
