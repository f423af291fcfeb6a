"""Fixed point of a map by Anderson's acceleration: a few evaluations where damped steps need some twenty.

Source: Anderson 1965; Walker and Ni 2011.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ..typing import FloatArray

# Steps that are remembered, the smallest share of their directions that counts, and the damping of the first step.
_MEMORY, _DEPENDENT, _DAMPED = 4, 1e-8, 0.5
# Growth of the residual at which what is remembered misleads: a nonlinear map far from its fixed point.
_GROWN = 1.5

Found = TypeVar("Found")


def fixed_point(evaluate: Callable[[FloatArray], tuple[Found, FloatArray]], start: FloatArray,
                settled: Callable[[Found, FloatArray], bool], turns: int) -> Found:
    """Result of `evaluate`, which maps a point (n,) to a result and a point (n,), at the map's fixed point.

    The search ends where `settled` holds for a result and its residual (n,), or after so many `turns`. Wrong where the
    map has several fixed points: the one near `start` is found.
    """
    point = start
    found, mapped = evaluate(point)
    points: list[FloatArray] = []
    residuals: list[FloatArray] = []
    for _ in range(turns):
        residual = mapped - point
        if residuals and (settled(found, residual) or not np.isfinite(residual).all()):
            break
        if residuals and np.linalg.norm(residual) > _GROWN * np.linalg.norm(residuals[-1]):
            points, residuals = [], []
        points, residuals = [*points[-_MEMORY:], point], [*residuals[-_MEMORY:], residual]
        if len(points) == 1:
            point = point + _DAMPED * residual
        else:
            steps, changes = (np.diff(np.stack(rows, axis=1)) for rows in (points, residuals))
            weights, *_ = np.linalg.lstsq(changes, residual, rcond=_DEPENDENT)
            point = point + residual - (steps + changes) @ weights
        found, mapped = evaluate(point)
    return found
