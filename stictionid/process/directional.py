"""First-order lag whose time constant depends on direction, behind a dead time that may drift, for a held position.

    T x' = u(t - L(t)) - x,   T = T1 where x rises, closing * T1 where it falls,   L(t) = L (1 + drift t) >= 0.

A process that is heated actively and cools by itself is of the first kind, a pipe whose flow fades of the second. The
lag is exact. A dead time that drifts is taken at the middle of each part of a sample, within which it moves by a few
percent of the part at most. Everything behind the lag is linear and runs as without it, on the mean of x over each
part.
"""

from __future__ import annotations

import numpy as np

from ..numerics.jit import LANES, LINE, kernel, scratch
from ..typing import FloatArray

# Rows of the working table: time constants, decays over a whole part, over the stretch before a new input arrives and
# over the rest, the length of the former, then first position, state, new input, and the one before.
(_RISING, _FALLING, _WHOLE_RISING, _WHOLE_FALLING, _FIRST_RISING, _FIRST_FALLING, _REST_RISING, _REST_FALLING, _EARLY,
 _START, _X, _NOW, _BEFORE) = range(13)
_ROWS = 13


@kernel
def _run(position: FloatArray, T: FloatArray, closing: FloatArray, delay: FloatArray, growth: FloatArray,
         part_s: float, ends: FloatArray, means: FloatArray) -> None:
    """Fill ends and means (rows, P) of x over each part; a dead time is `delay` parts and grows by `growth` a part."""
    rows, lanes = ends.shape
    shared = position.shape[1] < lanes
    work = np.empty(_ROWS * LANES + LINE)
    work = work[-(work.ctypes.data // 8) % LINE:]
    whole = np.empty(LANES, np.int64)
    for first in range(0, lanes, LANES):
        width, stays = min(LANES, lanes - first), True
        for p in range(width):
            q = first + p
            work[_START * LANES + p], work[_X * LANES + p] = position[0, 0 if shared else q], 0.0
            work[_RISING * LANES + p], work[_FALLING * LANES + p] = T[q], closing[q] * T[q]
            work[_WHOLE_RISING * LANES + p] = np.exp(-part_s / T[q])
            work[_WHOLE_FALLING * LANES + p] = np.exp(-part_s / (closing[q] * T[q]))
            stays &= growth[q] == 0.0
        for k in range(rows):
            # The input of the part before lasts until the new one arrives. Dead times that stay have the decays of both
            # stretches once for all parts.
            fresh = k == 0 or not stays
            for p in range(width if fresh else 0):
                late = delay[first + p] + growth[first + p] * k
                late = late if late > 0.0 else 0.0
                begun = np.floor(late + 1e-12)
                early = late - begun
                whole[p] = np.int64(begun)
                work[_EARLY * LANES + p] = (early if early > 0.0 else 0.0) * part_s
            for p in range(width):
                q = 0 if shared else first + p
                work[_NOW * LANES + p] = position[max(k - whole[p], 0), q] - work[_START * LANES + p]
                work[_BEFORE * LANES + p] = position[max(k - whole[p] - 1, 0), q] - work[_START * LANES + p]
            for p in range(width if fresh else 0):
                if k == 0 or work[_NOW * LANES + p] != work[_BEFORE * LANES + p]:
                    early, rest = work[_EARLY * LANES + p], part_s - work[_EARLY * LANES + p]
                    rising, falling = work[_RISING * LANES + p], work[_FALLING * LANES + p]
                    work[_FIRST_RISING * LANES + p] = one = np.exp(-early / rising)
                    work[_REST_RISING * LANES + p] = two = np.exp(-rest / rising)
                    both = rising == falling
                    work[_FIRST_FALLING * LANES + p] = one if both else np.exp(-early / falling)
                    work[_REST_FALLING * LANES + p] = two if both else np.exp(-rest / falling)
            end, mean = ends[k, first:first + width], means[k, first:first + width]
            for p in range(width):
                x, old, new = work[_X * LANES + p], work[_BEFORE * LANES + p], work[_NOW * LANES + p]
                rising, falling, early = work[_RISING * LANES + p], work[_FALLING * LANES + p], work[_EARLY * LANES + p]
                f_rising, f_falling = work[_FIRST_RISING * LANES + p], work[_FIRST_FALLING * LANES + p]
                r_rising, r_falling = work[_REST_RISING * LANES + p], work[_REST_FALLING * LANES + p]
                w_rising, w_falling = work[_WHOLE_RISING * LANES + p], work[_WHOLE_FALLING * LANES + p]
                moves, falls = old != new, old < x
                moved = (x - old) * (1.0 - (f_falling if falls else f_rising))
                total = old * early + moved * (falling if falls else rising)
                total = total if moves else 0.0
                rest = part_s - early if moves else part_s
                x = x - moved if moves else x
                falls = new < x
                decay = r_falling if falls else r_rising
                decay = decay if moves else w_falling if falls else w_rising
                last = new + (x - new) * decay
                work[_X * LANES + p] = last
                end[p] = last
                mean[p] = (total + (new * rest + (x - last) * (falling if falls else rising))) / part_s


def directional_lag(position: FloatArray, T: FloatArray, L: FloatArray, closing: FloatArray, growth: FloatArray,
                    part_s: float) -> tuple[FloatArray, FloatArray]:
    """Ends and means (rows, P) over each part of the lag's response to positions (rows, P or 1) held over parts.

    `L` is the dead time at the middle of the first part in seconds, and `growth` its change in seconds a second. Both
    arrays hold until the next call (see `scratch` in numerics/jit.py).
    """
    ends, means = (scratch(name, position.shape[0], T.size) for name in ("ends", "means"))
    _run(np.ascontiguousarray(position), np.maximum(T, 1e-9 * part_s), closing, L / part_s, growth, part_s, ends,
         means)
    return ends, means
