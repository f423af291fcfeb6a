"""Tests of signals for compression, quantisation, clipping, swapped columns and a changed range.

Each test returns a finding with its share and its effect on S and J, or None.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...record.loop import Finding
from ...typing import FloatArray
from ..grid.grid import runs_of
from ..words.cells import shown
from ..words.findings import SERIOUS, WARNING, finding

MAX_STRAIGHT_SHARE = 0.3
"""Share of samples on straight lines from which a record counts as compressed (docs/traps.md, export trap 11)."""
CAPPING_STRAIGHT_SHARE = 0.6
"""Share on straight lines from which no verdict is sure any more."""
MIN_LINE = 4
"""Samples on one line, at least: three can be chance."""
MIN_KINK = 10.0
"""Usual bend between lines, in units of what rounding makes: lines of a recorder meet in kinks, slow smooth signals
look straight only because they are rounded."""
MIN_DIFFERENT_SLOPES = 0.3
"""Different slopes per line: a limit cycle without noise repeats a few slopes, interpolation never repeats one."""
ROUNDED_BEND = 2.01
"""Largest bend that rounding alone makes out of a straight line, in units of the resolution."""
RESOLVED = 8.0
"""Steps between samples in units of the resolution from which straightness can be judged at all."""
ROUGH = 0.2
"""Median bend over median step from which a signal counts as noisy."""
MAX_RESOLUTION_SHARE = 0.02
"""Resolution over the usual range of a signal above which it is coarse."""
CAPPING_RESOLUTION_SHARE = 0.25
"""Resolution over the usual range from which no verdict is sure: fewer than five levels."""
CAPPING_CLIPPED_SHARE = 0.2
"""Share of clipped samples from which no verdict is sure."""
MAX_CLIPPED_SHARE = 0.02
"""Share of samples at the highest or lowest value above which PV is clipped."""
MAX_BLOCKS = 1000
"""Blocks of 100 samples from which the median of a long record is taken."""
MIN_RANGE_RATIO = 1.4
"""Ratio of levels before and after a jump from which a changed range is suspected."""
MIN_IDENTICAL, SAME = 50, 1e-9
"""Samples from which on, and share of the range up to which, two signals are one and the same."""
MAX_SETPOINT_MOVES, MIN_PV_MOVES = 0.05, 0.5
"""Shares of samples at which a setpoint at most, and a measurement at least, changes."""
MIN_CROSSED_FIT, MAX_RIGHT_FIT = 0.98, 0.9
"""R² of the controller's law with OP and PV crossed, and as they are named, from which they look swapped."""


@dataclass(frozen=True, slots=True)
class Signals:
    """Signals for the tests, uncopied: arrays (n,) in the units of the loop, step in seconds, segment starts."""

    output: FloatArray
    process_value: FloatArray
    setpoint: FloatArray | None
    step_s: float
    starts: tuple[int, ...]

    def head(self, samples: int) -> Signals:
        """The first samples."""
        setpoint = None if self.setpoint is None else self.setpoint[:samples]
        starts = tuple(s for s in self.starts if s < samples)
        return Signals(self.output[:samples], self.process_value[:samples], setpoint, self.step_s, starts)


def compressed(loop: Signals) -> Finding | None:
    """Finding on straight lines between few recorded points: swinging-door compression, or interpolation on export."""
    straight, slopes = _straight(loop.process_value, loop.starts)
    if straight < MAX_STRAIGHT_SHARE or slopes < MIN_DIFFERENT_SLOPES:
        return None
    op_straight, _ = _straight(loop.output, loop.starts)
    op_flat = float(np.mean(np.diff(loop.output) == 0))
    if max(op_straight, op_flat) < MAX_STRAIGHT_SHARE and not _rough(loop.output):
        return None
    caps = straight >= CAPPING_STRAIGHT_SHARE
    return finding("compressed", {"share": straight}, SERIOUS if caps else WARNING, caps_verdict=caps,
                   share=100 * straight)


