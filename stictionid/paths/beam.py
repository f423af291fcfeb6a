"""The likeliest slips of a valve whose break-away force is random: a beam of hypotheses weighed by PV.

Every hypothesis holds a valve: its position, whether it slides, and the largest force either way since it came to rest.
It also holds the states of the process, the error of its landing with its covariance (`numerics/noise/landing.py`), and
the last errors. The noise model turns these errors into innovations. The break-away force of every stick is drawn from
N(f_s, scatter^2). At each value of the command the valve slips with the chance that this force lies between the largest
force so far and the present one, or with that of `model/unseen_scans.py`. PV weighs the hypotheses; the least likely
are dropped and near ones merged. Wrong where the number kept is too small for the time PV takes to tell them apart.

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
from ..model.unseen_scans import FAR, LEAST_LEFT, ROOT_HALF
from ..numerics.jit import FULL, kernel
from ..numerics.noise.normal import ROOT_TWO_PI
from ..typing import BoolArray, FloatArray, IntArray

# Hypotheses at a time for each that is kept from one sample to the next, and their distance in log-likelihood at most.
_SPLITS, CUT = 3, 14.0
# Hypotheses are one where their responses differ by this share of the noise, positions as much in terms of PV and by
# this share of the slip jump, and the largest forces by this share of the scatter; by scan, positions by no more than
# this share of the error of the command, because an integrator adds up what they differ by.
_RESPONSE, _POSITION, _JUMP, _FORCE, _LANDS = 0.2, 0.3, 0.1, 0.3, 0.5
# Smaller chances are none. Where PV shows one command in several they would take the room of likelier ones: with 1e-6
# the paths at the true values of 27 slow exports were less likely in 14, likelier in 6, and took 28 % more time.
_NONE, _UNSEEN = 1e-6, 1e-3
# What a hypothesis knows of its part in a sample: it turns against the record, has slipped, or goes with the record.
_TURNED, _DONE, _SURE = 1, 2, 3
# Numbers of a hypothesis: position, heading (0 at rest), largest margins up and down, weight with those merged into it,
# node, weight of its own path alone; then, by scan, variances of its forces up and down, whose means are in place of
# the margins, and of its landing; then the process.
_PLACE, _HEADING, _UP, _DOWN, _WEIGHT, _NODE, _OWN, _WIDE_UP, _WIDE_DOWN, _LANDED, _FIRST = range(11)
# Those of a process with two states: the second one, the errors, and their covariance row by row.
_TWO, _E0, _E1, _E2, _P00, _P01, _P02, _P10, _P11, _P12, _, _, _P22 = range(_FIRST + 1, _FIRST + 14)
# Variance of a level that nothing has told yet, in that of the noise.
_DIFFUSE = 1e6
# Distance from f_s in scatters below which nothing slips.
_FAR = 6.0
# The same for a stem that has felt no force yet; it is as good as infinite.
_END = 40.0


@kernel
def beam(command: FloatArray, friction: FloatArray, profile: FloatArray, start: float, rests: bool, scatter: float,
         doubt: FloatArray, parts: int, whole: int, hold: FloatArray, feed: FloatArray, row: FloatArray,
         through: float, gain: float, target: FloatArray, good: BoolArray, counted: BoolArray, taps: FloatArray,
         error_sd: float, own: float, by_scan: FloatArray, jitter: float, late: FloatArray, kept_most: int,
         node_parent: IntArray, node_at: IntArray, node_kind: IntArray) -> tuple[float, float, int, int]:
    """Log-likelihood of all paths, log of the share of the likeliest one, its last node, first command not measured.

    `hold`, `feed`, `row` and `through` are the process (`state_space.Held.over`). `gain` and `target` (n,) are in units
    of the noise, `doubt` is that of `replay.doubts`. A stem lands with the error `error_sd` of the command; `own` is
    the variance of its break-away force alone, both in % (`model/landing.py`). Variances `by_scan` (commands,) are
    those of a command that errs at every scan by itself, else there are none. A slip comes early or late by `jitter`,
    a share of the time from one command to the next, and every move also by `late` (commands,). At most `kept_most`
    hypotheses go on to the next sample. A node is an event of a path (`slips.Slips`): its parent, sample and kind.
    """
    n, order, states = target.size, taps.size, row.size
    # (two states have rows at known places, so that loops run in vectors)
    few = states == 2
    fs_up0, fs_down0 = friction[FS_UP] + TIE, friction[FS_DOWN] + TIE
    fd_up0, fd_down0 = friction[FD_UP], friction[FD_DOWN]
    restick = np.inf if rests else friction[RESTICK]
    spare, low, high = friction[OVERSHOOT] - 1.0, friction[LOWER], friction[UPPER]
    jump, crosses = max(fs_up0 - fd_up0, 1e-6), friction[CROSSES] > 0.0
    # Errors (d,) of process and stem behind the states, then their covariance (d, d), then errors of the past.
    d = states + 1 if error_sd > 0.0 else 0
    off = _FIRST + states
    square = off + d
    past = square + d * d
    width, m = past + order, max(d - 1, 0)
    room = (_SPLITS * kept_most + FULL - 1) // FULL * FULL
    A, turned, along, after = np.zeros((d, d)), np.zeros((d * d, room)), np.zeros((d, room)), np.zeros((states, room))
    # (numba compiles every further kind of array, and slices on the left, for up to a second each)
    rows = np.zeros((3, off))
    reads, seen, pulse = rows[0], rows[1], rows[2]
    for s in range(states):
        # (the last is what a step of 1 % leaves in the states if it comes a command early)
        reads[s], seen[s], pulse[s] = row[s], gain * row[s], gain * feed[2, s]
    reads[states] = through
    # A row for each number of the hypotheses: the arithmetic that is the same for all of them runs in vectors.
    x = np.zeros((width, room))
    flat, each = x.reshape(x.size), by_scan.size > 0
    places, weights, owns = x[_PLACE], x[_WEIGHT], x[_OWN]
    unfelt, error2, unlike = (0.0, 0.0, math.sqrt(own + error_sd**2)) if each else (-np.inf, error_sd**2, scatter)
    same_place = min(_JUMP * jump, _LANDS * error_sd if each else np.inf)
    x[_PLACE, 0], x[_UP, 0], x[_DOWN, 0], x[_NODE, 0] = start, unfelt, unfelt, -1.0
    x[_WIDE_UP, 0] = x[_WIDE_DOWN, 0] = own
    for r in range(m):
        if hold[0, r, r] * hold[1, r, r] == 1.0:
            # (only PV tells the level of an integrator)
            x[square + r * d + r, 0] = _DIFFUSE
    marks, numbers, among = np.zeros((4, room), np.int64), np.zeros((6, room)), np.zeros(6 * room)
    told, ranked, stays, alike = marks[0], marks[1], marks[2], marks[3]
    errors, spreads, innovations, calm = numbers[0], numbers[1], numbers[2], numbers[3]
    beside, answers = numbers[4], numbers[5]
    nodes, count, total, filled, i, waits = 0, 1, 0.0, 0, 0, 0
    root, least_force, rare = 1.0 / (scatter * math.sqrt(2.0)), -_FAR * scatter, _NONE if parts == 1 else _UNSEEN
    for k in range(n):
        for part in range(parts + 1 if k > 0 else 0):
            measures = part == parts
            i = (k - 1) * parts + min(part, parts - 1) - whole
            if i < 0:
                continue
            u = command[i]
            du = u - command[i - 1] if i > 0 else 0.0
            error2 = by_scan[i] if each else error2
            fs_add, fd_add = friction[FS_DRIFT] * profile[i], friction[FD_DRIFT] * profile[i]
            fs_up, fs_down = fs_up0 + fs_add, fs_down0 + fs_add
            to_up, to_down = u - fd_up0 - fd_add, u + fd_down0 + fd_add
            # A stem that rests far from f_s, as most do, only feels its force. (No force depends on the process.)
            for h in range(0 if measures else (count + FULL - 1) // FULL * FULL):
                v, most_up, most_down = flat[_PLACE * room + h], flat[_UP * room + h], flat[_DOWN * room + h]
                up, down = u - v - fs_up, v - u - fs_down
                up, down = up if v < high else -np.inf, down if v > low else -np.inf
                rising = up > down
                new, old = up if rising else down, most_up if rising else most_down
                quiet = (new <= old) | (new <= least_force)
                if each:
                    wide = flat[_WIDE_UP * room + h] if rising else flat[_WIDE_DOWN * room + h]
                    quiet = new - old <= FAR * math.sqrt(wide + error2)
                quiet &= flat[_HEADING * room + h] == 0.0
                flat[_UP * room + h] = up if quiet & (up > most_up) & (not each) else most_up
                flat[_DOWN * room + h] = down if quiet & (down > most_down) & (not each) else most_down
                calm[h] = 1.0 if quiet else 0.0
            busy = 1.0 if measures else 0.0
            for h in range(0 if measures else count):
                busy += 1.0 - calm[h]
            if busy == 0.0:
                waits += 1
                continue
            told[:] = 0
            # The process runs under the old position, then every hypothesis meets the command, and a copy of it may
            # turn or slip instead; behind the dead time's fraction the process runs under the new position. While no
            # stem may move, the process waits until it is measured.
            for half in range(-1 if waits > 0 else 0, 0 if measures else 2):
                step = half if half >= 0 else 1 + waits
                if few:
                    k00, k01, k10, k11 = hold[step, 0, 0], hold[step, 0, 1], hold[step, 1, 0], hold[step, 1, 1]
                    f0, f1 = feed[step, 0], feed[step, 1]
                    full = (count + FULL - 1) // FULL * FULL
                    for h in range(full):
                        moved, y, z = flat[_PLACE * room + h] - start, flat[_FIRST * room + h], flat[_TWO * room + h]
                        flat[_FIRST * room + h] = (f0 * moved + k00 * y) + k01 * z
                        flat[_TWO * room + h] = (f1 * moved + k10 * y) + k11 * z
                    # (the last row of the covariance is its last column; the error of the stem stays as it is)
                    for h in range(full if d > 0 else 0):
                        y, z, w = flat[_E0 * room + h], flat[_E1 * room + h], flat[_E2 * room + h]
                        p00, p01, p02 = flat[_P00 * room + h], flat[_P01 * room + h], flat[_P02 * room + h]
                        p10, p11, p12 = flat[_P10 * room + h], flat[_P11 * room + h], flat[_P12 * room + h]
                        p22 = flat[_P22 * room + h]
                        t00, t01 = (k00 * p00 + k01 * p10) + f0 * p02, (k00 * p01 + k01 * p11) + f0 * p12
                        t10, t11 = (k10 * p00 + k11 * p10) + f1 * p02, (k10 * p01 + k11 * p11) + f1 * p12
                        t02, t12 = (k00 * p02 + k01 * p12) + f0 * p22, (k10 * p02 + k11 * p12) + f1 * p22
                        flat[_E0 * room + h] = (k00 * y + k01 * z) + f0 * w
                        flat[_E1 * room + h] = (k10 * y + k11 * z) + f1 * w
                        flat[_P00 * room + h] = (t00 * k00 + t01 * k01) + t02 * f0
                        flat[_P01 * room + h] = (t00 * k10 + t01 * k11) + t02 * f1
                        flat[_P02 * room + h] = t02
                        flat[_P10 * room + h] = (t10 * k00 + t11 * k01) + t12 * f0
                        flat[_P11 * room + h] = (t10 * k10 + t11 * k11) + t12 * f1
                        flat[_P12 * room + h] = t12
                else:
                    for r in range(m):
                        A[r, m] = feed[step, r]
                        for c in range(m):
                            A[r, c] = hold[step, r, c]
                    for r in range(m):
                        for s in range(d):
                            a, one, sink, first = A[r, s], x[off + s], along[r], s == 0
                            for h in range(count):
                                sink[h] = (0.0 if first else sink[h]) + a * one[h]
                        for c in range(d):
                            sink = turned[r * d + c]
                            for s in range(d):
                                a, one, first = A[r, s], x[square + (s * d + c if s < m else c * d + m)], s == 0
                                for h in range(count):
                                    sink[h] = (0.0 if first else sink[h]) + a * one[h]
                    for r in range(m):
                        one, sink = along[r], x[off + r]
                        for h in range(count):
                            sink[h] = one[h]
                        for c in range(m):
                            sink = x[square + r * d + c]
                            for s in range(d):
                                a, one, first = A[c, s], turned[r * d + s], s == 0
                                for h in range(count):
                                    sink[h] = (0.0 if first else sink[h]) + one[h] * a
                        one, sink = turned[r * d + m], x[square + r * d + m]
                        for h in range(count):
                            sink[h] = one[h]
                    for s in range(states):
                        a, sink = feed[step, s], after[s]
                        for h in range(count):
                            sink[h] = a * (places[h] - start)
                        for r in range(states):
                            b, one = hold[step, s, r], x[_FIRST + r]
                            for h in range(count):
                                sink[h] += b * one[h]
                    for s in range(states):
                        one, sink = after[s], x[_FIRST + s]
                        for h in range(count):
                            sink[h] = one[h]
                h = -1
                while half == 0 and h + 1 < count:
                    h += 1
                    if told[h] == _DONE or calm[h] == 1.0:
                        continue
                    v, heading = x[_PLACE, h], x[_HEADING, h]
                    q = doubt[i] if heading != 0.0 and told[h] == 0 and count < room else 0.0
                    goes_on = heading != 0.0 and (
                        (du * heading > 0.0 and abs(du) >= restick) != (told[h] == _TURNED))
                    p, event, g, rising = 0.0, 0, h, False
                    z, w, wide, new, old = 0.0, 1.0, own, 0.0, 0.0
                    if q > rare:
                        # (this one first: what becomes of the copy is decided when its turn comes)
                        p, event = q, 2
                    elif not goes_on:
                        if heading != 0.0:
                            x[_HEADING, h], x[_UP, h], x[_DOWN, h] = 0.0, unfelt, unfelt
                            x[_WIDE_UP, h] = x[_WIDE_DOWN, h] = own + x[_LANDED, h]
                        up = u - v - fs_up if v < high else -np.inf
                        down = v - u - fs_down if v > low else -np.inf
                        rising = up > down
                        new, old = (up, x[_UP, h]) if rising else (down, x[_DOWN, h])
                        if each:
                            wide = x[_WIDE_UP, h] if rising else x[_WIDE_DOWN, h]
                            w = math.sqrt(wide + error2)
                            z = (new - old) / w
                            p = 0.5 * math.erfc(-z * ROOT_HALF) if z > FAR else 0.0
                        elif new > old and new > least_force:
                            alive = 0.5 * math.erfc(old * root)
                            p = 1.0 if alive < 1e-14 else 1.0 - 0.5 * math.erfc(new * root) / alive
                            p = min(max(p, 0.0), 1.0)
                        if not each:
                            x[_UP, h], x[_DOWN, h] = max(x[_UP, h], up), max(x[_DOWN, h], down)
                        event = 1 if rising else -1
                    splits = p > rare and (p > 1.0 - rare or count < room)
                    if splits and p <= 1.0 - rare:
                        g = count
                        count += 1
                        calm[g] = 0.0
                        for s in range(width):
                            x[s, g] = x[s, h]
                    if g != h or (each and not splits and p > 0.0):
                        weights[h], owns[h] = weights[h] + math.log1p(-p), owns[h] + math.log1p(-p)
                        if each and event != 2:
                            # (one that stays tells of its force)
                            steep = math.exp(-0.5 * z * z) / ((1.0 - p) * ROOT_TWO_PI)
                            left = max(1.0 - wide / (wide + error2) * steep * (steep - z), LEAST_LEFT)
                            x[_UP if rising else _DOWN, h] = old + wide / w * steep
                            x[_WIDE_UP if rising else _WIDE_DOWN, h] = max(wide * left, LEAST_LEFT * own)
                    if splits:
                        weights[g], owns[g] = weights[g] + math.log(p), owns[g] + math.log(p)
                        if nodes < node_parent.size:
                            node_parent[nodes], node_at[nodes], node_kind[nodes] = int(x[_NODE, g]), i, event
                            x[_NODE, g] = nodes
                            nodes += 1
                        told[g] = _TURNED if event == 2 else _DONE
                    if abs(event) == 1 and told[g] == _DONE:
                        force = new
                        # (a stem that rests stays where a moving command crossed the likeliest force: `replay`)
                        early = force - max(min(0.0, force), old) if crosses and abs(du) < restick else 0.0
                        share, middle, spread = 0.0, 0.0, 0.0
                        if each:
                            steep = math.exp(-0.5 * z * z) / (max(p, 1e-300) * ROOT_TWO_PI)
                            share, early = error2 / (wide + error2) * steep * (steep + z), -error2 / w * steep
                        new = to_up - early if rising else to_down + early
                        new += spare * (new - v)
                        held = min(max(new, low), high)
                        if d > 0 and not each:
                            # The force at the slip tells of the errors at both of its ends.
                            least, most = max(old, -_END * scatter), max(force, old)
                            chance = 0.5 * (math.erfc(least * root) - math.erfc(most * root))
                            middle = min(max(0.0, least), most)
                            if chance > 1e-12:
                                at_low = math.exp(-(least * root)**2) / (chance * ROOT_TWO_PI)
                                at_high = math.exp(-(most * root)**2) / (chance * ROOT_TWO_PI)
                                middle = min(max(scatter * (at_low - at_high), least), most)
                                spread = max(scatter * (scatter + least * at_low - most * at_high) - middle**2, 0.0)
                            share = error2 / (error2 + own + spread)
                        share, x[_LANDED, g] = (share, error2 * (1.0 - share)) if held == new else (0.0, 0.0)
                        if d > 0:
                            for r in range(m):
                                x[square + r * d + m, g] *= share
                            x[off + m, g] = share * (x[off + m, g] - gain * (middle if rising else -middle))
                            x[past - 1, g] = share * (share * x[past - 1, g]) + gain * gain * x[_LANDED, g]
                            early = (jitter**2 + late[i]**2) * (held - v)**2
                            for s in range(m * m):
                                x[square + s // m * d + s % m, g] += early * pulse[s // m] * pulse[s % m]
                        x[_PLACE, g], x[_UP, g], x[_DOWN, g] = held, unfelt, unfelt
                        x[_WIDE_UP, g] = x[_WIDE_DOWN, g] = own + x[_LANDED, g]
                        on = np.sign(du) if not each else 1.0 if rising else -1.0
                        x[_HEADING, g] = on if held == new and restick < np.inf else 0.0
                    if event == 2:
                        # (its own part: it does as the command says)
                        told[h] = _SURE
                        h -= 1
                    elif goes_on:
                        new = max(to_up, v) if heading > 0.0 else min(to_down, v)
                        held = min(max(new, low), high)
                        if held != v:
                            x[_LANDED, h] = error2 if held == new else 0.0
                            early = (late[i] * (held - v))**2
                            for s in range(m * m if early > 0.0 else 0):
                                x[square + s // m * d + s % m, h] += early * pulse[s // m] * pulse[s % m]
                            for r in range(m):
                                x[square + r * d + m, h] = 0.0
                            if d > 0:
                                x[off + m, h], x[past - 1, h] = 0.0, gain * gain * x[_LANDED, h]
                        x[_PLACE, h] = held
                        if held != new:
                            x[_HEADING, h], x[_UP, h], x[_DOWN, h] = 0.0, unfelt, unfelt
                            x[_WIDE_UP, h] = x[_WIDE_DOWN, h] = own + x[_LANDED, h]
            waits = 0
        if not good[k]:
            continue
        for h in range(count):
            errors[h], spreads[h] = target[k] - gain * through * (places[h] - start), 1.0
        for s in range(states):
            a, one = seen[s], x[_FIRST + s]
            for h in range(count):
                errors[h] -= a * one[h]
        for r in range(d):
            a, one, sink = reads[r], x[off + r], along[r]
            for h in range(count):
                errors[h] -= a * one[h]
                sink[h] = 0.0
            for c in range(d):
                b, two = reads[c], x[square + (r * d + c if r < m else c * d + m)]
                for h in range(count):
                    sink[h] += two[h] * b
            for h in range(count):
                spreads[h] += a * sink[h]
        # (a start that is not known yet tells nothing of the stem)
        for r in range(d if counted[k] else 0):
            one, sink = along[r], x[off + r]
            for h in range(count):
                sink[h] += one[h] * errors[h] / spreads[h]
            for c in range(0 if r < m else m, d):
                two, sink = along[c], x[square + r * d + c]
                for h in range(count):
                    sink[h] -= one[h] * two[h] / spreads[h]
        for h in range(count):
            errors[h] /= math.sqrt(spreads[h])
            innovations[h] = errors[h]
        for s in range(order):
            a, one = taps[s], x[past + s]
            for h in range(count):
                innovations[h] += a * one[h]
        for s in range(order - 1, -1, -1):
            one, sink = x[past + s - 1] if s else errors, x[past + s]
            for h in range(count):
                sink[h] = one[h]
        best = -np.inf
        for h in range(count):
            if counted[k] and filled >= order:
                fits = -0.5 * (innovations[h] * innovations[h] + math.log(spreads[h]))
                weights[h], owns[h] = weights[h] + fits, owns[h] + fits
            best = max(best, weights[h])
        filled += 1
        # The best ones stay; one that is nearly the same as a better one is added to it.
        near = 0
        for h in range(count):
            stays[h] = 0
            if weights[h] < best - CUT:
                continue
            at = near
            near += 1
            while at > 0 and weights[ranked[at - 1]] < weights[h]:
                ranked[at] = ranked[at - 1]
                at -= 1
            ranked[at] = h
        # Where each lies, and what it says of PV; those kept so far side by side, so that all are compared at once.
        for h in range(count):
            beside[h], answers[h] = gain * places[h], 0.0
        if d > 0:
            one = x[off + m]
            for h in range(count):
                beside[h] += one[h]
        for s in range(states):
            a, one = seen[s], x[_FIRST + s]
            for h in range(count):
                answers[h] += a * one[h]
        for s in range(m):
            a, one = row[s], x[off + s]
            for h in range(count):
                answers[h] += a * one[h]
        kept = 0
        for q in range(near):
            h = ranked[q]
            if kept >= kept_most:
                break
            mine, same = (x[_HEADING, h], x[_PLACE, h], beside[h], answers[h], x[_UP, h], x[_DOWN, h]), 0
            for r in range(kept):
                near_by = (among[r] == mine[0]) & (abs(among[room + r] - mine[1]) <= same_place)
                near_by &= (abs(among[2 * room + r] - mine[2]) <= _POSITION)
                near_by &= (abs(among[3 * room + r] - mine[3]) < _RESPONSE)
                # (two that have felt no force are alike)
                near_by &= not abs(among[4 * room + r] - mine[4]) > _FORCE * unlike
                near_by &= not abs(among[5 * room + r] - mine[5]) > _FORCE * unlike
                alike[r] = near_by
                same += near_by
            if same > 0:
                r = 0
                while alike[r] == 0:
                    r += 1
                g = ranked[r]
                x[_WEIGHT, g] += math.log1p(math.exp(x[_WEIGHT, h] - x[_WEIGHT, g]))
                continue
            for s in range(6):
                among[s * room + kept] = mine[s]
            ranked[kept], stays[h] = h, 1
            kept += 1
        q, sum_of = 0, 0.0
        for h in range(count):
            if stays[h] == 1:
                for s in range(width if h != q else 0):
                    x[s, q] = x[s, h]
                sum_of += math.exp(x[_WEIGHT, q] - best)
                q += 1
        count = kept
        shift = best + math.log(sum_of)
        total += shift
        for h in range(count):
            weights[h], owns[h] = weights[h] - shift, owns[h] - shift
    last = 0
    for h in range(count):
        last = h if weights[h] > weights[last] else last
    return total, owns[last], int(x[_NODE, last]), i + 1
