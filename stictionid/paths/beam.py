"""The likeliest slips of a valve whose break-away force is random: a beam of hypotheses weighed by PV.

Every hypothesis is a valve (position, sliding or at rest, largest force either way since it came to rest), the states
of the process that it drives, and the last errors, which the noise model turns into innovations. At each value of the
command it slips with the chance that the break-away force, drawn anew for every stick from N(f_s, scatter^2), lies
between the largest force so far and this one. PV weighs the hypotheses; the least likely are dropped and near ones
merged. Wrong where the number kept is too small for the time PV takes to tell them apart.

Source: docs/method.md, section 14; the beam is a particle filter without drawing (Fearnhead and Clifford 2003).
"""

from __future__ import annotations

import math

import numpy as np

from ..laws.contract import (
    FD_DOWN,
    FD_DRIFT,
    FD_UP,
    FS_DOWN,
    FS_DRIFT,
    FS_UP,
    LOWER,
    OVERSHOOT,
    RESTICK,
    TIE,
    UPPER,
)
from ..numerics.jit import kernel
from ..typing import BoolArray, FloatArray, IntArray

# Most hypotheses at a time, and those kept from one sample to the next within this distance in log-likelihood.
MOST, KEPT, CUT = 40, 14, 14.0
# Hypotheses are one where their responses differ by this share of the noise, positions as much in terms of PV and by
# this share of the slip jump, and the largest forces by this share of the scatter.
_RESPONSE, _POSITION, _JUMP, _FORCE = 0.2, 0.3, 0.1, 0.3
# Chances smaller than this are none.
_LEAST = 1e-6
# What a copy knows of its part in a sample: it turned against the record, or it has slipped.
_TURNED, _DONE = 1, 2


