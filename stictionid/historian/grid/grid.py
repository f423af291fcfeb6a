"""Even grid from time stamps: the step, the tolerance for jitter, gaps that split, values that may be filled.

Held signals (OP, SP, mode) are filled forward; PV is interpolated over at most two missing samples. It stays missing in
a longer run, or where a slower tag is its source. Nothing is continued across a longer gap of OP.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...numerics.archived import runs_of
from ...typing import BoolArray, FloatArray, IntArray
from ..table.rows import CODE
from ..time.clock import SECOND

MAX_FILLED = 2
"""Missing PV samples that may be interpolated, in a row (docs/traps.md, export trap 12)."""
JITTER_TOLERANCE = 0.25
"""Largest deviation from the even grid that counts as jitter, share of the step; more is irregular."""
MIN_REGULAR_SHARE = 0.8
"""Share of steps that must fit multiples of the median step for a record to count as evenly sampled."""
MAX_SINGLE_STEP_SHARE = 0.9
"""Share of equal steps above which the others are missing rows, not the rounding of an uneven step."""
SPARSE_SHARE = 0.3
"""Share of empty cells beside OP from which PV comes from a slower tag, and no value of it is made up."""
MIN_SEGMENT = 10
"""Shortest stretch kept, samples: below that no dynamics can be seen in it."""


@dataclass(frozen=True, slots=True)
class GridStep:
    """The sampling step in ns, its `kind` (even, jitter, rounded, irregular) and `worst` deviation as a share of it."""

    ns: float
    kind: str
    worst: float = 0.0
    fitting: float = 1.0


@dataclass
class Frame:
    """Signals that share stamps: `ns` (n,) increasing; `values` (n,) per role, NaN where there is none.

    `rows` (n,) per source gives the file row behind a sample, -1 for none. `reason` (n,) is the code why a sample does
    not count. `on_change` names roles recorded on change. `offsets_s` are those of each role's stamps against PV, and
    OP is the slower one `thinned` times.
    """

    ns: IntArray
    values: dict[str, FloatArray]
    rows: list[IntArray]
    reason: NDArray[np.uint8] = field(init=False)
    starts: list[int] = field(default_factory=lambda: [0])
    offsets_s: dict[str, float] = field(default_factory=dict)
    on_change: set[str] = field(default_factory=set)
    thinned: int = 1

    def __post_init__(self) -> None:
        self.reason = np.zeros(self.ns.size, np.uint8)

    def take(self, index: IntArray | BoolArray) -> None:
        """Keep only the samples of `index`, in place."""
        self.ns = self.ns[index]
        self.values = {k: v[index] for k, v in self.values.items()}
        self.rows = [r[index] for r in self.rows]
        self.reason = self.reason[index]

    def breaks(self) -> BoolArray:
        """True (n,) at the first sample of each segment."""
        return np.isin(np.arange(self.ns.size), self.starts)


def find_step(ns: IntArray) -> GridStep:
    """The step of increasing stamps."""
    steps = np.diff(ns)
    low, high = int(steps.min()), int(steps.max())
    if low == high:
        return GridStep(float(low), "even")
    median = float(np.median(steps))
    rounded = _rounded_step(ns, steps)
    if rounded is not None:
        return rounded
    ratio = steps / median
    whole = np.rint(ratio)
    off = np.abs(ratio - whole)
    fits = (off <= JITTER_TOLERANCE) & (whole >= 1)
    ones = whole == 1
    worst = float(off[ones].max()) if ones.any() else 1.0
    fitting = float(fits.mean())
    if fitting < MIN_REGULAR_SHARE or ones.mean() < 0.5:
        return GridStep(median, "irregular", worst, fitting)
    if float(off.max()) < 1e-6:
        return GridStep(median, "even")
    return GridStep(float(steps[ones].mean()), "jitter", worst, fitting)


def _rounded_step(ns: IntArray, steps: IntArray) -> GridStep | None:
    """An even step whose stamps were rounded to whole seconds or milliseconds, or None."""
    resolution = next((r for r in (60 * SECOND, SECOND, SECOND // 1000, 1000) if not (steps % r).any()), 1)
    n = ns.size
    mean = float(ns[-1] - ns[0]) / (n - 1)
    if n < 10 or mean > 20 * resolution or resolution == 60 * SECOND:
        return None
    if np.mean(steps == np.median(steps)) > MAX_SINGLE_STEP_SHARE:
        return None
    deviation = (ns - ns[0]) - mean * np.arange(n)
    if float(deviation.max() - deviation.min()) > 1.5 * resolution:
        return None
    return GridStep(mean, "rounded", float(np.abs(steps - mean).max() / mean))


def place_on_grid(frame: Frame, step: GridStep) -> IntArray:
    """Put the samples on the grid: missing ones (at most two in a row) are inserted as NaN, longer gaps split.

    Returns the file-free positions (grid indices) of the samples; `frame` is changed in place.
    """
    if step.kind == "rounded":
        return np.arange(frame.ns.size)
    whole = np.rint(np.diff(frame.ns) / step.ns).astype(np.int64)
    keep = np.concatenate([[True], whole >= 1])
    if not keep.all():
        # Two samples within half a step: the later one has no position of its own on the grid.
        frame.reason[~keep & (frame.reason == 0)] = CODE["off grid"]
    return np.concatenate([[0], np.cumsum(np.maximum(whole, 0))])


def insert_missing(frame: Frame, place: IntArray) -> None:
    """Insert NaN samples where at most two are missing; note where longer gaps split the record."""
    jumps = np.diff(place)
    short = np.flatnonzero((jumps > 1) & (jumps <= MAX_FILLED + 1))
    long = np.flatnonzero(jumps > MAX_FILLED + 1) + 1
    if not short.size:
        frame.starts = [0, *(int(i) for i in long)]
        return
    at = np.repeat(short + 1, jumps[short] - 1)
    frame.values = {k: np.insert(v, at, np.nan) for k, v in frame.values.items()}
    frame.rows = [np.insert(r, at, -1) for r in frame.rows]
    frame.reason = np.insert(frame.reason, at, np.uint8(0))
    offset = np.concatenate([[0], np.cumsum(jumps[short] - 1)])
    step = (frame.ns[short + 1] - frame.ns[short]) // jumps[short]
    within = np.concatenate([np.arange(1, j) for j in jumps[short]])
    stamps = np.repeat(frame.ns[short], jumps[short] - 1) + within * np.repeat(step, jumps[short] - 1)
    frame.ns = np.insert(frame.ns, at, stamps)
    frame.starts = [0, *(int(i + offset[np.searchsorted(short, i - 1, side="right")]) for i in long)]


def long_runs(mask: BoolArray, least: int) -> BoolArray:
    """True (n,) where a mask is true for at least so many samples in a row."""
    first, end = runs_of(mask)
    found = mask.copy()
    found[mask] = np.repeat(end - first >= least, end - first)
    return found


def _stretches(frame: Frame, mask: BoolArray) -> IntArray:
    """Number (n,) of the stretch of each sample; one begins with each segment and each run of True."""
    return np.cumsum(frame.breaks() | (mask & ~np.concatenate([[False], mask[:-1]])))


def sparse(frame: Frame) -> bool:
    """True where PV is missing beside so many values of OP that it comes from a slower tag: it stays as it is."""
    beside = ~np.isnan(frame.values["output"])
    return bool(beside.any() and np.isnan(frame.values["process_value"][beside]).mean() > SPARSE_SHARE)


def driven(frame: Frame) -> BoolArray:
    """True (n,) where OP is there, from the first to the last PV of its stretch: the valve runs through missing PV."""
    there = ~np.isnan(frame.values["output"])
    stretch = _stretches(frame, there)
    measured = np.flatnonzero(there & ~np.isnan(frame.values["process_value"]))
    first, last = np.full(stretch[-1] + 1, there.size), np.full(stretch[-1] + 1, -1)
    np.minimum.at(first, stretch[measured], measured)
    np.maximum.at(last, stretch[measured], measured)
    at = np.arange(there.size)
    return np.asarray(there & (at >= first[stretch]) & (at <= last[stretch]))


def fill(frame: Frame, on_change: set[str]) -> BoolArray:
    """Fill missing values where that is allowed, in place; True (n,) where PV, OP or SP is filled and not measured.

    Roles in `on_change` are recorded only when they change: there an empty cell is the value before it, as measured.
    """
    filled = np.zeros(frame.ns.size, np.bool_)
    segment = np.cumsum(frame.breaks(), dtype=np.int64)
    for role, values in frame.values.items():
        missing = np.isnan(values)
        if not missing.any() or (role == "process_value" and sparse(frame)):
            continue
        if role in ("output", "setpoint", "mode"):
            limit = None if role in on_change or role != "output" else MAX_FILLED
            new = _hold(values, missing, segment, limit)
            if role in on_change:
                missing = np.isnan(new) & missing
        else:
            new = _interpolate(values, missing, segment)
        if role == "setpoint" and np.isnan(new).any() and not np.isnan(new).all():
            # Before its first record a setpoint is unknown: the next value takes its place, masked.
            new = _hold(new[::-1], np.isnan(new)[::-1], np.zeros(new.size, np.int64), None)[::-1]
        frame.values[role] = new
        if role in ("output", "setpoint", "process_value"):
            filled |= missing & ~np.isnan(new)
    return filled


def _hold(values: FloatArray, missing: BoolArray, segment: IntArray, limit: int | None) -> FloatArray:
    """Fill forward, not beyond a segment, at most `limit` samples."""
    last = np.maximum.accumulate(np.where(missing, -1, np.arange(values.size)))
    good = (last >= 0) & (segment[last] == segment)
    if limit is not None:
        good &= ~long_runs(missing, limit + 1)
    return np.where(missing & good, values[last], values)


def _interpolate(values: FloatArray, missing: BoolArray, segment: IntArray) -> FloatArray:
    """Straight lines over at most two missing samples between two measured ones of the same segment."""
    new = values.copy()
    first, end = runs_of(missing)
    for width in range(1, MAX_FILLED + 1):
        at = first[(end - first == width) & (first > 0) & (end < values.size)]
        at = at[segment[at - 1] == segment[at + width]]
        for i in range(width):
            share = (i + 1) / (width + 1)
            new[at + i] = (1 - share) * values[at - 1] + share * values[at + width]
    return new


def split(frame: Frame, valid: BoolArray) -> tuple[IntArray, list[int], int]:
    """Indices kept, segment starts among them, and number of stretches too short to keep."""
    ids = np.where(valid, _stretches(frame, valid), 0)
    sizes = np.bincount(ids, minlength=1)
    sizes[0] = 0
    enough = sizes >= min(MIN_SEGMENT, int(sizes.max(initial=0)))
    enough[0] = False
    keep = np.flatnonzero(enough[ids])
    starts = [0, *(int(i) + 1 for i in np.flatnonzero(np.diff(ids[keep])))] if keep.size else []
    return keep, starts, int(np.count_nonzero((sizes > 0) & ~enough))
