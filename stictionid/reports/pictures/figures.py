"""Pictures as files: SVG by the house's own renderer, PNG by drawing that very SVG with matplotlib.

So there is one layout, and a picture looks the same in either kind. Same picture, same bytes: no dates, no random ids,
the Agg backend and the font that matplotlib ships. Only this file and valve_figure.py load matplotlib.
"""

from __future__ import annotations

import io
import re
from typing import Any
from xml.etree import ElementTree

from . import palette, svg
from .picture import Picture

PNG_KIND = b"\x89PNG"
# Pixels of the PNG per px of the drawing, and points per inch (so that one px of the drawing is one point). Unit: 1.
_SCALE, _POINTS = 1.5, 72
_TOKEN = re.compile(r"[A-Za-z]|-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_PLACE = re.compile(r"translate\((\S+) (\S+)\) rotate\((\S+)\)")
_ALIGN = {"middle": "center", "end": "right"}


def figure_bytes(picture: Picture, kind: str) -> bytes:
    """The picture as a file of `kind` "svg" or "png"."""
    drawn = svg.standalone(picture)
    return drawn if kind == "svg" else _png(drawn)


def _png(drawn: bytes) -> bytes:
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    root = ElementTree.fromstring(drawn)
    width, height = float(root.get("width", "1")), float(root.get("height", "1"))
    # Text without maths, so that tag names can't be taken for formulas.
    settings: Any = {"font.family": "DejaVu Sans", "text.usetex": False, "text.parse_math": False,
                     "hatch.linewidth": 1.5, "path.simplify": False}
    with rc_context(settings):
        figure = Figure(figsize=(width / _POINTS, height / _POINTS), dpi=_POINTS * _SCALE,
                        facecolor=palette.GROUND.light)
        FigureCanvasAgg(figure)
        axis = figure.add_axes((0, 0, 1, 1))
        axis.set_axis_off()
        axis.set_xlim(0, width)
        axis.set_ylim(height, 0)
        _Drawing(axis).draw(root, None)
        out = io.BytesIO()
        figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


class _Drawing:
    """The elements that svg.py writes, put on axes whose data are the drawing's px; anything else is left out."""

    def __init__(self, axis: Any) -> None:
        self.axis = axis
        self.clips: dict[str | None, ElementTree.Element] = {}

    def draw(self, parent: ElementTree.Element, clip: Any) -> None:
        """Every child of `parent`, in order, inside `clip`."""
        for element in parent:
            kind = element.tag.rpartition("}")[2]
            if kind == "clipPath":
                self.clips[element.get("id")] = element[0]
            elif kind == "g":
                name = element.get("clip-path", "").removeprefix("url(#").removesuffix(")")
                self.draw(element, self.clips.get(name, clip))
            elif kind in ("rect", "circle", "path") and element.get("class"):
                self._shape(kind, element, clip)
            elif kind == "text":
                self._text(element)

    def _shape(self, kind: str, element: ElementTree.Element, clip: Any) -> None:
        from matplotlib.patches import Circle, PathPatch, Rectangle

        look = _look(element.get("class", ""))
        shape: Any
        if kind == "rect":
            shape = Rectangle(*_box(element), **look)
        elif kind == "circle":
            shape = Circle((_number(element, "cx"), _number(element, "cy")), _number(element, "r"), **look)
        else:
            found = _path(element.get("d", ""))
            if found is None:
                return
            shape = PathPatch(found, **look)
        self.axis.add_patch(shape)
        if clip is not None:
            shape.set_clip_path(Rectangle(*_box(clip), transform=self.axis.transData))
        shape.set_zorder(len(self.axis.patches) + len(self.axis.texts))

    def _text(self, element: ElementTree.Element) -> None:
        x, y, turn = _number(element, "x"), _number(element, "y"), 0.0
        placed = _PLACE.match(element.get("transform", ""))
        if placed:
            x, y, turn = map(float, placed.groups())
        text = "".join(c for c in element.text or "" if c.isprintable())
        self.axis.text(x, y, text, fontsize=svg.TEXT, rotation=-turn, rotation_mode="anchor", va="baseline",
                       ha=_ALIGN.get(element.get("text-anchor", ""), "left"), color=palette.INK.light,
                       zorder=len(self.axis.patches) + len(self.axis.texts))


def _number(element: ElementTree.Element, name: str) -> float:
    return float(element.get(name, "0"))


def _box(element: ElementTree.Element) -> tuple[tuple[float, float], float, float]:
    return (_number(element, "x"), _number(element, "y")), _number(element, "width"), _number(element, "height")


def _look(name: str) -> dict[str, Any]:
    """What a style class means to matplotlib; the twin of svg.style on light ground."""
    kind, _, role = name.partition("-")
    if kind == "r":
        look = palette.LOOKS[role]
        return {"fill": False, "edgecolor": look.light, "linewidth": look.width, "capstyle": "butt",
                "linestyle": (0, tuple(d / look.width for d in look.dash)) if look.dash else "-"}
    if kind == "f":
        return {"facecolor": palette.LOOKS[role].light, "linewidth": 0}
    if name == "under":
        return {"fill": False, "edgecolor": palette.GROUND.light, "linewidth": 5.0}
    if name == "grid":
        return {"fill": False, "edgecolor": palette.GRID.light, "linewidth": 1.0}
    if name == "frame":
        return {"fill": False, "edgecolor": palette.SOFT_INK.light, "linewidth": 1.0}
    if name == "b-unused":
        return {"fill": False, "edgecolor": palette.UNUSED.light, "hatch": "//", "linewidth": 0}
    if kind == "b":
        return {"facecolor": palette.FAILING.light, "linewidth": 0}
    return {"facecolor": palette.MAP_LIGHT[int(name.removeprefix("m"))], "linewidth": 0}


def _path(text: str) -> Any:
    """A path of M, L, H, V, h, v, l and Z as matplotlib's; None for an empty one."""
    from matplotlib.path import Path

    tokens = _TOKEN.findall(text)
    points: list[tuple[float, float]] = []
    codes: list[int] = []
    x = y = 0.0
    i = 0
    command = ""
    while i < len(tokens):
        if tokens[i].isalpha():
            command, i = tokens[i], i + 1
            if command == "Z":
                points.append((x, y))
                codes.append(int(Path.CLOSEPOLY))
                continue
        count = 1 if command in "HVhv" else 2
        values = [float(t) for t in tokens[i:i + count]]
        i += count
        if command in "ML":
            x, y = values
        elif command == "l":
            x, y = x + values[0], y + values[1]
        elif command in "Hh":
            x = values[0] + (x if command == "h" else 0.0)
        else:
            y = values[0] + (y if command == "v" else 0.0)
        points.append((x, y))
        codes.append(int(Path.MOVETO if command == "M" else Path.LINETO))
    return Path(points, codes) if points else None
