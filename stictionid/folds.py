"""One fold of a hold-out: the best of many candidates on the rows that train, all of them by separable least squares.

Source: CRITICISM.md section 7, step 6.
"""

from __future__ import annotations

import numpy as np

from .loop import BoolArray, FloatArray


def best_of_fold(own: FloatArray, columns: FloatArray, goal: FloatArray, train: BoolArray,
                 fixed_gain: float | None) -> tuple[int, FloatArray, FloatArray]:
    """The candidate that fits the training rows (n,) best, with the sizes of its own (k,) and of the shared columns.

    `own` is (k, n, P), `columns` (n, q), `goal` (n,); a `fixed_gain` is the size of the first own column.
    """
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
    p = int(np.argmin(costs))
    tail = np.linalg.lstsq(r, q.T @ (y - mine[:, :, p].T @ sizes[p]), rcond=1e-12)[0]
    return p, sizes[p], tail
