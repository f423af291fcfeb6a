"""Pictures as files, and on the axes of a caller: `draw` shows a picture's numbers with matplotlib, styled as the SVG.

The Agg backend and the font that matplotlib ships give the same bytes for the same picture. Only this file and
valve_bench.py load matplotlib.
"""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from .. import wording
from . import axes, palette, svg
from .axes import Axis
from .legend import BAND_NAMES, BETWEEN, RULE_ROW, SAMPLE, entries, rule_places
from .picture import Branch, Cells, Line, Panel, Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PNG_KIND = b"\x89PNG"
# Pixels of the PNG per px of the drawing, and px per inch (so that one px of the drawing is one point). Unit: 1.
_SCALE, _POINTS = 1.5, 72
# Height that a panel's names and labels take. Unit: px.
_ROOM = 74
# Gap between panels without a layout engine. Unit: their mean height.
_BETWEEN_PANELS = 0.6
# Mean width of a character. Unit: font size.
_CHARACTER = svg.CHARACTER / svg.TEXT
# Text without maths, so that tag names can't be taken for formulas.
_PLAIN: dict[str, Any] = {"parse_math": False, "usetex": False}
_HEAD = "-|>,head_length=9,head_width=4"
_MARKS = {"search": ("o", 6), "last": ("x", 16)}


def figure_bytes(picture: Picture, kind: str) -> bytes:
    """The picture as a file of `kind` "svg" or "png"."""
    return svg.standalone(picture) if kind == "svg" else _png(picture)


