"""Valves that slip at the samples of a known path, or all of them some samples earlier with a longer dead time.

In a steady limit cycle the samples of the slips are nearly all that PV tells of a valve. One that rests after each slip
and one that slides on have other stickbands for the same slips, and so has every dead time. From a slip at output u_1
to one the other way at u_2 the output moves by S: from u_1 for a valve that rests, from its turn for one that slides.
Each slip thus bounds S by two values of the output, the last one before it and the one at it. The slip jump moves no
slip of such a cycle, so that any J has such a valve.
"""

from __future__ import annotations

import numpy as np

from ...model.model import Model
from ...typing import FloatArray, IntArray

# Share of the slip jump from which a step of the stem is a slip, and values of S kept for one dead time.
_SLIP, _BANDS = 0.5, 2
SHIFTS, JUMPS = range(-8, 13), np.geomspace(0.25, 4.0, 17)
"""Samples by which all slips may come earlier, and slip jumps tried as shares of a known one."""
FURTHER_LAG = 0.25
"""First length of a further lag, as a share of the lag."""


def with_same_slips(model: Model, values: FloatArray, path: FloatArray, *, rests: bool, shifts: range,
                    jumps: FloatArray) -> FloatArray:
    """Values (d, k) of valves that slip as a stem of positions `path` (rows,) does, with every dead time and slip jump.

    `shifts` are the samples by which all slips come earlier, `jumps` the slip jumps in %. The valves stop after each
    slip where they shall rest, else they slide on. All other values are those given (d,).
    """
    slips = []
    for piece, z in zip(model.pieces, model.split(path), strict=True):
        command = piece.context.command
        steps = np.diff(z[::max(z.size // command.size, 1)])
        at = np.flatnonzero(np.abs(steps) > _SLIP * max(values[1], 1e-9))
        slips.append((command, at + 1, np.sign(steps[at])))
    found, per = [], model.step_s / model.parts
    dead, top = model.space.parameters[4], model.space.parameters[1].high
    for shift in shifts:
        moved = values[4] + shift * per
        if not dead.low <= moved <= max(dead.high, dead.low):
            continue
        bounds = [_bounds(u, at - shift, ways, rests) for u, at, ways in slips]
        lacks = [_lack(u, at - shift, ways) for u, at, ways in slips]
        for S in _most_alike(np.concatenate(bounds, axis=1)):
            lane = values[:, None].repeat(jumps.size, axis=1)
            lane[0], lane[1], lane[4] = S, np.minimum(jumps, top * S), moved
            f_s = np.maximum(0.5 * (lane[0] + lane[1]), 1e-300)
            for row, (side, lack) in zip(model.forces, lacks, strict=True):
                lane[row] = np.clip(side * (1.0 - lack / f_s), -1.0, 1.0)
            found.append(lane)
    return np.concatenate(found, axis=1) if found else values[:, None][:, :0]


def _bounds(u: FloatArray, at: IntArray, ways: FloatArray, rests: bool) -> FloatArray:
    """Least and largest S (2, k) by which slips at samples `at` follow slips the other way."""
    found = []
    for a, b, way, after in zip(at[:-1].tolist(), at[1:].tolist(), ways[:-1].tolist(), ways[1:].tolist(), strict=True):
        if way == after or a < 0 or b >= u.size:
            continue
        if not rests:
            while a + 1 < b and way * (u[a + 1] - u[a]) > 0.0:
                a += 1
        back = way * (u[a] - u[a:b + 1])
        low, high = float(back[:-1].max()), float(back[-1])
        if high > low:
            found.append((low, high))
    return np.array(found, float).reshape(-1, 2).T


def _lack(u: FloatArray, at: IntArray, ways: FloatArray) -> tuple[float, float]:
    """Direction of the first slip, and the change of the output that it takes; no change where nothing slips."""
    inside = np.flatnonzero((at > 0) & (at < u.size))
    if not inside.size:
        return 1.0, 0.0
    first, way = int(at[inside[0]]), float(ways[inside[0]])
    change = way * (u[:first + 1] - u[0])
    return way, 0.5 * float(max(change[:-1].max(), 0.0) + max(change[-1], change[:-1].max()))


def _most_alike(bounds: FloatArray) -> list[float]:
    """The values of S that most of the bounds (2, k) allow, the best first."""
    if not bounds.size:
        return []
    ends = np.unique(bounds)
    middles = 0.5 * (ends[1:] + ends[:-1])
    count = ((bounds[0] < middles[:, None]) & (middles[:, None] < bounds[1])).sum(axis=1)
    # (of stretches that as many slips allow the widest comes first)
    order = np.lexsort((-np.diff(ends), -count))
    return [float(m) for m in middles[order[:_BANDS]]]
