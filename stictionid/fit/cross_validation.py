"""Held-out errors of a completed model, block by block, so that two models can be compared on the same blocks.

The valve runs through the whole record. Only the rows of a block and a gap beside it are left out of the regression.
Each fold starts from the optimum, tries damped Gauss-Newton steps on its own rows, and takes the best. Source:
docs/details.md, section 11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.model import Model
from ..model.spec import Evaluated
from ..numerics.fold_solver import TOLD, best_of_fold, columns_told
from ..numerics.gauss_newton import damped_moves, slopes_at
from ..typing import BoolArray, FloatArray
from .noise.completion import Refit
from .points.held_out_blocks import fold_rows

# Step of the finite differences behind the slopes, as a share of the range.
_DIFFERENCE = 1e-3


@dataclass(frozen=True, slots=True)
class Held:
    """Sums of squared held-out errors and rows of each block (B,): one step ahead, and of the free run."""

    one_step: FloatArray
    rows: FloatArray
    level: FloatArray
    level_rows: FloatArray

    @property
    def blocks(self) -> FloatArray:
        """Held-out one-step error of each block (B,) in the unit of y."""
        return np.sqrt(self.one_step / np.maximum(self.rows, 1.0))

    @property
    def rmse_one_step(self) -> float:
        """Held-out one-step error in the unit of y."""
        return float(np.sqrt(self.one_step.sum() / max(self.rows.sum(), 1.0)))

    @property
    def rmse(self) -> float:
        """Held-out free-run error in the unit of y."""
        return float(np.sqrt(self.level.sum() / max(self.level_rows.sum(), 1.0)))


def blocks_won(after: Held | None, before: Held | None) -> tuple[int | None, int | None]:
    """Held-out blocks whose one-step error is lower with `after`, and all blocks; None where none could be held out."""
    if after is None or before is None:
        return None, None
    return int((after.blocks < before.blocks).sum()), after.blocks.size


def held_out(done: Refit) -> Held | None:
    """Held-out errors of a refit; None where the record is too short for the folds."""
    return held_out_of(done.white_model(), done.values, done.evaluated)


def held_out_of(model: Model, optimum: FloatArray, evaluated: Evaluated) -> Held | None:
    """Held-out errors of a prewhitened model at its optimum (d,), run in full as `evaluated`; None as `held_out`."""
    folds = _folds(model, optimum)
    if folds is None:
        return None
    values = model.values(_polish_folds(model, model.cube(optimum[:, None])[0], [train for _, train, _ in folds]))
    level = model.own_columns(*model.responses(values, filtered=False))
    white = model.own_columns(*model.responses(values))
    keep = white.shape[0] - evaluated.transients
    y = model.context.process_value - evaluated.transient
    shared = model.shared_columns()
    goal = model.filter_columns(y[:, None])[:, 0]
    columns = model.filter_columns(shared)
    if model.spec.increments:
        columns, shared = columns[:, len(model.pieces):], shared[:, len(model.pieces):]
    counted, used, sums, gain = evaluated.counted > 0, model.weight > 0, [], model.spec.fixed.get("gain")
    for test, train, inside in folds:
        if train.sum() < 5 * (keep + columns.shape[1]):
            return None
        told, tail = columns_told(white[:keep], columns, goal, (train, used), gain)
        p, sizes, tail[told] = best_of_fold(white[:keep], columns[:, told], goal - columns @ tail, train, gain)
        error = goal - white[:keep, :, p].T @ sizes - columns @ tail
        rest = y - level[:keep, :, p].T @ sizes - shared @ tail
        if model.spec.increments:
            rest = np.concatenate([part - part[known].mean() if known.any() else part for part, known in
                                   zip(model.split(rest), model.split(train & counted), strict=True)])
        sums.append((float(np.sum(error[test] ** 2)), float(test.sum()), float(np.sum(rest[inside & counted] ** 2)),
                     float((inside & counted).sum())))
    found = np.array(sums).T
    return Held(*found) if np.isfinite(found).all() else None


def _folds(model: Model, optimum: FloatArray) -> list[tuple[BoolArray, BoolArray, BoolArray]] | None:
    """For each block the rows (n,) that test, that train, and all of the block's; None where a block has none."""
    found = []
    for inside, near in fold_rows(model, optimum, [piece.skip for piece in model.pieces]):
        test, train = inside & (model.weight > 0), (model.weight > 0) & ~near
        if test.sum() < 3 or not train.any():
            return None
        found.append((test, train, inside))
    return found


def _polish_folds(model: Model, top: FloatArray, trains: list[BoolArray]) -> FloatArray:
    """The optimum (d,) and the points that damped steps from it reach on the rows of each fold (k, d).

    Parameters that a fold's rows cannot determine stay: the start of the valve, and those that show in the block alone.
    Under a held command all friction stays too. A break-away one sample earlier or later inside the block is unknown to
    the other rows, and slopes see no such jumps.
    """
    free = model.space.movable
    free[list(model.forces)] = False
    if model.spec.held:
        free[:2] = False
        for effect, rows in zip(model.effects, model.effect_rows, strict=True):
            if effect.friction is not None:
                free[rows] = False
    columns = np.flatnonzero(free)
    if not columns.size:
        return top[None]
    slopes, now = slopes_at(model.residuals, top[None], columns, np.full((1, columns.size), _DIFFERENCE))
    whole = np.sum(slopes[0] ** 2, axis=0)
    points = [top[None]]
    for train in trains:
        told = np.flatnonzero(np.sum(slopes[0][train] ** 2, axis=0) > TOLD * whole)
        if told.size:
            slope = slopes[0][train][:, told]
            moves = damped_moves(slope.T @ slope, slope.T @ now[0][train])
            moved = top[None].repeat(len(moves), axis=0)
            moved[:, columns[told]] = np.clip(top[columns[told]] + moves, 0.0, 1.0)
            points.append(moved)
    return np.concatenate(points)
