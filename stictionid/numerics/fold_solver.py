"""One fold of a cross-validation: many candidates, each solved by separable least squares on the training rows.

The held-out rows are predicted by the best candidate, or by all of them, weighted by their likelihood on the training
rows. Source: docs/details.md, section 11; Hoeting et al. 1999 for averages over models.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import BoolArray, FloatArray

TOLD = 0.05
"""Least share of what all rows tell of a number that the training rows must tell, or it stays that of all rows."""
# Least likelihood, as a share of the best candidate's, that counts in an average. Unit: 1.
_UNLIKELY = 1e-3


@dataclass(frozen=True, slots=True)
class _Solved:
    """Costs (P,) and sizes of the own columns (P, k) of candidates; the shared columns as q r, and the target."""

    costs: FloatArray
    sizes: FloatArray
    q: FloatArray
    r: FloatArray
    target: FloatArray

    def tail(self, own: FloatArray, p: int) -> FloatArray:
        """Sizes (c,) of the shared columns beside candidate `p`, whose own columns on the training rows are (k, m)."""
        return np.asarray(np.linalg.lstsq(self.r, self.q.T @ (self.target - own.T @ self.sizes[p]), rcond=1e-12)[0])


def columns_told(own: FloatArray, columns: FloatArray, goal: FloatArray, rows: tuple[BoolArray, BoolArray],
                 fixed_gain: float | None) -> tuple[BoolArray, FloatArray]:
    """Shared columns (q,) whose sizes the training rows tell; the sizes (q,) of the others by all rows, 0 for these.

    `rows` are those of training and all that count. Of an integrator the first block alone shows the level, where
    errors with which a stem lands add up to a walk: nobody can predict it.
    """
    def told_by(part: FloatArray) -> FloatArray:
        rest = [part[:, j] - np.delete(part, j, 1) @ np.linalg.lstsq(np.delete(part, j, 1), part[:, j], rcond=None)[0]
                for j in range(part.shape[1])]
        return np.array([r @ r for r in rest])

    train, used = rows
    told = np.asarray(told_by(columns[train]) >= TOLD * told_by(columns[used]))
    sizes = np.zeros(told.size)
    if not told.all():
        sizes[~told] = best_of_fold(own[:, :, :1], columns, goal, used, fixed_gain)[2][~told]
    return told, sizes


def best_of_fold(own: FloatArray, columns: FloatArray, goal: FloatArray, train: BoolArray,
                 fixed_gain: float | None) -> tuple[int, FloatArray, FloatArray]:
    """The candidate that fits the training rows (n,) best, with the sizes of its own (k,) and of the shared columns.

    `own` is (k, n, P), `columns` (n, q), `goal` (n,); a `fixed_gain` is the size of the first own column.
    """
    solved = _solve_folds(own, columns, goal, train, fixed_gain)
    p = int(np.argmin(solved.costs))
    return p, solved.sizes[p], solved.tail(own[:, train, p], p)


def mean_of_fold(own: FloatArray, columns: FloatArray, goal: FloatArray, train: BoolArray,
                 fixed_gain: float | None) -> FloatArray:
    """Prediction (n,) averaged over all candidates by their likelihood on the training rows; shapes as `best_of_fold`.

    Many points on a plateau of the cost fit the training rows alike, and slip at different samples of the held-out
    block. The prediction of the best point alone would depend on chance. Wrong where the errors of the training rows
    are far from independent.
    """
    solved = _solve_folds(own, columns, goal, train, fixed_gain)
    ratio = np.maximum(solved.costs, 1e-300) / max(float(solved.costs.min()), 1e-300)
    weight = np.exp(-0.5 * float(train.sum()) * np.log(ratio))
    counted = np.flatnonzero(weight > _UNLIKELY)
    told = np.zeros(goal.size)
    for p in counted.tolist():
        told += weight[p] * (own[:, :, p].T @ solved.sizes[p] + columns @ solved.tail(own[:, train, p], p))
    told /= weight[counted].sum()
    return told


def _solve_folds(own: FloatArray, columns: FloatArray, goal: FloatArray, train: BoolArray,
                 fixed_gain: float | None) -> _Solved:
    k = own.shape[0]
    q, r = np.linalg.qr(columns[train])
    y = goal[train]
    mine = own[:, train]
    rest = mine - np.einsum("ic,kcp->kip", q, np.einsum("ic,kip->kcp", q, mine))
    left = y - q @ (q.T @ y)
    cross = np.einsum("kip,i->pk", rest, left)
    squares = np.einsum("kip,jip->pkj", rest, rest)
    if fixed_gain is not None:
        sizes = np.zeros((own.shape[2], k))
        sizes[:, 0] = fixed_gain
        if k > 1:
            cut = squares[:, 1:, 1:] + 1e-12 * np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(k - 1)
            sizes[:, 1:] = np.linalg.solve(cut, (cross[:, 1:] - fixed_gain * squares[:, 1:, 0])[:, :, None])[:, :, 0]
    else:
        ridge = 1e-12 * np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(k) + 1e-300 * np.eye(k)
        sizes = np.linalg.solve(squares + ridge, cross[:, :, None])[:, :, 0]
    costs = left @ left - 2.0 * (sizes * cross).sum(axis=1) + np.einsum("pk,pkj,pj->p", sizes, squares, sizes)
    return _Solved(costs, sizes, q, r, y)
