"""Rhythm of a loop's oscillation: period, phase and harmonics of the control error, to compare loops with each other.

A valve that sticks makes an oscillation with corners. Processes between loops filter the corners, so that harmonics
fade and phases grow with the distance from the source. Wrong where loops drift in and out of step, and about the phase
where one loop answers the other the opposite way (half a period).

Source: Thornhill, Finding the source of nonlinearity in a process with plant-wide disturbances, 2005.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np

from ..typing import FloatArray
from .loop import Loop, bridged

# Fewest whole cycles of a rhythm, the number of harmonics, and the half width of a band around each. Unit: of the
# frequency.
_CYCLES, _HARMONICS, _HALF = 4.0, 5, 0.25
# Share of the oscillation's period by which the strongest line may lie beside it; lines between two Fourier lines.
_BESIDE, _FINER = 0.35, 8
# Longest stretch that is looked at, about the middle of the record: its spectrum takes 16 bytes a finer line. Unit:
# samples.
_MOST = 1 << 19


@dataclass(frozen=True, slots=True)
class Rhythm:
    """Period in s, number of cycles, share of the power of harmonics 2 to 5 in that of the first, and the phase.

    `phase` is the share of a period (0 to 1) since the fundamental of the control error last rose through zero, at the
    middle of the record, `middle_s` seconds since 1970. The latter is None where the record has no stamps.
    """

    period_s: float
    cycles: float
    harmonics: float
    phase: float
    middle_s: float | None = None


def rhythm_of(loop: Loop, period: float | None) -> Rhythm | None:
    """The rhythm of the longest segment near a `period` in s; None without a period, or for less than four cycles."""
    piece = loop.longest_segment()
    spare = (piece.samples - _MOST) // 2
    piece = piece if spare <= 0 else piece.cut(spare, piece.samples - spare)
    if not period or piece.samples * piece.step_s < _CYCLES * period:
        return None
    error = bridged(piece.process_value if piece.setpoint is None else piece.process_value - piece.setpoint)
    error = error - np.polyval(np.polyfit(np.arange(error.size), error, 1), np.arange(error.size))
    window = np.hanning(error.size)
    size = _FINER * (1 << (error.size - 1).bit_length())
    line = np.fft.rfft(error * window, size)
    f, power = np.asarray(np.fft.rfftfreq(size, piece.step_s), np.float64), np.abs(line) ** 2
    near = (f > (1.0 - _BESIDE) / period) & (f < (1.0 + _BESIDE) / period)
    if not near.any() or not power[near].any():
        return None
    top = int(np.flatnonzero(near)[power[near].argmax()])
    first = float(f[top])
    bands = np.array([_band(f, power, k * first, _HALF * first) for k in range(1, _HARMONICS + 1)])
    # Angle of the sine at the middle of the record.
    angle = float(np.angle(line[top])) + 2.0 * np.pi * first * 0.5 * (error.size - 1) * piece.step_s + 0.5 * np.pi
    return Rhythm(1.0 / first, piece.samples * piece.step_s * first, float(bands[1:].sum() / max(bands[0], 1e-300)),
                  float(angle / (2.0 * np.pi) % 1.0), _middle(loop))


def _band(f: FloatArray, power: FloatArray, at: float, half: float) -> float:
    """Power in a band beyond that of the noise on either side of it."""
    inside, beside = np.abs(f - at) <= half, (np.abs(f - at) > half) & (np.abs(f - at) <= 2.0 * half)
    floor = float(np.median(power[beside])) if beside.any() else 0.0
    return float(np.maximum(power[inside] - floor, 0.0).sum())


def _middle(loop: Loop) -> float | None:
    """Time of the middle of the longest segment in seconds since 1970; stamps without a zone count as UTC."""
    at = max(range(len(loop.starts)), key=lambda k: loop.segments[k].stop - loop.segments[k].start)
    stamp = loop.origin.segment_starts[at] if len(loop.origin.segment_starts) == len(loop.starts) else loop.origin.start
    if not stamp or (at and len(loop.origin.segment_starts) != len(loop.starts)):
        return None
    try:
        begin = datetime.fromisoformat(stamp)
    except ValueError:
        return None
    seconds = (begin - datetime(1970, 1, 1, tzinfo=begin.tzinfo)).total_seconds()
    return float(seconds + 0.5 * (loop.longest.stop - loop.longest.start - 1) * loop.step_s)