def _png(picture: Picture) -> bytes:
    from matplotlib import rc_context

    with rc_context({"font.family": "DejaVu Sans", "font.size": svg.TEXT, "hatch.linewidth": 1.5}):
        axes_of = new_axes(picture)
        draw(picture, axes_of)
        out = io.BytesIO()
        cast("Figure", axes_of.figure).savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def new_axes(picture: Picture) -> Axes:
    """Empty axes in a figure of the picture's size, which pyplot does not know."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    width = svg.WIDE if picture.wide else svg.SQUARE
    height = sum(svg.heights(picture, width)) + _ROOM * len(picture.panels)
    return Figure(figsize=(width / _POINTS, height / _POINTS), dpi=_POINTS * _SCALE, facecolor=palette.GROUND.light,
                  layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.1)).subplots()


def draw(picture: Picture, ax: Axes) -> Axes:
    """Draw `picture` on `ax` in the numbers and units of its data, and return `ax`.

    A picture of several panels shares the place of `ax` out: `ax` keeps the first panel, each further one gets axes of
    its own below. Colours are those on light ground; sizes of text are the caller's.
    """
    for panel, one in zip(picture.panels, _shared_out(ax, picture.panels), strict=True):
        _panel(panel, one)
    return ax


def _shared_out(ax: Axes, panels: tuple[Panel, ...]) -> list[Axes]:
    """Axes of each panel, from the top down, in the place of `ax`."""
    from matplotlib.gridspec import GridSpec

    if len(panels) == 1:
        return [ax]
    at, figure = ax.get_position(), cast("Figure", ax.figure)
    place = ax.get_subplotspec() or GridSpec(1, 1, figure, left=at.x0, right=at.x1, bottom=at.y0, top=at.y1)[0]
    # A layout engine makes room for the names between the panels by itself.
    grid = place.subgridspec(len(panels), 1, height_ratios=[p.height for p in panels],
                             hspace=None if figure.get_layout_engine() else _BETWEEN_PANELS)
    ax.set_subplotspec(grid[0])
    return [ax, *(figure.add_subplot(grid[k], sharex=ax) for k in range(1, len(panels)))]


def _panel(panel: Panel, ax: Axes) -> None:
    from matplotlib.patches import Rectangle

    _scales(panel, ax)
    for band in panel.bands:
        look: dict[str, Any] = {"facecolor": "none", "edgecolor": palette.UNUSED.light, "hatch": "//"}
        if band.role == "failing":
            look = {"color": palette.FAILING.light}
        ax.axvspan(band.start, band.end, zorder=0.4, linewidth=1.5, label=dict(BAND_NAMES)[band.role], **look)
    for rule in panel.rules:
        across = ax.axvline if rule.axis == "x" else ax.axhline
        across(rule.value, label=rule.label if rule.axis == "y" else "", zorder=1.6, **_look(rule.role))
    for line in panel.lines:
        _line(line, ax)
    for branch in reversed(panel.branches):
        _branch(branch, ax)
    for b in panel.boxes:
        ax.add_patch(Rectangle((b.x0, b.y0), b.x1 - b.x0, b.y1 - b.y0, fill=False, label=b.label, zorder=3,
                               edgecolor=palette.LOOKS["mark"].light, linewidth=palette.LOOKS["mark"].width))
    for m in panel.marks:
        _mark(m.x, m.y, m.role, m.label, ax)
    _words(panel, ax)
    if panel.cells is not None:
        _cells(panel.cells, ax)


def _scales(panel: Panel, ax: Axes) -> None:
    """Limits, ticks, grid, frame and names of the axes."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

    ax.set_facecolor(palette.GROUND.light)
    ax.set_axisbelow(True)
    ax.ticklabel_format(useOffset=False)
    if panel.log_x:
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(FixedLocator(axes.log_ticks(*axes.limits(panel, "x"))) if panel.branches
                                   else LogLocator(subs=(1, 2, 5)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_locator(NullLocator())
    if panel.names:
        ax.set_yticks(range(len(panel.names)), [wording.clean(n, wording.LONGEST_NAME // 2) for n in panel.names],
                      **_PLAIN)
    if panel.branches:
        ax.set_yticks([])
    ax.set_xlim(*axes.limits(panel, "x"))
    ax.set_ylim(*axes.limits(panel, "y"))
    if panel.cells is None:
        ax.grid(axis="x" if panel.names else "both", color=palette.GRID.light, linewidth=1.0)
    ax.tick_params(length=0, labelcolor=palette.INK.light, labelbottom=bool(panel.x_label))
    ax.spines[:].set(edgecolor=palette.SOFT_INK.light, linewidth=1.0)


def _look(role: str) -> dict[str, Any]:
    """Colour, width and dash of a role's lines; the twin of svg.style on light ground."""
    look = palette.LOOKS[role]
    return {"color": look.light, "linewidth": look.width,
            "linestyle": (0, tuple(d / look.width for d in look.dash)) if look.dash else "-"}


def _line(line: Line, ax: Axes) -> None:
    colour = palette.LOOKS[line.role].light
    if line.style == "points":
        ax.plot(line.x, line.y, "o", color=colour, markersize=8, markeredgewidth=0, label=line.name, zorder=2.5)
    elif line.style == "dots":
        ax.plot(line.x, line.y, "o", color=colour, markersize=3.6, markeredgewidth=0, label=line.name, zorder=2.2)
    elif line.style == "bars":
        ax.barh(line.y, line.x, 0.45, color=colour, label=line.name, zorder=2)
    elif line.style == "stems":
        ax.vlines(line.x, 0.0, line.y, label=line.name, **_look(line.role))
    else:
        ax.plot(line.x, line.y, label=line.name, **_look(line.role))
    if line.style == "arrows":
        _arrows(line, ax)


def _branch(branch: Branch, ax: Axes) -> None:
    """A node of a tree with the edge that leads to it, as svg.py draws it."""
    from matplotlib.patheffects import withStroke

    look, colour = _look(branch.role), palette.LOOKS[branch.role].light
    ax.plot([branch.from_x, branch.from_x, branch.x], [branch.from_row, branch.row, branch.row], **look, zorder=2)
    ax.plot([branch.x], [branch.row], "o", color=colour, markersize=10, markeredgewidth=0, zorder=3)
    # The legend's sample is both at once.
    ax.plot([], [], marker="o", **look, markersize=8, markeredgewidth=0, label=branch.kind)
    per_px = ax.figure.dpi / _POINTS
    size = _CHARACTER * float(ax.xaxis.label.get_fontsize()) * len(branch.label)
    start, end = (float(ax.transData.transform((v, branch.row))[0]) / per_px for v in (branch.from_x, branch.x))
    _, anchor, above = svg.branch_label(start, end, ax.bbox.x0 / per_px, size)
    beside = max(branch.x, branch.from_x) if anchor == "start" else min(branch.x, branch.from_x)
    offset = svg.BESIDE if anchor == "start" else -svg.BESIDE
    ax.annotate(wording.name(branch.label), (branch.x if above else beside, branch.row), (offset, 4 * above),
                textcoords="offset points", ha="left" if anchor == "start" else "right",
                va="bottom" if above else "center", color=(palette.SOFT_INK if branch.role == "guide"
                                                           else palette.INK).light, zorder=4, **_PLAIN,
                path_effects=[withStroke(linewidth=3, foreground=palette.GROUND.light)])


def _arrows(line: Line, ax: Axes) -> None:
    """Arrow heads along a curve, where the SVG has them at the present size of the axes."""
    from matplotlib.patches import FancyArrowPatch

    data = np.column_stack([line.x, line.y])
    data = data[np.isfinite(data).all(axis=1)]
    at = ax.transData.transform(data) * _POINTS / ax.figure.dpi
    for k in svg.arrow_places(at[:, 0], at[:, 1]):
        ax.add_patch(FancyArrowPatch(data[k], (data[k] + data[k + 1]) / 2, arrowstyle=_HEAD, zorder=3, mutation_scale=1,
                                     color=palette.LOOKS[line.role].light, linewidth=0, shrinkA=0, shrinkB=0))


def _mark(x: float, y: float, role: str, label: str, ax: Axes) -> None:
    """A point's sign, as legend.mark has it, on an edge of the ground's colour."""
    from matplotlib.patheffects import withStroke

    sign, size = _MARKS.get(role, ("+", 16))
    look = palette.LOOKS[role]
    ax.plot([x], [y], sign, color=look.light, markersize=size, markeredgewidth=look.width, fillstyle="none", zorder=4,
            label=label, path_effects=[withStroke(linewidth=look.width + 3, foreground=palette.GROUND.light)])


def _cells(cells: Cells, ax: Axes) -> None:
    """A map in the classes of the palette, with its scale at the side."""
    from matplotlib.colors import ListedColormap

    span = palette.map_span(cells.values)
    if span is None:
        return
    classes = [[math.nan if v is None else palette.map_class(v, *span) for v in row] for row in cells.values]
    mesh = ax.pcolormesh(axes.edges(cells.x), axes.edges(cells.y), classes, cmap=ListedColormap(palette.MAP_LIGHT),
                         vmin=-0.5, vmax=len(palette.MAP_LIGHT) - 0.5, zorder=0.2)
    bar = ax.figure.colorbar(mesh, ax=ax, ticks=[-0.5, len(palette.MAP_LIGHT) - 0.5])
    bar.set_ticklabels([wording.number(v) for v in span])
    bar.set_label(f"{cells.label}, {cells.unit}", labelpad=-12, color=palette.INK.light, **_PLAIN)
    bar.ax.tick_params(length=0, labelcolor=palette.INK.light)


def _words(panel: Panel, ax: Axes) -> None:
    """Labels of the axes; above the frame the labels of vertical rules, and above those the legend."""
    size = float(ax.xaxis.label.get_fontsize())
    character, per_px = _CHARACTER * size, ax.figure.dpi / _POINTS
    width, height = ax.bbox.width / per_px, ax.bbox.height / per_px
    # Beside long names the axis of x may be shorter than its label, which then runs to the left.
    ax.set_xlabel(wording.clean(panel.x_label, max(int(width / character), 6)), color=palette.INK.light, **_PLAIN,
                  loc="right" if panel.names else "center")
    ax.set_ylabel(wording.clean(panel.y_label, max(int(1.2 * height / character), 6)), color=palette.INK.light,
                  **_PLAIN)
    rows = 0
    for rule, at, start, row in rule_places(panel, Axis(*ax.get_xlim(), 0.0, width, panel.log_x), character):
        stalk = min(max((at - start) / (character * len(rule.label)), 0.0), 1.0), 0.0
        ax.annotate(wording.name(rule.label), (rule.value, 1.0), (start - at, 4 + RULE_ROW * row),
                    xycoords=ax.get_xaxis_transform(), textcoords="offset points", annotation_clip=True,
                    color=palette.INK.light, **_PLAIN,
                    arrowprops={"arrowstyle": "-", "relpos": stalk, "shrinkA": 0, "shrinkB": 0, **_look(rule.role)})
        rows = max(rows, row + 1)
    shown = {wording.name(label): handle for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    named = [name for name in dict.fromkeys(wording.name(e[0]) for e in entries(panel)) if name in shown]
    if not named:
        return
    sizes = [SAMPLE + BETWEEN + character * len(name) for name in named]
    legend = ax.legend([shown[name] for name in named], named, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderpad=0,
                       borderaxespad=(4 + RULE_ROW * rows) / size, frameon=False, labelcolor=palette.INK.light,
                       ncols=len(named) if sum(sizes) < width else max(int(width / max(sizes)), 1))
    for text in legend.get_texts():
        text.set(**_PLAIN)
