"""Content of a picture before any drawing: panels of lines, bands, marks and cells, all of them numbers.

The picture modules fill these classes. The renderers only draw them, and the JSON report writes them out, so that
everything in a picture exists as numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...typing import FloatArray


@dataclass(frozen=True, slots=True)
class Line:
    """A curve or a scatter of points; `role` picks colour and dash the same way in every picture.

    `x` and `y` have shape (k,), NaN breaks the line. `style` is "line", "points", "dots" (small points), "bars",
    "stems" or "arrows" (a line with arrow heads along it).
    """

    name: str
    role: str
    x: FloatArray
    y: FloatArray
    style: str = "line"


@dataclass(frozen=True, slots=True)
class Band:
    """A shaded stretch of the x axis; `role` is "failing" or "unused"."""

    start: float
    end: float
    role: str


@dataclass(frozen=True, slots=True)
class Mark:
    """A labelled point."""

    x: float
    y: float
    label: str
    role: str = "mark"


@dataclass(frozen=True, slots=True)
class Rule:
    """A straight line across the panel at a value of "x" or "y"."""

    axis: str
    value: float
    label: str = ""
    role: str = "rule"


@dataclass(frozen=True, slots=True)
class Box:
    """A labelled rectangle, for intervals of two numbers."""

    x0: float
    x1: float
    y0: float
    y1: float
    label: str


@dataclass(frozen=True, slots=True)
class Cells:
    """A map of values (rows of y, columns of x); `x` and `y` are cell centres. `unit` belongs to the values."""

    x: tuple[float, ...]
    y: tuple[float, ...]
    values: tuple[tuple[float | None, ...], ...]
    label: str
    unit: str


@dataclass(frozen=True, slots=True)
class Branch:
    """One node of a tree at `x`, `row`, joined to its parent at `from_x`, `from_row`; both pairs are equal for a root.

    `label` stands at the edge, `note` holds more words about the node. `role` picks the look, `kind` names it.
    """

    from_x: float
    from_row: int
    x: float
    row: int
    label: str
    note: str
    role: str
    kind: str


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes; `height` is its share among the picture's panels, `names` stand at rows of the y axis.

    `x_to` is a value that the x axis reaches at least. A panel with `branches` has one row for each of them, from the
    top down, and no scale of y.
    """

    x_label: str
    y_label: str
    lines: tuple[Line, ...] = ()
    bands: tuple[Band, ...] = ()
    marks: tuple[Mark, ...] = ()
    rules: tuple[Rule, ...] = ()
    boxes: tuple[Box, ...] = ()
    cells: Cells | None = None
    log_x: bool = False
    height: float = 1.0
    names: tuple[str, ...] = ()
    branches: tuple[Branch, ...] = ()
    x_to: float | None = None


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure: `alt` states its finding for readers who cannot see it, `caption` says what is drawn."""

    key: str
    title: str
    alt: str
    caption: str
    panels: tuple[Panel, ...]
    wide: bool = False
