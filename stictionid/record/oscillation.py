"""Oscillation of a record: cycles, period (Shang et al., Eq. 20) and S_max, the swing of the controller output (Eq.
21).

Cycles are counted on up-crossings of the deviation e = r - y through its mean, with hysteresis against noise. Only
whole cycles count. The first one is left out when enough remain, because it still holds the start. M in Eq. 20
counts cycles; two equations of the paper are numbered 21, this one and the tank's transfer function.
Without a setpoint the mean of y is the reference, and the result says so. Where the mean wanders, fewer than three
cycles cross it. Then cycles are counted from turning point to turning point of the output, and the result says so.
Turns at uneven distances are no oscillation; their cycles are listed, because a valve that turns shows its friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..numerics.autoregression import pace_of
from ..typing import FloatArray
from .loop import Loop, bridged
from .study import Cycle, Range

# Half-width of the hysteresis band as a share of the deviation's standard deviation. Unit: 1.
_HYSTERESIS = 0.3
# The band is at least this many standard deviations of the sample-to-sample noise.
_HYSTERESIS_NOISE = 3.0
# At most this share of the deviation's standard deviation is noise where PV is missing in between.
_HYSTERESIS_SPARSE = 0.5
# Share of samples at either end of the deviation that sets neither level nor band.
_TRIM = 0.05
# Least number of whole cycles that make an oscillation (docs/details.md, section 12).
FEWEST_CYCLES = 3
# Largest coefficient of variation of the cycle lengths of one oscillation.
_REGULAR = 0.6
# Without cycles around the reference, this many turns of the output make an oscillation. They are turns by the largest
# of these shares of its span at which there are so many, and by this many standard deviations of its noise.
FEWEST_TURNS = 8
_TURN_SHARES, _TURN_NOISE = (0.1, 0.05, 0.025), 6.0
BY_TURNS = "turning points of the output"
# At least this share of the cycles from turn to turn has a length within this factor of their median.
_EVEN_SHARE, _EVEN = 0.6, 1.75
# A swing of y or u below this share of its magnitude is no variation. Unit: 1.
FLAT = 1e-9


def deviation(loop: Loop) -> FloatArray:
    """Control error (n,), from the mean of y without a setpoint; the setpoint's mean offset does not matter."""
    y = bridged(loop.process_value)
    if loop.setpoint is not None:
        return loop.setpoint - y
    return (float(y[loop.used].mean()) if loop.used.any() else 0.0) - y


def noise_of(signal: FloatArray) -> float:
    """Standard deviation of sample-to-sample noise, from third differences (a smooth signal leaves little in them)."""
    if signal.size < 8:
        return 0.0
    return float(np.median(np.abs(np.diff(signal, 3))) / 0.6745 / np.sqrt(20.0))


def crossings(signal: FloatArray, band: float) -> FloatArray:
    """Times (in samples, fractional) where the signal crosses zero upwards after having been below -band.

    The crossing counts once the signal has also risen above +band, so noise near zero counts once.
    """
    low = False
    found: list[float] = []
    last_up = -1.0
    for k, (a, b) in enumerate(pairwise(signal.tolist()), 1):
        if b < -band:
            low = True
            last_up = -1.0
        if a < 0.0 <= b and low and last_up < 0.0:
            last_up = k - 1 + a / (a - b)
        if b > band and low:
            found.append(last_up)
            low = False
    return np.array([t for t in found if t >= 0.0])


def reversals(command: FloatArray, threshold: float) -> list[int]:
    """Samples at which the command has come back by more than `threshold` from its last extreme."""
    return [seen for _, seen in turning_points(command, threshold)]


