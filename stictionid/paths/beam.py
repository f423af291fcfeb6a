"""The likeliest slips of a valve whose break-away force is random: a beam of hypotheses weighed by PV.

Every hypothesis holds a valve: its position, whether it slides, and the largest force either way since it came to rest.
It also holds the states of the process, the error of its landing with its covariance (`numerics/noise/landing.py`), and
the last errors. The noise model turns these errors into innovations. The break-away force of every stick is drawn from
N(f_s, scatter^2). At each value of the command the valve slips with the chance that this force lies between the largest
force so far and the present one. PV weighs the hypotheses; the least likely are dropped and near ones merged. Wrong
where the number kept is too small for the time PV takes to tell them apart.

Source: docs/details.md, section 14; the beam is a particle filter without drawing (Fearnhead and Clifford 2003).
"""

from __future__ import annotations

import math

import numpy as np

from ..laws.contract import (
    CROSSES,
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
from ..numerics.noise.normal import ROOT_TWO_PI
from ..typing import BoolArray, FloatArray, IntArray

# Most hypotheses at a time, and those kept from one sample to the next within this distance in log-likelihood.
MOST, KEPT, CUT = 40, 14, 14.0
# Hypotheses are one where their responses differ by this share of the noise, positions as much in terms of PV and by
# this share of the slip jump, and the largest forces by this share of the scatter.
_RESPONSE, _POSITION, _JUMP, _FORCE = 0.2, 0.3, 0.1, 0.3
# Chances smaller than this are none.
_LEAST = 1e-6
# What a hypothesis knows of its part in a sample: it turns against the record, has slipped, or goes with the record.
_TURNED, _DONE, _SURE = 1, 2, 3
# Numbers of a hypothesis: position, heading (0 at rest), largest margins up and down, weight with those merged into it,
# node, weight of its own path alone, then the process.
_PLACE, _HEADING, _UP, _DOWN, _WEIGHT, _NODE, _OWN, _FIRST = range(8)
# Variance of a level that nothing has told yet, in that of the noise.
_DIFFUSE = 1e6
# Distance from f_s in scatters below which nothing slips.
_FAR = 6.0
# The same for a stem that has felt no force yet; it is as good as infinite.
_END = 40.0


@kernel
def beam(command: FloatArray, friction: FloatArray, profile: FloatArray, start: float, rests: bool, scatter: float,
         doubt: FloatArray, parts: int, whole: int, keep: FloatArray, take: FloatArray, row: FloatArray,
         through: float, gain: float, target: FloatArray, good: BoolArray, counted: BoolArray, taps: FloatArray,
         error_sd: float, own: float, jitter: float, node_parent: IntArray, node_at: IntArray,
         node_kind: IntArray) -> tuple[float, float, int, int]:
    """Log-likelihood of all paths, log of the share of the likeliest one, its last node, and the samples measured.

    The last is the first value of the command that nothing measured.

    `keep` (2, m, m), `take` (2, m), `row` (m,) and `through` are the process (`state_space.Held`). `gain` and `target`
    (n,) are in units of the noise, `doubt` is that of `replay.doubts`. A stem lands with the error `error_sd` of the
    command; `own` is the variance of its break-away force alone, both in % (`model/landing.py`). A slip comes early or
    late by `jitter`, a share of the time from one command to the next. A node is an event of a path (`replay.Slips`):
    its parent, sample and kind.
    """
    n, states, order = target.size, row.size, taps.size
    fs_up0, fs_down0 = friction[FS_UP] + TIE, friction[FS_DOWN] + TIE
    fd_up0, fd_down0 = friction[FD_UP], friction[FD_DOWN]
    restick = np.inf if rests else friction[RESTICK]
    spare, low, high = friction[OVERSHOOT] - 1.0, friction[LOWER], friction[UPPER]
    jump, crosses = max(fs_up0 - fd_up0, 1e-6), friction[CROSSES] > 0.0
    past = _FIRST + states
    # Errors (d,) of process and stem behind those of the past, then their covariance (d, d).
    d = states + 1 if error_sd > 0.0 else 0
    ratio2 = (gain * error_sd)**2
    off = past + order
    square = off + d
    width = square + d * d
    A, turned, along = np.zeros((d, d)), np.zeros((d, d)), np.zeros(d)
    reads = np.zeros(d)
    reads[:states], reads[states:] = row[:d], through
    x = np.zeros((MOST, width))
    x[0, _PLACE], x[0, _UP], x[0, _DOWN], x[0, _NODE] = start, -np.inf, -np.inf, -1.0
    for r in range(d - 1):
        if keep[0, r, r] * keep[1, r, r] == 1.0:
            # (only PV tells the level of an integrator)
            x[0, square + r * d + r] = _DIFFUSE
    told, ranked = np.zeros(MOST, np.int64), np.zeros(MOST, np.int64)
    stays = np.zeros(MOST, np.bool_)
    # What a step of 1 % leaves in the states if it comes early by the jitter.
    after, pulse = np.zeros(states), gain * jitter * take[1]
    for r in range(states):
        for s in range(states):
            pulse[r] += gain * jitter * keep[1, r, s] * take[0, s]
    nodes, count, total, filled, i = 0, 1, 0.0, 0, 0
    root = 1.0 / (scatter * math.sqrt(2.0))
    for k in range(n):
        for part in range(parts if k > 0 else 0):
            i = (k - 1) * parts + part - whole
            if i < 0:
                continue
            u = command[i]
            du = u - command[i - 1] if i > 0 else 0.0
            fs_add, fd_add = friction[FS_DRIFT] * profile[i], friction[FD_DRIFT] * profile[i]
            fs_up, fs_down = fs_up0 + fs_add, fs_down0 + fs_add
            to_up, to_down = u - fd_up0 - fd_add, u + fd_down0 + fd_add
            told[:] = 0
            # The process runs under the old position, then every hypothesis meets the command, and a copy of it may
            # turn or slip instead; behind the dead time's fraction the process runs under the new position.
            for half in range(2):
                for r in range(d - 1):
                    A[r, d - 1] = take[half, r]
                    for s in range(d - 1):
                        A[r, s] = keep[half, r, s]
                for r in range(max(d - 1, 0), d):
                    A[r, r] = 1.0
                for h in range(count):
                    for r in range(d):
                        along[r] = 0.0
                        for c in range(d):
                            along[r] += A[r, c] * x[h, off + c]
                            turned[r, c] = 0.0
                            for s in range(d):
                                turned[r, c] += A[r, s] * x[h, square + s * d + c]
                    for r in range(d):
                        x[h, off + r] = along[r]
                        for c in range(d):
                            value = 0.0
                            for s in range(d):
                                value += turned[r, s] * A[c, s]
                            x[h, square + r * d + c] = value
                    for s in range(states):
                        after[s] = take[half, s] * (x[h, _PLACE] - start)
                        for r in range(states):
                            after[s] += keep[half, s, r] * x[h, _FIRST + r]
                    for s in range(states):
                        x[h, _FIRST + s] = after[s]
                h = -1
                while half == 0 and h + 1 < count:
                    h += 1
                    if told[h] == _DONE:
                        continue
                    v, heading = x[h, _PLACE], x[h, _HEADING]
                    q = doubt[i] if heading != 0.0 and told[h] == 0 and count < MOST else 0.0
                    goes_on = heading != 0.0 and (
                        (du * heading > 0.0 and abs(du) >= restick) != (told[h] == _TURNED))
                    p, event, g, rising = 0.0, 0, h, False
                    if q > _LEAST:
                        # (this one first: what becomes of the copy is decided when its turn comes)
                        p, event = q, 2
                    elif not goes_on:
                        if heading != 0.0:
                            x[h, _HEADING], x[h, _UP], x[h, _DOWN] = 0.0, -np.inf, -np.inf
                        up = u - v - fs_up if v < high else -np.inf
                        down = v - u - fs_down if v > low else -np.inf
                        rising = up > down
                        new, old = (up, x[h, _UP]) if rising else (down, x[h, _DOWN])
                        if new > old and new > -_FAR * scatter:
                            alive = 0.5 * math.erfc(old * root)
                            p = 1.0 if alive < 1e-14 else 1.0 - 0.5 * math.erfc(new * root) / alive
                            p = min(max(p, 0.0), 1.0)
                        x[h, _UP], x[h, _DOWN] = max(x[h, _UP], up), max(x[h, _DOWN], down)
                        event = 1 if rising else -1
                    if p > _LEAST and (p > 1.0 - _LEAST or count < MOST):
                        if p <= 1.0 - _LEAST:
                            g = count
                            count += 1
                            for s in range(width):
                                x[g, s] = x[h, s]
                            x[h, _WEIGHT] += math.log1p(-p)
                            x[h, _OWN] += math.log1p(-p)
                        x[g, _WEIGHT] += math.log(p)
                        x[g, _OWN] += math.log(p)
                        if nodes < node_parent.size:
                            node_parent[nodes], node_at[nodes], node_kind[nodes] = int(x[g, _NODE]), i, event
                            x[g, _NODE] = nodes
                            nodes += 1
                        told[g] = _TURNED if event == 2 else _DONE
                    if abs(event) == 1 and told[g] == _DONE:
                        force = new
                        # (a stem that rests stays where a moving command crossed the likeliest force: `replay`)
                        early = force - max(min(0.0, force), old) if crosses and abs(du) < restick else 0.0
                        new = to_up - early if rising else to_down + early
                        new += spare * (new - v)
                        held = min(max(new, low), high)
                        if d > 0:
                            # The force at the slip tells of the errors at both of its ends.
                            least, most = max(old, -_END * scatter), max(force, old)
                            chance = 0.5 * (math.erfc(least * root) - math.erfc(most * root))
                            middle, spread = min(max(0.0, least), most), 0.0
                            if chance > 1e-12:
                                at_low = math.exp(-(least * root)**2) / (chance * ROOT_TWO_PI)
                                at_high = math.exp(-(most * root)**2) / (chance * ROOT_TWO_PI)
                                middle = min(max(scatter * (at_low - at_high), least), most)
                                spread = max(scatter * (scatter + least * at_low - most * at_high) - middle**2, 0.0)
                            share = error_sd**2 / (error_sd**2 + own + spread) if held == new else 0.0
                            for r in range(d):
                                x[g, square + r * d + d - 1] *= share
                                x[g, square + (d - 1) * d + r] *= share
                            x[g, off + d - 1] = share * (x[g, off + d - 1] - gain * (middle if rising else -middle))
                            x[g, square + d * d - 1] += ratio2 * (1.0 - share) if held == new else 0.0
                            for r in range(d - 1):
                                for c in range(d - 1):
                                    x[g, square + r * d + c] += (held - v)**2 * pulse[r] * pulse[c]
                        x[g, _PLACE], x[g, _UP], x[g, _DOWN] = held, -np.inf, -np.inf
                        x[g, _HEADING] = 0.0 if held != new or restick == np.inf or du == 0.0 else du / abs(du)
                    if event == 2:
                        # (its own part: it does as the command says)
                        told[h] = _SURE
                        h -= 1
                    elif goes_on:
                        new = max(to_up, v) if heading > 0.0 else min(to_down, v)
                        held = min(max(new, low), high)
                        if d > 0 and held != v:
                            for r in range(d):
                                x[h, square + r * d + d - 1] = x[h, square + (d - 1) * d + r] = 0.0
                            x[h, off + d - 1], x[h, square + d * d - 1] = 0.0, ratio2 if held == new else 0.0
                        x[h, _PLACE] = held
                        if held != new:
                            x[h, _HEADING], x[h, _UP], x[h, _DOWN] = 0.0, -np.inf, -np.inf
        if not good[k]:
            continue
        best = -np.inf
        for h in range(count):
            error = target[k] - gain * through * (x[h, _PLACE] - start)
            for s in range(states):
                error -= gain * row[s] * x[h, _FIRST + s]
            F = 1.0
            for r in range(d):
                error -= reads[r] * x[h, off + r]
                along[r] = 0.0
                for c in range(d):
                    along[r] += x[h, square + r * d + c] * reads[c]
                F += reads[r] * along[r]
            # (a start that is not known yet tells nothing of the stem)
            for r in range(d if counted[k] else 0):
                x[h, off + r] += along[r] * error / F
                for c in range(d):
                    x[h, square + r * d + c] -= along[r] * along[c] / F
            error /= math.sqrt(F)
            innovation = error
            for s in range(order):
                innovation += taps[s] * x[h, past + s]
            for s in range(order - 1, -1, -1):
                x[h, past + s] = x[h, past + s - 1] if s else error
            if counted[k] and filled >= order:
                fits = -0.5 * (innovation * innovation + math.log(F))
                x[h, _WEIGHT] += fits
                x[h, _OWN] += fits
            best = max(best, x[h, _WEIGHT])
        filled += 1
        # The best ones stay; one that is nearly the same as a better one is added to it.
        for h in range(count):
            at = h
            while at > 0 and x[ranked[at - 1], _WEIGHT] < x[h, _WEIGHT]:
                ranked[at] = ranked[at - 1]
                at -= 1
            ranked[at] = h
            stays[h] = False
        kept = 0
        for q in range(count):
            h = ranked[q]
            if x[h, _WEIGHT] < best - CUT or kept >= KEPT:
                break
            alone = True
            for r in range(kept):
                g = ranked[r]
                apart = 0.0
                for s in range(states):
                    apart += gain * row[s] * (x[g, _FIRST + s] - x[h, _FIRST + s])
                for s in range(d - 1):
                    apart += row[s] * (x[g, off + s] - x[h, off + s])
                away = abs(x[g, _PLACE] - x[h, _PLACE])
                beside = gain * (x[g, _PLACE] - x[h, _PLACE])
                if d > 0:
                    beside += x[g, off + d - 1] - x[h, off + d - 1]
                differ = (abs(x[g, _UP] - x[h, _UP]) > _FORCE * scatter
                          or abs(x[g, _DOWN] - x[h, _DOWN]) > _FORCE * scatter)
                if x[g, _HEADING] == x[h, _HEADING] and abs(beside) <= _POSITION and away <= _JUMP * jump \
                        and not differ and abs(apart) < _RESPONSE:
                    x[g, _WEIGHT] += math.log1p(math.exp(x[h, _WEIGHT] - x[g, _WEIGHT]))
                    alone = False
                    break
            if alone:
                ranked[kept] = h
                stays[h] = True
                kept += 1
        q, sum_of = 0, 0.0
        for h in range(count):
            if stays[h]:
                for s in range(width if h != q else 0):
                    x[q, s] = x[h, s]
                sum_of += math.exp(x[q, _WEIGHT] - best)
                q += 1
        count = kept
        shift = best + math.log(sum_of)
        total += shift
        for h in range(count):
            x[h, _WEIGHT] -= shift
            x[h, _OWN] -= shift
    last = 0
    for h in range(count):
        if x[h, _WEIGHT] > x[last, _WEIGHT]:
            last = h
    return total, x[last, _OWN], int(x[last, _NODE]), i + 1
