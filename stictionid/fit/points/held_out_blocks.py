"""Held-out blocks of a record: their rows, the gap beside each, and the error of a model on them.

Source: docs/details.md, section 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ...model.model import Model
from ...model.spec import Evaluated
from ...numerics.fold_solver import columns_told, mean_of_fold
from ...typing import BoolArray, FloatArray

HOLDOUT_BLOCKS = 5
# A model whose held-out error is above this extrapolates there, and its error means nothing. Unit: swings of y.
_EXTRAPOLATES = 1e3


def held_out_cost(model: Model, best: Evaluated, cube: FloatArray) -> float | None:
    """Held-out error on contiguous blocks; each fold averages the points of the cloud, weighted on its training rows.

    `cube` (k, d) has the best point of all rows first. The valve runs through the whole record, so no fold restarts it.
    The block and a gap beside it are left out. The start-up transient is taken from the full fit: a fold without the
    start could not know it.
    """
    values = model.values(cube)
    own = model.own_columns(*model.responses(values))
    level = model.context.process_value - best.transient
    own = own[:own.shape[0] - best.transients]
    goal = model.filter_columns(level[:, None])[:, 0]
    columns = model.filter_columns(model.shared_columns())
    if model.spec.increments:
        columns = columns[:, len(model.pieces):]  # a constant has no differences
    total, rows, gain = 0.0, 0, model.spec.fixed.get("gain")
    # The first fold cannot know the valve's start either: every candidate starts as the full fit does.
    first = model.own_columns(*model.responses(_match_starts(model, best, values)))[:own.shape[0]]
    folds = fold_rows(model, values[:, 0], [max(p.skip, p.taps.size) for p in model.pieces])
    for fold, (test, near) in enumerate(folds):
        test &= model.weight > 0
        train = (model.weight > 0) & ~near
        if test.sum() < 3 or train.sum() < 5 * (own.shape[0] + columns.shape[1] + 1):
            return None
        mine = own if fold else first
        told, sizes = columns_told(mine, columns, goal, (train, model.weight > 0), gain)
        left = goal - columns @ sizes
        error = (left - mean_of_fold(mine, columns[:, told], left, train, gain))[test]
        total, rows = total + float(np.sum(error**2)), rows + int(test.sum())
    return float(np.sqrt(total / rows)) if np.isfinite(total) else None


def stated_error(model: Model, error: float | None) -> float | None:
    """A held-out error as a study states it: None where the model extrapolates."""
    return None if error is None or error > _EXTRAPOLATES * float(np.ptp(model.context.process_value)) else error


def _match_starts(model: Model, best: Evaluated, values: FloatArray) -> FloatArray:
    """Values (d, k) that all start as the first: the same output change is left until the valve first breaks away.

    The start force is a share of the break-away force. Left as it is, it would move the first slip of a slightly
    different valve by a sample, which no other row tells.
    """
    out = values.copy()
    fs = values[0] + values[1]
    for row, z in zip(model.forces, model.split(best.stem), strict=True):
        moves = np.diff(z)
        way = float(np.sign(moves[np.flatnonzero(moves)[:1]].sum())) or 1.0
        out[row] = np.clip(way * (1.0 - (1.0 - way * values[row, 0]) * fs[0] / np.maximum(fs, 1e-12)), -1.0, 1.0)
    return out


def fold_rows(model: Model, values: FloatArray, firsts: Sequence[int]) -> list[tuple[BoolArray, BoolArray]]:
    """The rows (n,) that each fold holds out, and these with the gap on either side; values (d,) set the gap.

    A fold holds out one block of every segment from its first row on, so that each segment's own level can be known.
    """
    inside = np.zeros((HOLDOUT_BLOCKS, model.loop.samples), bool)
    near = inside.copy()
    at = 0
    for i, (piece, first) in enumerate(zip(model.pieces, firsts, strict=True)):
        n = piece.loop.samples
        # The rows left out on either side of a block are the memory of the process, half a period at least.
        own = model.of(i, values)
        wanted = max(own[4] + 3.0 * own[3], piece.period_s / 2.0) / piece.step_s
        gap = int(min(wanted, (n - first) / (2 * HOLDOUT_BLOCKS)))
        edges = np.linspace(first, n, HOLDOUT_BLOCKS + 1).astype(int)
        counted = np.flatnonzero(piece.good()[first:]) + first
        if counted.size >= HOLDOUT_BLOCKS and np.isnan(piece.loop.process_value).any():
            # Where PV is missing the blocks hold equally many samples that count.
            inner = counted[np.linspace(0, counted.size, HOLDOUT_BLOCKS + 1).astype(int)[1:-1]]
            edges = np.concatenate([[first], inner, [n]])
        for fold, (a, b) in enumerate(pairwise(edges.tolist())):
            inside[fold, at + a:at + b] = True
            near[fold, at + max(a - gap, 0):at + min(b + gap, n)] = True
        at += n
    return list(zip(inside, near, strict=True))
