"""Slew limit: the stroking speed of the actuator is limited by its air supply.

Indistinguishable from an extra lag when every stroke is short.

Equation: |du_v/dt| <= rate. Under a command that moves between samples a stroke begins and ends at instants inside a
part of a sample. Each part is given by its mean. Measured with the true numbers, as a multiple of the noise: 1.3 for an
integrator and 21 where the stem never reaches the command, with strokes that begin at the ends of eighths of a sample.
With the instants: 1.06 and 6 (most of the 6 comes from the simulation's own steps). Source: rate-limited actuator,
docs/details.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.jit import kernel
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import Context, Effect, Place, Scales, Values

# Slowest rate, in swings of the command a period. Guesses lie between _GUESSED[0] swings a period and _GUESSED[1]
# swings a sample; _GUESSES is their number.
_SLOWEST, _GUESSED, _GUESSES = 0.1, (0.5, 0.6), 5
_RATE = Parameter("rate", "% / s", 1e-3, 1e3, 1e3, "fastest stroke", log=True)


@kernel
def _run(signal: FloatArray, y: FloatArray, theta: FloatArray, part_s: float, state: FloatArray,
         out: FloatArray) -> None:
    rows, lanes = signal.shape
    for k in range(rows):
        for p in range(lanes):
            reach = theta[0, p] * part_s
            move = signal[k, p] - state[0, p]
            move = min(max(move, -reach), reach)
            state[0, p] += move
            out[k, p] = state[0, p]


@kernel
def _run_means(signal: FloatArray, y: FloatArray, theta: FloatArray, part_s: float, state: FloatArray,
               out: FloatArray) -> None:
    rows, lanes = signal.shape
    # Target position at the start of the part.
    place = signal[0].copy()
    for k in range(rows):
        for p in range(lanes):
            reach, at = theta[0, p] * part_s, state[0, p]
            now, start = signal[k, p], place[p]
            before = signal[max(k - 1, 0), p]
            after, later = signal[min(k + 1, rows - 1), p], signal[min(k + 2, rows - 1), p]
            # Target position at the end of the part, extrapolated from the two parts before or the two after, whichever
            # are straighter.
            bent = now - 2.0 * before + signal[max(k - 2, 0), p]
            bends = after - 2.0 * later + signal[min(k + 3, rows - 1), p]
            end = now + 0.5 * (now - before) if abs(bent) <= abs(bends) else after - 0.5 * (later - after)
            left, slips = 1.0, False
            if k > 1 and before == signal[k - 2, p] and (after - before) * (now - before) > 0.0:
                # A slip after a rest: the means of its part and of the next ones give its instant and the slide after.
                slides = later - after
                slides = slides if slides * (now - before) > 0.0 and abs(slides) < 0.5 * abs(after - before) else 0.0
                end = after - 0.5 * slides
                slips = True
                # (The mean is before + left (end - before) - left^2 slides / 2.)
                whole = end - before
                root = np.sqrt(max(whole * whole - 2.0 * slides * (now - before), 0.0))
                left = min(2.0 * (now - before) / (whole + np.sign(whole) * root), 1.0)
                start = end - left * slides
            if not slips and at == start and abs(end - start) <= reach:
                out[k, p], state[0, p], place[p] = now, end, end
                continue
            mean = 0.0
            for second in range(2):
                length = left if second else 1.0 - left
                if length <= 0.0:
                    continue
                goal, speed = (start, (end - start) / length) if second else (before, 0.0)
                gap = goal - at
                way = np.sign(gap) if gap != 0.0 else np.sign(speed)
                closing = way * reach - speed
                meets = gap / closing if gap * closing > 0.0 else (0.0 if gap == 0.0 else length)
                meets = min(meets, length)
                mean += meets * (at + 0.5 * way * reach * meets)
                at += way * reach * meets
                rest = length - meets
                pace = min(max(speed, -reach), reach)
                mean += rest * (at + 0.5 * pace * rest)
                at += pace * rest
                if rest > 0.0 and pace == speed:
                    at = goal + speed * length
            out[k, p], state[0, p], place[p] = mean, at, end


def _start(signal: FloatArray, theta: FloatArray) -> FloatArray:
    return signal[:1].copy()


def _limits(context: Context) -> tuple[Parameter, ...]:
    # A rate of more than the whole swing of the command within a quarter of a sample has no effect. The lower limit is
    # far below: a valve that can't follow makes the loop swing wider. In one record a stroke of half a period covered
    # less than a quarter of the swing.
    high = 8.0 * context.s_max / context.step_s
    return (replace(_RATE, low=max(_SLOWEST * context.s_max / context.period_s, 1e-6), high=high, neutral=high),)


def _guess(context: Context) -> FloatArray:
    # Strokes from a whole period down to two samples; the sampling rate decides which of them is met.
    slow, fast = _GUESSED[0] / context.period_s, _GUESSED[1] / context.step_s
    return context.s_max * np.geomspace(min(slow, fast), fast, _GUESSES)[:, None]


def _visible(scales: Scales) -> Values:
    return {"rate": scales.J / (0.6 * scales.lag_s)}


EFFECT = Effect(
    name="slew-limit", kind="T", place=Place.STEM,
    summary="the actuator strokes no faster than its air supply allows",
    equation="|du_v/dt| <= rate", source="docs/details.md, section 5", parameters=(_RATE,),
    confused_with=("extra-lag",),
    fine=True, states=1, limits=_limits, run=_run, run_means=_run_means, start=_start, guess=_guess,
    visible=_visible,
    leaves={"slip": 2, "cycle": 3, "valve": 2, "dip": 3},
    noun="an actuator that is too slow",
    sentence="The stem moves no faster than {rate}.",
    seen_over="direction",
    action="Check air supply, tubing and booster of the actuator.",
    settled_by="two steps in manual of different size",
)