@kernel
def beam(command: FloatArray, friction: FloatArray, profile: FloatArray, start: float, rests: bool, scatter: float,
         doubt: FloatArray, parts: int, whole: int, keep: FloatArray, take: FloatArray, row: FloatArray,
         through: float, gain: float, target: FloatArray, good: BoolArray, counted: BoolArray, taps: FloatArray,
         node_parent: IntArray, node_at: IntArray, node_kind: IntArray) -> tuple[float, int, int]:
    """Log-likelihood, the last node of the likeliest path, and the first value of the command that nothing measured.

    `keep` (2, m, m), `take` (2, m), `row` (m,) and `through` are the process (`state_space.Held`). `gain` and `target`
    (n,) are in units of the noise, `doubt` is that of `replay.doubts`. A node is an event of a path (`replay.Slips`):
    its parent, sample and kind.
    """
    n, states, order = target.size, row.size, taps.size
    fs_up0, fs_down0 = friction[FS_UP] + TIE, friction[FS_DOWN] + TIE
    fd_up0, fd_down0 = friction[FD_UP], friction[FD_DOWN]
    restick = np.inf if rests else friction[RESTICK]
    spare, low, high = friction[OVERSHOOT] - 1.0, friction[LOWER], friction[UPPER]
    jump = max(fs_up0 - fd_up0, 1e-6)
    v = np.zeros(MOST)
    moves = np.zeros(MOST, np.bool_)
    heading = np.zeros(MOST)
    told = np.zeros(MOST, np.int64)
    a = np.full(MOST, -np.inf)
    c = np.full(MOST, -np.inf)
    weight = np.zeros(MOST)
    z = np.zeros((MOST, states))
    after = np.zeros(states)
    past = np.zeros((MOST, max(order, 1)))
    node = np.zeros(MOST, np.int64)
    ranked, best_first = np.zeros(MOST, np.int64), np.zeros(MOST, np.int64)
    stays = np.zeros(MOST, np.bool_)
    v[0] = start
    node[0] = -1
    nodes, count, total, filled, i = 0, 1, 0.0, 0, 0
    size = abs(gain)
    root = 1.0 / (scatter * math.sqrt(2.0))
    for k in range(n):
        if k > 0:
            for part in range(parts):
                i = (k - 1) * parts + part - whole
                if i < 0:
                    continue
                u = command[i]
                du = u - command[i - 1] if i > 0 else 0.0
                drift = profile[i]
                fs_up, fs_down = fs_up0 + friction[FS_DRIFT] * drift, fs_down0 + friction[FS_DRIFT] * drift
                to_up, to_down = u - (fd_up0 + friction[FD_DRIFT] * drift), u + (fd_down0 + friction[FD_DRIFT] * drift)
                q = doubt[i]
                for h in range(count):
                    told[h] = 0
                    for s in range(states):
                        after[s] = take[0, s] * (v[h] - start)
                        for r in range(states):
                            after[s] += keep[0, s, r] * z[h, r]
                    z[h] = after
                h = -1
                while h + 1 < count:
                    h += 1
                    if told[h] == _DONE:
                        continue
                    if moves[h]:
                        goes_on = du * heading[h] > 0.0 and abs(du) >= restick
                        if told[h] == _TURNED:
                            goes_on = not goes_on
                        elif q > _LEAST and count < MOST:
                            g = count
                            count += 1
                            for s in range(states):
                                z[g, s] = z[h, s]
                            for s in range(order):
                                past[g, s] = past[h, s]
                            v[g], heading[g], moves[g], a[g], c[g] = v[h], heading[h], True, -np.inf, -np.inf
                            weight[g] = weight[h] + math.log(q)
                            weight[h] += math.log1p(-q)
                            node[g] = node[h]
                            if nodes < node_parent.size:
                                node_parent[nodes], node_at[nodes], node_kind[nodes] = node[h], i, 2
                                node[g] = nodes
                                nodes += 1
                            told[g] = _TURNED
                        if goes_on:
                            new = max(to_up, v[h]) if heading[h] > 0.0 else min(to_down, v[h])
                            v[h] = min(max(new, low), high)
                            if v[h] != new:
                                moves[h] = False
                                a[h], c[h] = -np.inf, -np.inf
                            continue
                        moves[h] = False
                        a[h], c[h] = -np.inf, -np.inf
                    up = u - v[h] - fs_up if v[h] < high else -np.inf
                    down = v[h] - u - fs_down if v[h] > low else -np.inf
                    rising = up > down
                    new_max = up if rising else down
                    old_max = a[h] if rising else c[h]
                    p = 0.0
                    if new_max > old_max and new_max > -6.0 * scatter:
                        alive = 0.5 * math.erfc(old_max * root)
                        p = 1.0 if alive < 1e-14 else 1.0 - 0.5 * math.erfc(new_max * root) / alive
                        p = min(max(p, 0.0), 1.0)
                    a[h], c[h] = max(a[h], up), max(c[h], down)
                    if p <= _LEAST or (p <= 1.0 - _LEAST and count >= MOST):
                        continue
                    g = h
                    if p <= 1.0 - _LEAST:
                        g = count
                        count += 1
                        for s in range(states):
                            z[g, s] = z[h, s]
                        for s in range(order):
                            past[g, s] = past[h, s]
                        v[g], weight[g], node[g] = v[h], weight[h], node[h]
                        weight[h] += math.log1p(-p)
                        told[g] = _DONE
                    weight[g] += math.log(p)
                    new = to_up + spare * (to_up - v[g]) if rising else to_down + spare * (to_down - v[g])
                    v[g] = min(max(new, low), high)
                    moves[g] = v[g] == new and restick < np.inf
                    heading[g] = 1.0 if du > 0.0 else -1.0 if du < 0.0 else 0.0
                    a[g], c[g] = -np.inf, -np.inf
                    if nodes < node_parent.size:
                        node_parent[nodes], node_at[nodes], node_kind[nodes] = node[g], i, 1 if rising else -1
                        node[g] = nodes
                        nodes += 1
                for h in range(count):
                    for s in range(states):
                        after[s] = take[1, s] * (v[h] - start)
                        for r in range(states):
                            after[s] += keep[1, s, r] * z[h, r]
                    z[h] = after
        if not good[k]:
            continue
        best = -np.inf
        for h in range(count):
            error = target[k] - gain * through * (v[h] - start)
            for s in range(states):
                error -= gain * row[s] * z[h, s]
            innovation = error
            for s in range(order):
                innovation += taps[s] * past[h, s]
            for s in range(order - 1, 0, -1):
                past[h, s] = past[h, s - 1]
            if order:
                past[h, 0] = error
            if counted[k] and filled >= order:
                weight[h] -= 0.5 * innovation * innovation
            best = max(best, weight[h])
        filled += 1
        if count == 1:
            total += weight[0]
            weight[0] = 0.0
            continue
        # The best ones stay; one that is nearly the same as a better one is added to it.
        for h in range(count):
            at = h
            while at > 0 and weight[best_first[at - 1]] < weight[h]:
                best_first[at] = best_first[at - 1]
                at -= 1
            best_first[at] = h
        kept = 0
        for q in range(count):
            h = best_first[q]
            if weight[h] < best - CUT or kept >= KEPT:
                break
            alone = True
            for r in range(kept):
                g = ranked[r]
                if moves[g] != moves[h] or abs(v[g] - v[h]) * size > _POSITION or abs(v[g] - v[h]) > _JUMP * jump:
                    continue
                if abs(a[g] - a[h]) > _FORCE * scatter or abs(c[g] - c[h]) > _FORCE * scatter:
                    continue
                apart = 0.0
                for s in range(states):
                    apart += row[s] * (z[g, s] - z[h, s])
                if abs(apart) * size < _RESPONSE:
                    weight[g] += math.log1p(math.exp(weight[h] - weight[g]))
                    alone = False
                    break
            if alone:
                ranked[kept] = h
                kept += 1
        for h in range(count):
            stays[h] = False
        for q in range(kept):
            stays[ranked[q]] = True
        q = -1
        for h in range(count):
            if not stays[h]:
                continue
            q += 1
            if h != q:
                v[q], moves[q], a[q], c[q], weight[q], node[q] = v[h], moves[h], a[h], c[h], weight[h], node[h]
                heading[q] = heading[h]
                for s in range(states):
                    z[q, s] = z[h, s]
                for s in range(order):
                    past[q, s] = past[h, s]
        count = kept
        best, sum_of = -np.inf, 0.0
        for h in range(count):
            best = max(best, weight[h])
        for h in range(count):
            sum_of += math.exp(weight[h] - best)
        shift = best + math.log(sum_of)
        total += shift
        for h in range(count):
            weight[h] -= shift
    last = 0
    for h in range(count):
        if weight[h] > weight[last]:
            last = h
    return total, node[last], i + 1
