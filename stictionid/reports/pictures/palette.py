"""Colour, dash and width of each role, the same in every picture and renderer, light and dark.

Colours keep 4.5:1 against their ground and stay apart for the usual colour blindnesses. Every role also has its own
dash or marker, so that colour is never the only carrier.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Look:
    """Look of one role: colours on light and dark ground, dash pattern and line width in px."""

    light: str
    dark: str
    dash: tuple[float, ...] = ()
    width: float = 1.4


LOOKS = {
    "sp": Look("#454f5b", "#c3ccd6", (7, 3)),
    "pv": Look("#1358a8", "#7cb7f5"),
    "op": Look("#9a4a00", "#f2a65a"),
    "model": Look("#a0206e", "#f28cc8", (4, 2), 1.6),
    "position": Look("#0b6e5c", "#5fd0b8", (2, 2)),
    "residual": Look("#4a5563", "#b4bfca"),
    "guide": Look("#5c6670", "#a3aeb9", (5, 4), 1.0),
    "rule": Look("#8b949e", "#7d8894", (), 0.8),
    "bound": Look("#6b4fa0", "#b9a3ea", (3, 3), 1.0),
    "optimum": Look("#a0206e", "#f28cc8", (), 2.2),
    "last": Look("#7a3b00", "#ffc27d", (), 2.2),
    "search": Look("#111820", "#ffffff", (), 1.0),
    "mark": Look("#1b2127", "#e6eaee", (), 1.4),
}
INK = Look("#1b2127", "#e6eaee")
SOFT_INK = Look("#4a5560", "#aab4be")
GRID = Look("#e3e7eb", "#2b333c")
GROUND = Look("#ffffff", "#14191f")
FAILING = Look("#f6d5a8", "#5c3d12")
UNUSED = Look("#d5dae0", "#39424c")

# Classes of a cost map from best to worst, on light and dark ground (one hue, lightness only).
MAP_LIGHT = ("#0b2f57", "#164a80", "#2a669f", "#4a83b8", "#719fcb", "#9abbdc", "#bfd4e9", "#dde8f3", "#f0f5fa")
MAP_DARK = ("#e4f0ff", "#b9d7f5", "#8fbce8", "#689fd6", "#4a82bb", "#35689c", "#274f7a", "#1e3b5b", "#182b41")


def map_span(values: tuple[tuple[float | None, ...], ...]) -> tuple[float, float] | None:
    """Smallest and largest value of a cost map; None where it has none."""
    known = [v for row in values for v in row if v is not None]
    return (min(known), max(known)) if known else None


def map_class(value: float, best: float, worst: float) -> int:
    """Class of a cost: equal steps of its logarithm between the best and the worst of the map."""
    if best <= 0 or worst <= best:
        return 0
    share = math.log(max(value, best) / best) / math.log(worst / best)
    return min(int(share * len(MAP_LIGHT)), len(MAP_LIGHT) - 1)