def turning_points(command: FloatArray, threshold: float) -> list[tuple[int, int]]:
    """Samples of the extremes from which the command comes back by more than `threshold`, and those that show it."""
    turns: list[tuple[int, int]] = []
    direction, extreme, at = 0, float(command[0]) if command.size else 0.0, 0
    for k, value in enumerate(command.tolist()):
        if (direction >= 0 and value > extreme) or (direction <= 0 and value < extreme):
            if direction != 0 or abs(value - extreme) > threshold:
                direction, extreme, at = 1 if value > extreme else -1, value, k
        elif direction != 0 and abs(value - extreme) > threshold:
            turns.append((at, k))
            direction, extreme, at = -direction, value, k
    return turns


def count_reversals(command: FloatArray, threshold: float) -> int:
    """Number of turns of the command by more than `threshold` (zigzag count)."""
    return len(reversals(command, threshold))


@dataclass(frozen=True, slots=True)
class _Swings:
    """Cycles of one segment and the reversals of its output; `reason` explains an empty result."""

    cycles: tuple[Cycle, ...] = ()
    reversals: int = 0
    reason: str = ""


def find_range(loop: Loop) -> Range:
    """Period, S_max and the cycles behind them; never raises, `reason` explains a record that does not oscillate.

    Cycles are whole inside one segment of the record. Their starts are seconds of the record without its gaps.
    """
    unit = loop.unit("output", "%")
    parts = [loop] if len(loop.starts) == 1 else [loop.cut(p.start, p.stop) for p in loop.segments]
    found = [_swings(part, start * loop.step_s) for part, start in zip(parts, loop.starts, strict=False)]
    longest = found[int(np.argmax([part.samples for part in parts]))]
    cycles = tuple(cycle for swings in found for cycle in swings.cycles)
    turns = sum(swings.reversals for swings in found)
    reference = "mean of y" if loop.setpoint is None else "setpoint"
    even = True
    if len(cycles) < FEWEST_CYCLES or turns < FEWEST_TURNS:
        # A mean that wanders far takes the crossings away, or makes a tenth of the output's span more than a cycle.
        by_turns = [_by_turns(part, start * loop.step_s) for part, start in zip(parts, loop.starts, strict=False)]
        of_turns = tuple(cycle for swings in by_turns for cycle in swings.cycles)
        if sum(swings.reversals for swings in by_turns) >= FEWEST_TURNS and len(of_turns) >= FEWEST_CYCLES:
            turns = max(turns, sum(swings.reversals for swings in by_turns))
            if len(cycles) < FEWEST_CYCLES:
                near = _even(of_turns)
                alike = len(near) >= FEWEST_CYCLES
                # What a setpoint that moves does to the output needs no cycles.
                if alike or loop.setpoint is None or np.ptp(loop.setpoint[loop.used]) == 0.0:
                    even, found, cycles, reference = alike, by_turns, near if alike else of_turns, BY_TURNS
    if not cycles:
        return Range(False, None, None, None, (), longest.reason or "the deviation never completes a cycle", unit,
                     reference, turns)
    counted = cycles[holds_start(cycles):]
    periods = np.array([c.period_s for c in counted])
    scatter = float(periods.std() / periods.mean())
    enough = len(counted) >= FEWEST_CYCLES
    regular = scatter <= _REGULAR
    if not enough:
        reason = f"only {len(counted)} whole cycle{'s' * (len(counted) != 1)}, {FEWEST_CYCLES} are needed"
    elif not even:
        reason = f"the output turns {turns} times at uneven distances, and its mean wanders: no even cycles"
    elif not regular:
        reason = f"the cycles are irregular: their lengths scatter by {100 * scatter:.0f} % of the mean"
    else:
        reason = (f"{len(counted)} whole cycles"
                  + (f" in {sum(bool(s.cycles) for s in found)} segments" if len(parts) > 1 else "")
                  + f", lengths within {100 * scatter:.0f} % of the mean"
                  + {"setpoint": "", "mean of y": "; no setpoint, so deviations are from the mean of y",
                     BY_TURNS: "; counted by the turning points of the output, because its mean wanders"}[reference])
    return Range(enough and regular and even, float(periods.max()), float(np.median(periods)),
                 float(max(c.u_swing for c in counted)), cycles, reason, unit, reference, turns)


