"""First-order lag whose time constant depends on the direction in which it moves: exact for a held position.

    T x' = u(t - L) - x,   T = T1 where x rises, closing * T1 where it falls.

A process that is heated actively and cools by itself is of this kind. Everything behind the lag is linear and runs as
without it, on the mean of x over each part of a sample.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import kernel
from ..typing import FloatArray, IntArray


@kernel
def _run(position: FloatArray, T: FloatArray, closing: FloatArray, whole: IntArray, early: FloatArray,
         late: FloatArray, ends: FloatArray, means: FloatArray) -> None:
    """Fill ends and means (rows, P) of x over each part; the old input lasts `early` seconds of a part, the new `late`.
    """
    rows, lanes = ends.shape
    shared = position.shape[1] < lanes
    keep = np.empty((4, lanes))
    x = np.zeros(lanes)
    for p in range(lanes):
        keep[0, p], keep[1, p] = np.exp(-early[p] / T[p]), np.exp(-late[p] / T[p])
        keep[2, p], keep[3, p] = np.exp(-early[p] / (closing[p] * T[p])), np.exp(-late[p] / (closing[p] * T[p]))
    for k in range(rows):
        for p in range(lanes):
            q = 0 if shared else p
            start = position[0, q]
            now = position[max(k - whole[p], 0), q] - start
            before = position[max(k - whole[p] - 1, 0), q] - start
            first = x[p]
            falls = before < first
            t1 = closing[p] * T[p] if falls else T[p]
            mid = before + (first - before) * (keep[2, p] if falls else keep[0, p])
            total = before * early[p] + (first - mid) * t1
            falls = now < mid
            t2 = closing[p] * T[p] if falls else T[p]
            last = now + (mid - now) * (keep[3, p] if falls else keep[1, p])
            total += now * late[p] + (mid - last) * t2
            x[p] = last
            ends[k, p] = last
            means[k, p] = total / (early[p] + late[p])


def directional(position: FloatArray, T: FloatArray, L: FloatArray, closing: FloatArray,
                part_s: float) -> tuple[FloatArray, FloatArray]:
    """Ends and means (rows, P) over each part of the lag's response to positions (rows, P or 1) held over parts."""
    delay = np.maximum(L, 0.0) / part_s
    steps = np.floor(delay + 1e-12)
    early = np.clip(delay - steps, 0.0, 1.0) * part_s
    ends, means = (np.empty((position.shape[0], T.size)) for _ in range(2))
    _run(np.ascontiguousarray(position), np.maximum(T, 1e-9 * part_s), closing, steps.astype(np.int64), early,
         part_s - early, ends, means)
    return ends, means