def _straight(values: FloatArray, starts: tuple[int, ...]) -> tuple[float, float]:
    """Share of samples on sloping straight lines of four or more points, and number of different slopes per line."""
    steps, bends = np.diff(values), np.diff(values, 2)
    resolution = resolution_of(values)
    moving = np.abs(steps[steps != 0])
    if not moving.size or float(np.median(moving)) < RESOLVED * resolution:
        return 0.0, 0.0
    tolerance = max(ROUNDED_BEND * resolution, 1e-9 * float(np.nanmax(values) - np.nanmin(values)))
    on_line = (np.abs(bends) <= tolerance) & (np.abs(steps[1:]) > tolerance)
    for start in starts[1:]:
        on_line[max(start - 2, 0) : start] = False
    first, end = runs_of(on_line)
    lines = end - first >= MIN_LINE - 2
    off_line = np.abs(bends[np.abs(bends) > tolerance])
    if not lines.any() or not off_line.size or float(np.median(off_line)) < MIN_KINK * tolerance:
        return 0.0, 0.0
    slopes = steps[first[lines]]
    scale = float(np.abs(slopes).max())
    different = np.unique(np.rint(slopes / (0.005 * scale))).size / int(lines.sum())
    return float((end - first)[lines].sum()) / values.size, float(different)


def resolution_of(values: FloatArray) -> float:
    """The smallest step between two values that occur, in the unit of the signal; 0 for full precision."""
    levels = np.unique(values[np.isfinite(values)][:200_000])
    if levels.size < 2:
        return 0.0
    gaps = np.diff(levels)
    # Differences of decimal fractions carry rounding of 1e-16; a hundredth of the usual gap is no level of its own.
    return float(gaps[gaps > 1e-12 * float(np.abs(levels).max())].min(initial=np.inf)) if (gaps > 0).any() else 0.0


def _rough(values: FloatArray) -> bool:
    steps, bends = np.abs(np.diff(values)), np.abs(np.diff(values, 2))
    return float(np.median(bends)) > ROUGH * float(np.median(steps)) > 0


def swapped(loop: Signals, names: dict[str, str]) -> Finding | None:
    """Finding on PV and SP, or PV and OP, in each other's columns: one rests like a setpoint, or follows a PI law."""
    pv, op, sp = loop.process_value, loop.output, loop.setpoint
    if sp is not None:
        rests, moves = (float(np.mean(np.diff(v) != 0)) for v in (pv, sp))
        if rests < MAX_SETPOINT_MOVES and moves > MIN_PV_MOVES and np.unique(pv).size > 1:
            return _swapped("setpoint", "--pv --sp", names, {"pv_moves": rests, "sp_moves": moves})
    right, crossed = _obeys(op, pv, sp), _obeys(pv, op, sp)
    if crossed > MIN_CROSSED_FIT and right < MAX_RIGHT_FIT:
        return _swapped("output", "--pv --op", names, {"fit": right, "fit_crossed": crossed})
    return None


def identical(loop: Signals, names: dict[str, str]) -> Finding | None:
    """Finding on PV that is OP or SP times a number plus a number to the last digit: the same tag twice."""
    for role, other in (("output", loop.output), ("setpoint", loop.setpoint)):
        if other is None:
            continue
        good = np.isfinite(loop.process_value) & np.isfinite(other)
        y, x = loop.process_value[good], other[good]
        if y.size < MIN_IDENTICAL or np.ptp(y) == 0 or np.ptp(x) == 0:
            continue
        y, x = (y - y.mean()) / np.ptp(y), (x - x.mean()) / np.ptp(x)
        if float(np.abs(y - x * float(x @ y) / float(x @ x)).max()) < SAME:
            return finding("identical-signals", {"role": role}, caps_verdict=True, role=role,
                           one=shown(names.get("process_value", "PV")), other=shown(names.get(role, role)))
    return None


def _swapped(other: str, flags: str, names: dict[str, str], evidence: dict[str, float]) -> Finding:
    why = "the first rests like a setpoint while the second moves like a measurement" if other == "setpoint" else \
        "the first follows from the second as a controller's output follows from its process value"
    return finding("swapped-roles", evidence, caps_verdict=True, flags=flags, why=why,
                   one=f"process value {shown(names.get('process_value', 'process_value'))}",
                   other=f"{other} {shown(names.get(other, other))}")


