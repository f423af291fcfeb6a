"""Limits, ticks and positions of a panel's axes; `draw` takes the limits only, matplotlib has its own ticks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...typing import FloatArray
from .picture import Panel

# Margin between the curves and the frame, as a share of the range.
_MARGIN = 0.04
# The same for a tree, on a logarithmic scale: a node needs room for its sign.
_TREE_MARGIN = 0.05


@dataclass(frozen=True, slots=True)
class Axis:
    """A map from numbers to pixels: `low`..`high` onto `start`..`end`, optionally logarithmic."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def at(self, values: FloatArray | float) -> FloatArray:
        """Pixel positions of `values`."""
        v = np.asarray(values, dtype=float)
        if self.log:
            low, high = math.log(self.low), math.log(self.high)
            v = np.log(np.maximum(v, 1e-300))
        else:
            low, high = self.low, self.high
        return self.start + (v - low) * ((self.end - self.start) / (high - low))


def limits(panel: Panel, axis: str) -> tuple[float, float]:
    """Smallest and largest number of a panel along "x" or "y", with a margin where curves would touch the frame."""
    if panel.branches:
        return _tree_limits(panel, axis)
    values: list[float] = []
    for line in panel.lines:
        data = line.x if axis == "x" else line.y
        good = data[np.isfinite(data)]
        if good.size:
            values += [float(good.min()), float(good.max())]
        if line.style in ("bars", "stems") and axis == ("x" if line.style == "bars" else "y"):
            values.append(0.0)
    values += [m.x if axis == "x" else m.y for m in panel.marks]
    values += [r.value for r in panel.rules if r.axis == axis and not (axis == "x" and panel.log_x)]
    values += [panel.x_to] if axis == "x" and panel.x_to is not None else []
    for b in panel.boxes:
        values += [b.x0, b.x1] if axis == "x" else [b.y0, b.y1]
    if panel.cells is not None:
        low, high = edges(panel.cells.x if axis == "x" else panel.cells.y)[[0, -1]]
        return float(low), float(high)
    if axis == "y" and panel.names:
        return len(panel.names) - 0.4, -0.6
    values = [v for v in values if math.isfinite(v)]
    if not values:
        return 0.0, 1.0
    low, high = min(values), max(values)
    if axis == "x" and panel.log_x:
        return (low, high) if high > low > 0 else (max(low, 1e-9) / 2, max(low, 1e-9) * 2)
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-30):
        room = max(abs(low), 1.0) * 0.05
        return low - room, high + room
    room = _MARGIN * (high - low)
    spread = ("arrows", "bars", "dots", "points")
    is_time = axis == "x" and not panel.names and not any(line.style in spread for line in panel.lines)
    if is_time:
        return low, high
    if any(line.style == "bars" for line in panel.lines):
        return (low if low == 0 else low - room), high + 4 * room
    return low - room, high + room


def _tree_limits(panel: Panel, axis: str) -> tuple[float, float]:
    """Limits of a tree: its rows from the top down, or its nodes and rules with a margin on a logarithmic scale."""
    if axis == "y":
        return len(panel.branches) - 0.4, -0.6
    values = [b.x for b in panel.branches] + [r.value for r in panel.rules if r.axis == "x"]
    good = [v for v in values if math.isfinite(v) and v > 0]
    low, high = (min(good), max(good)) if good else (1.0, 1.0)
    room = max((high / low) ** _TREE_MARGIN, 1.0 + _TREE_MARGIN)
    return low / room, high * room


def edges(centres: tuple[float, ...]) -> FloatArray:
    """Edges (k+1,) of cells with the given centres (k,)."""
    c = np.asarray(centres, dtype=float)
    if c.size == 1:
        return np.array([c[0] - 0.5, c[0] + 0.5])
    middle = (c[1:] + c[:-1]) / 2
    return np.concatenate(([2 * c[0] - middle[0]], middle, [2 * c[-1] - middle[-1]]))


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers between `low` and `high`, at most `most` of them (1, 2 or 5 times a power of ten apart)."""
    low, high = min(low, high), max(low, high)
    rough = (high - low) / max(most, 1)
    if rough <= 0 or not math.isfinite(rough):
        return [low]
    power = 10.0 ** math.floor(math.log10(rough))
    for m in (1, 2, 5, 10, 20):
        step = m * power
        first = math.ceil(low / step - 1e-9)
        last = math.floor(high / step + 1e-9)
        if last - first < most:
            return [k * step for k in range(first, last + 1)]
    return [low]


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2, 5 times powers of ten between `low` and `high`; only the powers where there are many.

    Where there is none or one of them, round numbers as on a scale that is not logarithmic.
    """
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    found = [m * 10.0 ** d for d in decades for m in (1, 2, 5) if low <= m * 10.0 ** d <= high]
    if len(found) < 2:
        return ticks(low, high, 4)
    return found if len(found) <= 7 else [v for v in found if math.log10(v) % 1 < 1e-9 or math.log10(v) % 1 > 1 - 1e-9]


def tick_text(value: float, step: float) -> str:
    """A tick's number with as many decimals as the distance of the ticks needs."""
    if value == 0:
        return "0"
    if abs(value) >= 1e6 or abs(step) < 1e-5:
        return f"{value:.3g}"
    return f"{value:.{max(0, -math.floor(math.log10(abs(step)) + 1e-9))}f}"