def holds_start(cycles: tuple[Cycle, ...]) -> bool:
    """True where the first cycle does not count, because it still holds the start and enough others remain."""
    return len(cycles) > FEWEST_CYCLES


def _even(cycles: tuple[Cycle, ...]) -> tuple[Cycle, ...]:
    """The cycles whose length is near the median; none where too few are.

    A mean that wanders faster than the cycle moves hides single turns, and two cycles then look like one.
    """
    middle = float(np.median([c.period_s for c in cycles])) if cycles else 0.0
    near = tuple(c for c in cycles if middle / _EVEN <= c.period_s <= middle * _EVEN)
    return near if len(near) >= _EVEN_SHARE * len(cycles) else ()


def _swings(loop: Loop, start_s: float) -> _Swings:
    """The cycles of one segment that starts at `start_s` of its record."""
    u, used = loop.output, loop.used
    if used.sum() < 8:
        return _Swings(reason=f"only {int(used.sum())} usable samples")
    e = deviation(loop)
    # Trimmed, so that a start-up or a setpoint step neither shifts the level of the crossings nor widens the band.
    low, high = np.quantile(e[used], [_TRIM, 1.0 - _TRIM])
    core = e[used][(e[used] >= low) & (e[used] <= high)]
    e = e - core.mean()
    spread = float(core.std())
    swing_y = float(np.ptp(loop.process_value[used]))
    if swing_y <= FLAT * max(float(np.abs(loop.process_value[used]).max()), 1e-30) or swing_y < 1e-30:
        return _Swings(reason=f"the process value does not vary (its whole span is {swing_y:.3g})")
    known = u[loop.driven]
    if float(np.ptp(known)) <= FLAT * max(float(np.abs(known).max()), 1e-30):
        return _Swings(reason=f"the controller output is constant at {u[used][0]:g} {loop.unit('output', '%')}")
    noise = _HYSTERESIS_NOISE * noise_of(e[used])
    if pace_of(used) > 1.0:
        # Third differences of samples that are far apart show how the signal bends.
        noise = min(noise, _HYSTERESIS_SPARSE * spread)
    band = max(_HYSTERESIS * spread, noise)
    # Turns by a tenth of the span of the output and more than its noise.
    turns = count_reversals(known, max(0.1 * float(np.ptp(known)), 4.0 * noise_of(known)))
    cycles = tuple(
        Cycle(float(start_s + a * loop.step_s), float((b - a) * loop.step_s),
              float(np.ptp(u[int(np.ceil(a)):int(b) + 1])))
        for a, b in pairwise(crossings(e, band).tolist()) if b - a >= 2
    )
    return _Swings(cycles, turns)


def _by_turns(loop: Loop, start_s: float) -> _Swings:
    """The cycles of one segment from turn to turn of the output; none where PV or OP does not vary."""
    at = np.flatnonzero(loop.driven)
    u, y = loop.output[at], loop.process_value[loop.used]
    if at.size < 8 or y.size < 8 or np.ptp(y) <= FLAT * max(float(np.abs(y).max()), 1e-30):
        return _Swings()
    span, noise = float(np.ptp(u)), _TURN_NOISE * noise_of(u)
    if span <= FLAT * max(float(np.abs(u).max()), 1e-30):
        return _Swings()
    for share in _TURN_SHARES:
        turns = [int(at[k]) for k, _ in turning_points(u, max(share * span, noise))]
        if len(turns) >= FEWEST_TURNS:
            break
    cycles = tuple(
        Cycle(float(start_s + a * loop.step_s), float((b - a) * loop.step_s), float(np.ptp(loop.output[a:b + 1])))
        for a, b in zip(turns[:-2:2], turns[2::2], strict=True))
    return _Swings(cycles, len(turns))
