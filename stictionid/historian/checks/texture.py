"""Tests of signals for compression, quantisation, clipping, swapped columns and a changed range.

Each test returns a finding with its share and its effect on S and J, or None.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...numerics.archived import EXCEPTION, LINES, archived, runs_of
from ...record.loop import Finding
from ...typing import FloatArray
from ..words.cells import shown
from ..words.findings import finding

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


def thinned(loop: Signals) -> list[Finding]:
    """Findings on PV and OP of which a historian kept some values only, with the deadband that shows."""
    found = []
    signals = (("process_value", "PV", loop.process_value, loop.output),
               ("output", "OP", loop.output, loop.process_value))
    for role, words, values, other in signals:
        way = archived(values, loop.starts, other)
        if way is None:
            continue
        code = "kept-by-exception" if way.way == EXCEPTION else "compressed"
        unless = (", unless the law of the controller gives them back" if role == "output" else
                  "; a fit counts only the values that were kept" if way.way == LINES else "")
        found.append(finding(code, {"role": role, "share": way.share, "deadband": way.deadband}, signal=words,
                             share=100 * way.share, deadband=way.deadband, unless=unless))
    return found


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
        first, end = runs_of(values == limit)
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
