"""Pictures as files: SVG by the house's own renderer, PNG by matplotlib (which only this file loads).

Same picture, same bytes: no dates, no random ids, the Agg backend and the fonts that matplotlib ships.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from . import axes, palette, svg
from .picture import Panel, Picture

PNG_KIND = b"\x89PNG"
# Resolution and size of a PNG. Unit: dots per inch, inches; 1,200 px across a page.
_DPI = 130
_WIDE, _SQUARE = 9.2, 5.2


def figure_bytes(picture: Picture, kind: str) -> bytes:
    """The picture as a file of `kind` "svg" or "png"."""
    return svg.standalone(picture) if kind == "svg" else _png(picture)


def _png(picture: Picture) -> bytes:
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    settings = {"font.family": "DejaVu Sans", "font.size": 8.5, "svg.hashsalt": "stictionid",
                "text.usetex": False, "axes.formatter.use_mathtext": False, "text.parse_math": False,
                "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": 9.5}
    with rc_context(settings):
        named = max((len(p.names) for p in picture.panels), default=0)
        height = 1.1 + 0.3 * named if named else 2.4 * len(picture.panels) if picture.wide else 4.4
        figure = Figure(figsize=(_WIDE if picture.wide else _SQUARE, height), dpi=_DPI, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(len(picture.panels), 1, sharex=len(picture.panels) > 1, squeeze=False,
                               height_ratios=[p.height for p in picture.panels])
        for axis, panel in zip(grid[:, 0], picture.panels, strict=True):
            _draw(axis, panel)
        grid[0, 0].set_title(_text(picture.title), loc="left")
        out = io.BytesIO()
        figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def _text(text: str) -> str:
    """Text without characters the drawing library would stumble over."""
    return "".join(c for c in text if c.isprintable())


def _draw(axis: Any, panel: Panel) -> None:
    for band in panel.bands:
        look = palette.FAILING if band.role == "failing" else palette.UNUSED
        axis.axvspan(band.start, band.end, color=look.light, hatch=None if band.role == "failing" else "///",
                     linewidth=0, zorder=0)
    if panel.cells is not None:
        _cells(axis, panel)
    for rule in panel.rules:
        _rule(axis, rule)
    named: set[str] = set()
    for line in panel.lines:
        _line(axis, line, "" if line.name in named else line.name)
        named.add(line.name)
    for box in panel.boxes:
        axis.plot([box.x0, box.x1, box.x1, box.x0, box.x0], [box.y0, box.y0, box.y1, box.y1, box.y0],
                  color=palette.LOOKS["mark"].light, linewidth=1, label=_text(box.label))
    for mark in panel.marks:
        look = palette.LOOKS[mark.role]
        axis.plot([mark.x], [mark.y], "o" if mark.role == "search" else "+", color=look.light, linestyle="",
                  markersize=4 if mark.role == "search" else 11, markeredgewidth=1 if mark.role == "search" else 2.2,
                  markerfacecolor="none", label=_text(mark.label) or None)
    axis.set_xlabel(_text(panel.x_label))
    axis.set_ylabel(_text(panel.y_label))
    if panel.log_x:
        axis.set_xscale("log")
        # Plain numbers: text is drawn without maths, so that tag names can't be taken for formulas.
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.xaxis.set_minor_formatter(lambda value, _: "")
    if panel.names:
        axis.set_yticks(range(len(panel.names)), [_text(n) for n in panel.names])
        axis.set_ylim(len(panel.names) - 0.4, -0.6)
    if panel.cells is None:
        axis.grid(True, color=palette.GRID.light, linewidth=0.6)
        axis.set_axisbelow(True)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=5, frameon=False, fontsize=7.5,
                    borderaxespad=0.1) if not axis.get_title(loc="left") and axis.get_subplotspec().rowspan.start \
            else axis.legend(loc="best", fontsize=7.5, framealpha=0.9)


def _line(axis: Any, line: Any, label: str) -> None:
    look = palette.LOOKS[line.role]
    dash = (0, look.dash) if look.dash else "-"
    name = _text(label) or None
    if line.style == "bars":
        axis.barh(line.y, line.x, height=0.5, color=look.light, label=name)
    elif line.style == "points":
        axis.plot(line.x, line.y, "o", color=look.light, markersize=4, label=name)
    elif line.style == "stems":
        axis.vlines(line.x, 0.0, line.y, color=look.light, linewidth=0.9, label=name)
    else:
        axis.plot(line.x, line.y, color=look.light, linewidth=0.8 * look.width, linestyle=dash, label=name)
        if line.style == "arrows":
            _arrows(axis, line, look.light)


def _arrows(axis: Any, line: Any, colour: str) -> None:
    """About a dozen arrow heads along a curve."""
    good = np.flatnonzero(np.isfinite(line.x) & np.isfinite(line.y))
    if good.size < 2:
        return
    x, y = line.x[good], line.y[good]
    walked = np.cumsum(np.hypot(np.diff(x) / (np.ptp(x) or 1.0), np.diff(y) / (np.ptp(y) or 1.0)))
    for k in np.unique(np.searchsorted(walked, np.linspace(0, walked[-1], 26)[1:-1:2])):
        axis.annotate("", xy=(x[k + 1], y[k + 1]), xytext=(x[k], y[k]),
                      arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 0, "mutation_scale": 9})


def _rule(axis: Any, rule: Any) -> None:
    look = palette.LOOKS[rule.role]
    draw = axis.axvline if rule.axis == "x" else axis.axhline
    draw(rule.value, color=look.light, linewidth=0.9, linestyle=(0, look.dash) if look.dash else "-", zorder=1)
    if rule.label and rule.axis == "x":
        axis.annotate(_text(rule.label), (rule.value, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -9),
                      textcoords="offset points", fontsize=7, color=look.light)
    elif rule.label:
        axis.annotate(_text(rule.label), (1.0, rule.value), xycoords=("axes fraction", "data"), xytext=(-2, 2),
                      textcoords="offset points", fontsize=7, color=look.light, ha="right")


def _cells(axis: Any, panel: Panel) -> None:
    from matplotlib.colors import ListedColormap

    cells = panel.cells
    assert cells is not None
    values = [v for row in cells.values for v in row if v is not None]
    if not values:
        return
    best, worst = min(values), max(values)
    classes = np.array([[np.nan if v is None else palette.map_class(v, best, worst) for v in row]
                        for row in cells.values])
    axis.pcolormesh(axes.edges(cells.x), axes.edges(cells.y), classes, cmap=ListedColormap(palette.MAP_LIGHT),
                    vmin=-0.5, vmax=len(palette.MAP_LIGHT) - 0.5, shading="flat", rasterized=True)