def _obeys(output: FloatArray, measured: FloatArray, setpoint: FloatArray | None) -> float:
    """Share of the moves of `output` that a PI controller of `measured` explains (R²); 0 where it can't be computed."""
    part = slice(0, 20_000)
    du, dy, y = np.diff(output[part]), np.diff(measured[part]), measured[part][1:]
    columns = [np.ones(y.size), y, dy]
    if setpoint is not None and np.ptp(setpoint[part]) > 0:
        columns += [setpoint[part][1:], np.diff(setpoint[part])]
    design = np.stack(columns, axis=1)
    good = np.isfinite(du) & np.isfinite(design).all(axis=1)
    variance = float(np.var(du[good])) if good.sum() > 50 else 0.0
    if variance == 0.0:
        return 0.0
    scale = np.maximum(np.abs(design[good]).max(axis=0), 1e-300)
    solution, *_ = np.linalg.lstsq(design[good] / scale, du[good], rcond=1e-10)
    return 1.0 - float(np.var(du[good] - design[good] / scale @ solution)) / variance


def quantised(loop: Signals) -> list[Finding]:
    """Findings on signals whose resolution is coarse against their swing."""
    found = []
    for role, words, values in (("process_value", "PV", loop.process_value), ("output", "OP", loop.output)):
        levels, counts = np.unique(values[np.isfinite(values)], return_counts=True)
        if levels.size < 3 or counts.sum() < 10 * levels.size:
            continue
        resolution = float(np.median(np.diff(levels)))
        low, high = np.nanquantile(values, [0.01, 0.99])
        if high > low and resolution > MAX_RESOLUTION_SHARE * float(high - low):
            share = resolution / float(high - low)
            found.append(finding("quantised", {"role": role, "resolution": resolution, "levels": int(levels.size),
                                               "share": share},
                                 caps_verdict=share > CAPPING_RESOLUTION_SHARE, signal=words, resolution=resolution,
                                 span=high - low))
    return found


def clipped(loop: Signals) -> Finding | None:
    """Finding on PV that stays at its highest or lowest value repeatedly: the end of the transmitter's range."""
    values = loop.process_value
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    lively = float(np.mean(np.diff(values) != 0))
    for limit, word in ((high, "highest"), (low, "lowest")):
        at = values == limit
        first, end = runs_of(at)
        share = float((end - first)[end - first >= 3].sum()) / values.size
        if share > MAX_CLIPPED_SHARE and lively > 0.5 and np.count_nonzero(end - first >= 3) >= 2:
            return finding("clipped", {"share": share, "value": limit},
                           caps_verdict=share > CAPPING_CLIPPED_SHARE, word=word, limit=limit, share=100 * share)
    return None


def _blocks(values: FloatArray) -> FloatArray:
    """Blocks of 100 neighbours spread evenly over a long record: enough for a median, in a tenth of the time."""
    every = values.size // (100 * MAX_BLOCKS)
    return values if every < 2 else values[: values.size // 100 * 100].reshape(-1, 100)[::every].reshape(-1)


def re_ranged(loop: Signals) -> Finding | None:
    """Finding on a jump after which level and noise differ by one and the same factor: units or range changed."""
    values = loop.process_value
    steps = np.abs(np.diff(values))
    at = int(np.nanargmax(steps)) + 1
    before, after = values[:at], values[at:]
    if min(before.size, after.size) < 50 or steps[at - 1] < 20 * np.median(_blocks(steps)):
        return None
    before, after = _blocks(before), _blocks(after)
    levels = [float(np.nanmedian(v)) for v in (before, after)]
    noises = [float(np.nanmedian(np.abs(np.diff(v)))) for v in (before, after)]
    if min(map(abs, levels)) == 0 or min(noises) == 0 or levels[0] * levels[1] < 0:
        return None
    level, noise = levels[1] / levels[0], noises[1] / noises[0]
    if max(level, 1 / level) < MIN_RANGE_RATIO or abs(np.log(level / noise)) > 0.3 * abs(np.log(level)):
        return None
    return finding("re-ranged", {"sample": at, "factor": level, "share": at / values.size},
                   caps_verdict=True, factor=level, sample=at)
