"""A valve moved along known slips under a command that errs at each unseen scan by itself.

Between two rows of an export the controller scanned on, and the noise of PV moved its output at every scan. A stem
breaks away where that error adds to the command, so it slips early and lands further on than the command that was
rebuilt says. What its landing missed stays until the next slip, as its own break-away force does. `replay_unseen` gives
for every stroke the chances that the stem stayed and slipped, and the errors of its landing.

The force of a stick is N(f_s + mean, wide). At each scan the stem slips with the chance Phi(z), z = (E - mean) / w with
w^2 = wide + error^2. A stem that stays tells of its force: its mean and variance follow as those of the force among
the stems that stay. Wrong for errors that hang together from scan to scan.

Source: docs/details.md, section 14; Minka 2001 (moments of a normal number times a probit).
"""

from __future__ import annotations

import math

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
from ..numerics.noise.normal import ROOT_TWO_PI
from ..typing import FloatArray, IntArray

# Rows of a stroke: logs of the chances that it stayed until its slip, that it slipped then, and that it did not slip
# the other way; then the share of the last landing's error in that of the next, and its own variance.
STAYED, SLIPPED, OTHER_WAY, SHARE, LANDED = range(5)
ROWS = 5
# Distance from f_s, in standard deviations, below which nothing slips, and beyond which logs are those of a series.
FAR, STEEP = -4.0, 20.0
# The largest one either way.
MOST = 60.0
ROOT_HALF = math.sqrt(0.5)
# Least variance that is left of a force, as a share of the first one.
LEAST_LEFT = 1e-4


@kernel
def replay_unseen(command: FloatArray, friction: FloatArray, profile: FloatArray, start: FloatArray, rests: bool,
                  doubt: FloatArray, errors: FloatArray, own: float, events: IntArray, kinds: IntArray, known: int,
                  position: FloatArray, chances: FloatArray, turns: FloatArray) -> None:
    """Fill position (n, P), chances (slips + 1, 5, P) and turns (P,); slips by the law from sample `known` on.

    `errors` (n,) are variances of the command, `own` that of a break-away force.
    """
    n, lanes = position.shape
    for p in range(lanes):
        fs_up0, fs_down0 = friction[FS_UP, p] + TIE, friction[FS_DOWN, p] + TIE
        stops = math.inf if rests else friction[RESTICK, p]
        low, high, spare = friction[LOWER, p], friction[UPPER, p], friction[OVERSHOOT, p] - 1.0
        v, heading, moves, landed, said = start[p], 0.0, False, 0.0, 0.0
        mean_up, mean_down, wide_up, wide_down, stayed_up, stayed_down = 0.0, 0.0, own, own, 0.0, 0.0
        event, stroke = 0, 0
        for k in range(n):
            u, error = command[k], errors[k]
            du = u - command[k - 1] if k > 0 else 0.0
            way, turned, by_law = 0, False, k >= known
            while event < events.size and events[event] == k and not by_law:
                if abs(kinds[event]) == 1:
                    way = kinds[event]
                else:
                    turned = True
                event += 1
            to_up = u - (friction[FD_UP, p] + friction[FD_DRIFT, p] * profile[k])
            to_down = u + (friction[FD_DOWN, p] + friction[FD_DRIFT, p] * profile[k])
            if moves:
                goes_on = (du * heading > 0.0 and abs(du) >= stops) != turned
                if not by_law and doubt[k] > 0.0:
                    said += math.log(doubt[k] if turned else 1.0 - doubt[k])
                if goes_on:
                    new = max(to_up, v) if heading > 0.0 else min(to_down, v)
                    held = min(max(new, low), high)
                    if held != v:
                        landed = error if held == new else 0.0
                    v, moves = held, held == new
                    position[k, p] = v
                    if not moves:
                        mean_up, mean_down, stayed_up, stayed_down = 0.0, 0.0, 0.0, 0.0
                        wide_up = wide_down = own + landed
                    continue
                moves, mean_up, mean_down, stayed_up, stayed_down = False, 0.0, 0.0, 0.0, 0.0
                wide_up = wide_down = own + landed
            grown = friction[FS_DRIFT, p] * profile[k]
            up = u - v - (fs_up0 + grown) if v < high else -math.inf
            down = v - u - (fs_down0 + grown) if v > low else -math.inf
            rising = up > down if way == 0 else way > 0
            force, mean, wide = (up, mean_up, wide_up) if rising else (down, mean_down, wide_down)
            w = math.sqrt(wide + error)
            z = min(max((force - mean) / w, -MOST), MOST)  # (a stem at its stop can't slip on)
            if way == 0 and not (by_law and force > 0.0):
                if z > FAR:
                    chance, log_chance = 0.0, -0.5 * z * z - math.log(max(z, 1.0) * ROOT_TWO_PI)
                    steep = z + 1.0 / z
                    if z < STEEP:
                        chance = 0.5 * math.erfc(z * ROOT_HALF)
                        log_chance, steep = math.log(chance), math.exp(-0.5 * z * z) / (chance * ROOT_TWO_PI)
                    left = max(1.0 - wide / (wide + error) * steep * (steep - z), LEAST_LEFT)
                    mean, wide = mean + wide / w * steep, max(wide * left, LEAST_LEFT * own)
                    if rising:
                        stayed_up, mean_up, wide_up = stayed_up + log_chance, mean, wide
                    else:
                        stayed_down, mean_down, wide_down = stayed_down + log_chance, mean, wide
                position[k, p] = v
                continue
            chance, log_chance = 0.0, -0.5 * z * z - math.log(max(-z, 1.0) * ROOT_TWO_PI)
            steep = -z - 1.0 / z
            if z > -STEEP:
                chance = 0.5 * math.erfc(-z * ROOT_HALF)
                log_chance, steep = math.log(chance), math.exp(-0.5 * z * z) / (chance * ROOT_TWO_PI)
            early = error / w * steep
            new = to_up + early if rising else to_down - early
            new += spare * (new - v)
            held = min(max(new, low), high)
            share = min(error / (wide + error) * steep * (steep + z), 1.0) if held == new else 0.0
            landed = error * (1.0 - share) if held == new else 0.0
            if stroke < chances.shape[0]:
                chances[stroke, STAYED, p], chances[stroke, OTHER_WAY, p] = (
                    (stayed_up, stayed_down) if rising else (stayed_down, stayed_up))
                chances[stroke, SLIPPED, p] = log_chance
                chances[stroke, SHARE, p], chances[stroke, LANDED, p] = share, landed
            stroke += 1
            v, moves, heading = held, held == new and stops < math.inf, 1.0 if rising else -1.0
            mean_up, mean_down, stayed_up, stayed_down = 0.0, 0.0, 0.0, 0.0
            wide_up = wide_down = own + landed
            position[k, p] = v
        if stroke < chances.shape[0]:
            chances[stroke, STAYED, p], chances[stroke, SLIPPED, p] = stayed_up, math.nan
            chances[stroke, OTHER_WAY, p] = stayed_down
        turns[p] = said
