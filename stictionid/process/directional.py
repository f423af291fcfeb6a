"""First-order lag whose time constant depends on direction, behind a dead time that may drift, for a held position.

    T x' = u(t - L(t)) - x,   T = T1 where x rises, closing * T1 where it falls,   L(t) = L (1 + drift t) >= 0.

A process that is heated actively and cools by itself is of the first kind, a pipe whose flow fades of the second. The
lag is exact. A dead time that drifts is taken at the middle of each part of a sample, within which it moves by a few
percent of the part at most. Everything behind the lag is linear and runs as without it, on the mean of x over each
part.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import kernel
from ..typing import FloatArray


@kernel
def _run(position: FloatArray, T: FloatArray, closing: FloatArray, delay: FloatArray, growth: FloatArray,
         part_s: float, ends: FloatArray, means: FloatArray) -> None:
    """Fill ends and means (rows, P) of x over each part; a dead time is `delay` parts and grows by `growth` a part."""
    rows, lanes = ends.shape
    shared = position.shape[1] < lanes
    keep = np.empty((2, lanes))
    x = np.zeros(lanes)
    for p in range(lanes):
        keep[0, p], keep[1, p] = np.exp(-part_s / T[p]), np.exp(-part_s / (closing[p] * T[p]))
    for k in range(rows):
        for p in range(lanes):
            q = 0 if shared else p
            start = position[0, q]
            late = max(delay[p] + growth[p] * k, 0.0)
            whole = int(late + 1e-12)
            now = position[max(k - whole, 0), q] - start
            before = position[max(k - whole - 1, 0), q] - start
            mid, total, rest = x[p], 0.0, part_s
            if before != now:
                # The input of the part before lasts until the new one arrives.
                early = max(late - whole, 0.0) * part_s
                rest = part_s - early
                t = closing[p] * T[p] if before < mid else T[p]
                moved = (mid - before) * (1.0 - np.exp(-early / t))
                total = before * early + moved * t
                mid -= moved
            falls = now < mid
            t = closing[p] * T[p] if falls else T[p]
            last = now + (mid - now) * ((keep[1, p] if falls else keep[0, p]) if before == now else np.exp(-rest / t))
            total += now * rest + (mid - last) * t
            x[p] = last
            ends[k, p] = last
            means[k, p] = total / part_s


def directional_lag(position: FloatArray, T: FloatArray, L: FloatArray, closing: FloatArray, growth: FloatArray,
                    part_s: float) -> tuple[FloatArray, FloatArray]:
    """Ends and means (rows, P) over each part of the lag's response to positions (rows, P or 1) held over parts.

    `L` is the dead time at the middle of the first part in seconds, and `growth` its change in seconds a second.
    """
    ends, means = (np.empty((position.shape[0], T.size)) for _ in range(2))
    _run(np.ascontiguousarray(position), np.maximum(T, 1e-9 * part_s), closing, L / part_s, growth, part_s, ends,
         means)
    return ends, means
