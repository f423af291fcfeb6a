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
    for p in range(lanes):
        q = 0 if shared else p
        start, stays = position[0, q], growth[p] == 0.0
        rising, falling = T[p], closing[p] * T[p]
        keep_rising, keep_falling = np.exp(-part_s / rising), np.exp(-part_s / falling)
        late = max(delay[p], 0.0)
        whole = int(late + 1e-12)
        # The input of the part before lasts until the new one arrives; a dead time that stays has the decays of both
        # stretches once for all parts.
        early = max(late - whole, 0.0) * part_s
        first_rising, first_falling = np.exp(-early / rising), np.exp(-early / falling)
        rest_rising, rest_falling = np.exp(-(part_s - early) / rising), np.exp(-(part_s - early) / falling)
        x = 0.0
        for k in range(rows):
            if not stays:
                late = max(delay[p] + growth[p] * k, 0.0)
                whole = int(late + 1e-12)
                early = max(late - whole, 0.0) * part_s
            now = position[max(k - whole, 0), q] - start
            before = position[max(k - whole - 1, 0), q] - start
            total, rest = 0.0, part_s
            if before != now:
                rest = part_s - early
                falls = before < x
                t = falling if falls else rising
                decay = (first_falling if falls else first_rising) if stays else np.exp(-early / t)
                moved = (x - before) * (1.0 - decay)
                total = before * early + moved * t
                x -= moved
            falls = now < x
            t = falling if falls else rising
            if before == now:
                decay = keep_falling if falls else keep_rising
            else:
                decay = (rest_falling if falls else rest_rising) if stays else np.exp(-rest / t)
            last = now + (x - now) * decay
            total += now * rest + (x - last) * t
            x = last
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
