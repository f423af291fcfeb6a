"""Preconditions of an identification (gate 0): a record that lacks one gets an abstention with the reason.

Source: docs/details.md, sections 6.6 and 12.
"""

from __future__ import annotations

import numpy as np

from ..errors import CannotTell
from ..numerics.autoregression import pace_of
from .loop import Loop
from .oscillation import FEWEST_CYCLES, FLAT, count_reversals, holds_start, noise_of
from .study import Range

FEWEST_SAMPLES = 60
# Without enough cycles, setpoint moves must make the valve reverse at least this often.
FEWEST_REVERSALS = 4
# Least number of samples in one period; fewer hide the slips. Unit: samples.
SAMPLES_PER_PERIOD = 10
# Samples from one PV to the next, on average, from which PV is asked whether it shows a period; and the share of a
# period by PV below which the one by the output's reversals says that PV misses turns.
_SPARSE, _MISSED = 1.5, 0.5
# An output beyond this is no valve position in %. Unit: %.
_HIGHEST_OUTPUT = 110.0
# Process value and output that differ by less than this share of the span are one signal: no process is that exact.
_SAME = 1e-9
# More than this share of samples at the output's own limit is a saturated loop.
_SATURATED_SHARE = 0.2
# A record that starts this share of its span away from the setpoint starts with a setpoint step.
_STEPPED = 0.5
# Parts of a period over which y is averaged before its slope is taken.
_PARTS = 60


def check(loop: Loop, found: Range, *, by_hand: bool = False) -> None:
    """Raise CannotTell where the record can't hold S and J; the message is the reason in one sentence.

    A test `by_hand`, whose OP is stepped in manual, neither oscillates nor saturates.
    """
    u, y = loop.output[loop.driven], loop.process_value[loop.used]
    _check_process_value(loop, found)
    if y.size < FEWEST_SAMPLES:
        short = loop.samples < FEWEST_SAMPLES
        raise CannotTell(
            f"only {y.size} usable samples{'' if short else f' of {loop.samples}'}, {FEWEST_SAMPLES} are needed",
            "give a longer record" if short else "see with stictionid read which samples are left out and why; choose "
            "another stretch with --start and --end", code="too-short")
    span = float(np.ptp(y))
    if span <= FLAT * float(np.abs(y).max()) or span < 1e-30:
        raise CannotTell(f"the process value does not vary: its whole span is {span:.3g} at a value of {y[0]:.3g}",
                         "check the transmitter; choose another stretch with --start and --end", code="dead-signal")
    swing = float(np.ptp(u))
    if swing <= FLAT * float(np.abs(u).max()) or swing < 1e-30:
        raise CannotTell(f"the controller output is constant at {u[0]:g}: manual, or saturated",
                         "choose a stretch in automatic with --start and --end", code="constant-output")
    high = float(np.abs(u).max())
    if high > _HIGHEST_OUTPUT and loop.unit("output", "%") != "%":
        raise CannotTell(
            f"the controller output reaches {high:.4g}: that is no valve position in % but the setpoint of another "
            "loop (cascade master), or needs its span", "identify the slave loop, or give --span-op LO,HI",
            code="output-not-a-valve")
    tight = 1e-9 * max(swing, 1e-30)
    limited = float(np.mean((u >= u.max() - tight) | (u <= u.min() + tight)))
    if not by_hand and limited > max(_SATURATED_SHARE, 10.0 / u.size):
        raise CannotTell(f"the controller output sits at its limit in {100 * limited:.0f} % of the samples "
                         f"({100 * _SATURATED_SHARE:.0f} % is the most)",
                         "choose a stretch without saturation with --start and --end", code="saturated-output")
    u = loop.output[loop.used]
    tie = (u - u.mean()) * (float((y - y.mean()) @ (u - u.mean())) / float((u - u.mean()) @ (u - u.mean())))
    if float(np.abs(y - y.mean() - tie).max()) < _SAME * span:
        raise CannotTell("the process value is the controller output, times a number plus a number, to the last digit: "
                         "one signal was given twice", "give the process value with --pv, the output with --op",
                         code="identical-signals")
    if by_hand:
        return
    counted = found.cycles[holds_start(found.cycles):]
    enough = len(counted) >= FEWEST_CYCLES
    if not enough and _driven_reversals(loop) < FEWEST_REVERSALS:
        raise CannotTell(
            f"too little movement: {len(counted)} whole cycles ({FEWEST_CYCLES} are needed) and no setpoint moves that "
            f"make the valve reverse {FEWEST_REVERSALS} times", "give a longer record", code="too-few-cycles")
    turns = max(found.reversals, _driven_reversals(loop))
    if turns < FEWEST_REVERSALS:
        raise CannotTell(
            f"the controller output reverses only {turns} times by more than its noise, {FEWEST_REVERSALS} are needed: "
            "a valve that hardly reverses shows no friction", "give a longer record, or one with setpoint moves",
            code="hardly-reverses")
    if enough and found.period_median_s is not None:
        per = found.period_median_s / loop.step_s
        if per < SAMPLES_PER_PERIOD:
            raise CannotTell(
                f"sampled too slowly: {per:.1f} samples a period, {SAMPLES_PER_PERIOD} are needed "
                f"(period {found.period_median_s:.4g} s, step {loop.step_s:g} s)",
                f"export at {found.period_median_s / SAMPLES_PER_PERIOD:.3g} s or faster", code="too-slow-sampling")


