"""Values that a historian kept of a signal, read from its texture: kept by exception, or between straight lines.

By exception a value is kept where it lies further from the last one than a deadband, and held in between. No change is
smaller than the deadband, while a signal that is only slow or rounded has changes down to its resolution. By swinging
door, or interpolated on export, rows between two kept values lie on one straight line, and lines meet in kinks. Wrong
for a controller that itself keeps its output until it changes enough: its record looks like one kept by exception.
Source: Bristol 1990, Swinging door trending (ISA); docs/traps.md, export trap 11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import BoolArray, FloatArray, IntArray

EXCEPTION, LINES = "exception", "lines"
"""Ways in which a historian thins a signal."""
MIN_STRAIGHT_SHARE = 0.1
"""Share of samples on straight lines beyond chance, from which a record counts as compressed (export trap 11)."""
RING = 5.0
"""Bends up to this many times what rounding makes tell how many are that small by chance: noise has as many of each."""
MIN_KINK = 10.0
"""Usual bend between lines, in units of what rounding makes: lines of a recorder meet in kinks, slow smooth signals
look straight only because they are rounded."""
MAX_CURVED = 0.5
"""Share of neighbouring bends with one sign, up to which they are kinks or noise: a curve bends on."""
MIN_NEIGHBOURS = 0.1
"""Share of bends that have a neighbour, from which that share means anything."""
MIN_DIFFERENT_SLOPES = 0.3
"""Different slopes per line: a limit cycle without noise repeats a few slopes, interpolation never repeats one."""
ROUNDED_BEND = 2.01
"""Largest bend that rounding alone makes out of a straight line, in units of the resolution."""
ROUGH = 0.2
"""Median bend over median step from which a signal counts as noisy."""
RESOLVED = 8.0
"""Steps between samples in units of the resolution from which straightness can be judged at all."""
MIN_HELD_SHARE = 0.1
"""Share of samples that repeat the last one, from which a record may be kept by exception."""
MIN_CHANGES, SMALLEST = 30, 0.02
"""Changes from which the smallest ones mean anything, and the quantile of their sizes taken for the deadband."""
MIN_CHANGE, MIN_STEPS = 0.25, 1.5
"""Smallest change over the usual one, and over the resolution, from which small changes are missing."""
NEAR, MIN_SPREAD = 1.5, 0.02
"""Changes up to this multiple of the smallest scatter by this share of it at least: those of a rounded signal, or of an
output moved by hand in equal steps, are all alike."""
OF_KINK = 0.5
"""Deadband of a swinging door over the usual distance of a kept value from the line between its neighbours. Measured on
simulated signals with noise of 0 to 1 times the deadband: 0.2 to 1.3."""


@dataclass(frozen=True, slots=True)
class Archived:
    """A thinned signal: the way, the rows (n,) whose value was kept, the share of all others, and the deadband.

    `deadband` is in the unit of the signal. Behind straight lines it is known to a factor of three.
    """

    way: str
    kept: BoolArray
    share: float
    deadband: float


def archived(values: FloatArray, starts: tuple[int, ...] = (0,), beside: FloatArray | None = None) -> Archived | None:
    """The thinning of a signal (n,) with segments at `starts`; None where its texture shows none.

    In a loop without noise straight lines may be its own. So the signal `beside` (n,), where one is given, must have
    noise, or be thinned as well.
    """
    found = _by_exception(values, starts) or _by_lines(values, starts)
    if found is None or found.way == EXCEPTION or beside is None or _rough(beside):
        return found
    return found if archived(beside, starts) is not None else None


def _rough(values: FloatArray) -> bool:
    """True where a signal has noise, or is missing so often that its noise can't be seen."""
    steps, bends = (np.abs(np.diff(values, order)) for order in (1, 2))
    steps, bends = steps[np.isfinite(steps)], bends[np.isfinite(bends)]
    return not bends.size or float(np.median(bends)) > ROUGH * float(np.median(steps)) > 0


def _by_exception(values: FloatArray, starts: tuple[int, ...]) -> Archived | None:
    steps = np.diff(values)
    if len(starts) > 1:
        steps[np.array(starts[1:]) - 1] = np.nan
    known = np.isfinite(steps)
    sizes = np.abs(steps[known & (steps != 0.0)])
    held = 1.0 - sizes.size / max(int(known.sum()), 1)
    if sizes.size < MIN_CHANGES or held < MIN_HELD_SHARE:
        return None
    smallest = float(np.quantile(sizes, SMALLEST))
    near = sizes[(sizes >= smallest) & (sizes <= NEAR * smallest)]
    if smallest < max(MIN_CHANGE * float(np.median(sizes)), MIN_STEPS * resolution_of(values)) \
            or float(np.std(near)) < MIN_SPREAD * smallest:
        return None
    return Archived(EXCEPTION, np.concatenate([[True], ~known | (steps != 0.0)]), held, smallest)


def _by_lines(values: FloatArray, starts: tuple[int, ...]) -> Archived | None:
    steps, bends = np.diff(values), np.diff(values, 2)
    resolution = resolution_of(values)
    moving = np.abs(steps[np.isfinite(steps) & (steps != 0.0)])
    if not moving.size or float(np.median(moving)) < RESOLVED * resolution:
        return None
    tolerance = max(ROUNDED_BEND * resolution, 1e-9 * float(np.nanmax(values) - np.nanmin(values)))
    straight = np.abs(bends) <= tolerance
    for start in starts[1:]:
        straight[max(start - 2, 0) : start] = False
    first, end = runs_of(straight & (np.abs(steps[1:]) > tolerance))
    off_line = np.abs(bends[np.abs(bends) > tolerance])
    if not first.size or not off_line.size or float(np.median(off_line)) < MIN_KINK * tolerance:
        return None
    slopes = steps[first]
    different = np.unique(np.rint(slopes / (0.005 * float(np.median(np.abs(slopes)))))).size / first.size
    kept = np.concatenate([[True], ~straight, [True]])
    at = np.flatnonzero(kept & np.isfinite(values))
    by_chance = np.count_nonzero(off_line <= RING * tolerance) / (RING - 1.0)
    share = (int((end - first).sum()) - float(by_chance)) / values.size
    bent = np.abs(bends) > tolerance
    beside = bent[1:] & bent[:-1]
    alike = np.count_nonzero(bends[1:][beside] * bends[:-1][beside] > 0.0)
    curved = alike > MAX_CURVED * np.count_nonzero(beside) and np.count_nonzero(beside) > MIN_NEIGHBOURS * bent.sum()
    if share < MIN_STRAIGHT_SHARE or different < MIN_DIFFERENT_SLOPES or curved:
        return None
    left, here, right = at[:-2], at[1:-1], at[2:]
    line = values[left] + (values[right] - values[left]) * (here - left) / (right - left)
    return Archived(LINES, kept, share, OF_KINK * float(np.median(np.abs(values[here] - line))))


def runs_of(mask: BoolArray) -> tuple[IntArray, IntArray]:
    """First index and one past the last of every run of True."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def resolution_of(values: FloatArray) -> float:
    """The smallest step between two values that occur, in the unit of the signal; 0 for full precision."""
    levels = np.unique(values[np.isfinite(values)][:200_000])
    if levels.size < 2:
        return 0.0
    gaps = np.diff(levels)
    # Differences of decimal fractions carry rounding of 1e-16; a hundredth of the usual gap is no level of its own.
    return float(gaps[gaps > 1e-12 * float(np.abs(levels).max())].min(initial=np.inf)) if (gaps > 0).any() else 0.0