def _check_process_value(loop: Loop, found: Range) -> None:
    """Raise CannotTell where PV is there too seldom in a period; the output tells the period where PV misses turns."""
    pace = pace_of(loop.used, loop.starts)
    if pace < _SPARSE:
        return
    apart_s = pace * loop.step_s
    period_s = found.period_median_s if len(found.cycles) >= FEWEST_CYCLES else None
    if found.reversals >= FEWEST_REVERSALS:
        told_s = 2.0 * float(loop.driven.sum()) * loop.step_s / found.reversals
        period_s = told_s if period_s is None or told_s < _MISSED * period_s else period_s
    if period_s is not None and period_s < SAMPLES_PER_PERIOD * apart_s:
        even = np.unique(np.diff(np.flatnonzero(loop.used))).size == 1
        raise CannotTell(
            f"PV is there only every {apart_s:.3g} s{'' if even else ' on average'}: that is "
            f"{period_s / apart_s:.1f} samples in a period of {period_s:.4g} s, {SAMPLES_PER_PERIOD} are needed",
            f"export PV at {period_s / SAMPLES_PER_PERIOD:.3g} s or faster, as OP is", code="too-slow-sampling")


def _driven_reversals(loop: Loop) -> int:
    """Reversals of the output, all segments; 0 where the setpoint rests and the record starts near it, or has none."""
    r = loop.setpoint
    if r is None:
        return 0
    still = np.ptp(r[loop.used]) <= FLAT * max(float(np.abs(r[loop.used]).max()), 1e-30)
    y = loop.process_value[loop.used]
    if still and abs(float(r[loop.used][0] - y[0])) < _STEPPED * float(np.ptp(y)):
        return 0
    driven = loop.driven
    u = loop.output[driven]
    threshold = max(0.05 * float(np.ptp(u)), 4.0 * noise_of(u))
    return sum(count_reversals(loop.output[part][driven[part]], threshold) for part in loop.segments)


def time_scale_s(loop: Loop, found: Range) -> float:
    """Time scale of the swings in seconds: the median period, or less where the loop rests between its swings.

    Such a loop has a long period and fast swings, and a search must resolve the swings. The scale is at most the
    period of the sine that has the slope of y (standard deviation, longest segment). Without two cycles twice the mean
    time between reversals takes the place of the period.
    """
    length = loop.samples * loop.step_s
    if found.period_median_s is not None and len(found.cycles) >= 2:
        period = found.period_median_s
    else:
        turns = max(_driven_reversals(loop), 1)
        period = float(np.clip(2.0 * length / (turns + 1), 10 * loop.step_s, length / 2))
    loop = loop.longest_segment()
    block = max(int(period / loop.step_s / _PARTS), 1)
    y = np.interp(np.arange(loop.samples), np.flatnonzero(loop.used), loop.process_value[loop.used])
    y = y[:y.size // block * block].reshape(-1, block).mean(axis=1)
    slope = float(np.std(np.diff(y))) / (block * loop.step_s) if y.size > 2 else 0.0
    swing = 2.0 * np.pi * float(np.std(y)) / slope if slope else period
    return float(np.clip(swing, SAMPLES_PER_PERIOD * loop.step_s, period)) if swing < period else period


def swing_of(loop: Loop, found: Range) -> float:
    """Upper limit for S in the unit of u: S_max (Eq. 21), or the whole swing of u where there are no cycles."""
    return float(found.s_max or np.ptp(loop.output[loop.driven]))
