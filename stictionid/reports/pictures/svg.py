"""Pictures as SVG, inline in a page or as files: small, deterministic, light and dark by style sheet.

This file only draws; the numbers come from the picture modules. Text is real text, so it can be searched, translated
and read aloud.
"""

from __future__ import annotations

from html import escape
from itertools import groupby

import numpy as np

from ...typing import FloatArray
from .. import wording
from . import axes, palette
from . import legend as names
from .axes import Axis
from .picture import Band, Branch, Cells, Line, Panel, Picture, Rule

# Sizes in px of the drawing's own grid. A wide picture fills a page, a square one half of it or a phone. On A4 less
# 10 mm at each side, 718 px, text of TEXT px is 11 px or more in both.
WIDE, SQUARE, SMALL = 780, 380, 300
_HEIGHT_WIDE, _HEIGHT_SQUARE = 230, 350
_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP = 62, 14, 12, 40, 16
# Size of all text. Unit: px.
TEXT = 12.5
# Mean width of a character at TEXT size. Unit: px; for legends and margins, measured on DejaVu Sans, a wide font.
CHARACTER = 7.3
# Distance of arrow heads along a curve. Unit: px.
_ARROW_EVERY = 95.0
# Most of a picture's width for names of bars, as a share; longer names are cut in the middle.
_WIDEST_NAMES = 0.5
# Height of one row of names or of a tree, and of the rest of such a frame. Unit: px.
_ROW, _BESIDE_ROWS = 26, 46
# Distance of a label from the middle of its node. Unit: px.
BESIDE = 9
SVG_KIND = b"<!-- stictionid figure -->"


def style(selector: str = "") -> str:
    """Style rules for inline pictures under `selector`, from CSS variables the page defines."""
    rules = []
    for role, look in palette.LOOKS.items():
        dash = f"stroke-dasharray:{' '.join(map(str, look.dash))};" if look.dash else ""
        rules.append(f"{selector} .r-{role}{{stroke:var(--{role});stroke-width:{look.width};{dash}fill:none}}")
        rules.append(f"{selector} .f-{role}{{fill:var(--{role});stroke:none}}")
    rules += [f"{selector} text{{fill:var(--ink);font:{TEXT}px system-ui,-apple-system,'Segoe UI',Arial,sans-serif}}",
              f"{selector} .grid{{stroke:var(--grid);stroke-width:1}}",
              f"{selector} .under{{stroke:var(--ground);stroke-width:5px;fill:none}}",
              f"{selector} .soft{{fill:var(--soft)}}", f"{selector} .strong{{font-weight:650}}",
              f"{selector} .halo{{stroke:var(--ground);stroke-width:4px;stroke-linejoin:round;paint-order:stroke}}",
              f"{selector} .frame{{stroke:var(--soft);stroke-width:1;fill:none}}",
              f"{selector} .b-failing{{fill:var(--failing)}}", f"{selector} .b-unused{{fill:url(#hatch)}}",
              f"{selector} .hatch{{stroke:var(--unused);stroke-width:4}}",
              f"{selector} .dots{{stroke-width:3.6px;stroke-linecap:round;stroke-dasharray:none}}",
              *(f"{selector} .m{i}{{fill:var(--map{i})}}" for i in range(len(palette.MAP_LIGHT)))]
    return "\n".join(rules)


def variables(dark: bool) -> str:
    """CSS variables of the palette."""
    looks = {**palette.LOOKS, "ink": palette.INK, "soft": palette.SOFT_INK, "grid": palette.GRID,
             "ground": palette.GROUND, "failing": palette.FAILING, "unused": palette.UNUSED}
    values = [f"--{role}:{look.dark if dark else look.light}" for role, look in looks.items()]
    values += [f"--map{i}:{c}" for i, c in enumerate(palette.MAP_DARK if dark else palette.MAP_LIGHT)]
    return ";".join(values)


def standalone(picture: Picture) -> bytes:
    """The picture as an SVG file with its own style, for light and dark readers."""
    width = WIDE if picture.wide else SQUARE
    body, height = _body(picture, width, "p")
    css = (f"svg{{{variables(False)}}}\n@media (prefers-color-scheme:dark){{svg{{{variables(True)}}}}}\n{style()}")
    text = (f'{SVG_KIND.decode()}\n<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'width="{width}" height="{height}" role="img" aria-labelledby="t d">'
            f'<title id="t">{_safe(picture.title)}</title><desc id="d">{_safe(picture.alt)}</desc>'
            f"<style>{css}</style>{HATCH}"
            f'<rect width="{width}" height="{height}" style="fill:var(--ground)"/>{body}</svg>\n')
    return text.encode("utf-8")


HATCH = ('<defs><pattern id="hatch" width="8" height="8" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
         '<line class="hatch" x1="0" y1="0" x2="0" y2="8"/></pattern></defs>')


def inline(picture: Picture, prefix: str, *, narrow: bool = False, small: bool = False) -> str:
    """The picture as an <svg> element; `prefix` keeps its ids apart from other pictures on the page."""
    width = SMALL if small else WIDE if picture.wide and not narrow else SQUARE
    body, height = _body(picture, width, prefix)
    return (f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{_safe(picture.title)}. '
            f'{_safe(picture.alt)}">{body}</svg>')


def _safe(text: str) -> str:
    """Text for element content and attributes, without characters XML forbids."""
    return escape("".join(c for c in text if c >= " " and not "\ud800" <= c <= "\udfff" and c not in "\ufffe\uffff"))


def _cut(text: str, room: float) -> str:
    """Text for the picture itself, the middle left out where it is longer than `room` px."""
    return _safe(wording.clean(text, max(int(room / CHARACTER), 6)))


def heights(picture: Picture, width: int) -> list[int]:
    """Height of each panel's frame in a drawing `width` px wide."""
    rows = max((len(p.names) or len(p.branches) for p in picture.panels), default=0)
    base = _BESIDE_ROWS + _ROW * rows if rows else _HEIGHT_WIDE if picture.wide else _HEIGHT_SQUARE
    if picture.wide and width != WIDE and not rows:
        base = 170
    return [round(base * p.height) for p in picture.panels] if len(picture.panels) > 1 else [base]


def _body(picture: Picture, width: int, prefix: str) -> tuple[str, int]:
    parts, top = [], 4
    for i, (panel, height) in enumerate(zip(picture.panels, heights(picture, width), strict=True)):
        text, top = _panel(panel, width, top, height, f"{prefix}-{i}")
        parts.append(text)
    return "".join(parts), top


def _panel(panel: Panel, width: int, top: float, height: float, key: str) -> tuple[str, int]:
    """One panel from `top` on, and the position of the next one."""
    legend, rows = names.legend(panel, _LEFT, width, top, CHARACTER, _cut)
    left = min(max(_LEFT, 12 + CHARACTER * max((len(n) for n in panel.names), default=0)), _WIDEST_NAMES * width)
    left = _RIGHT if panel.branches else left
    x = Axis(*axes.limits(panel, "x"), left, width - _RIGHT, panel.log_x)
    y0 = top + _TOP + names.ROW * rows + names.RULE_ROW * names.rule_rows(panel, x, CHARACTER)
    y1 = y0 + height
    y = Axis(*axes.limits(panel, "y"), y1, y0)
    inside = f'<g clip-path="url(#{key})">'
    parts = [
        legend,
        f'<clipPath id="{key}"><rect x="{left:.0f}" y="{y0:.0f}" width="{width - _RIGHT - left:.0f}" '
        f'height="{height:.0f}"/></clipPath>',
        inside,
        *([_cells(panel.cells, x, y)] if panel.cells else []),
        *(_band(b, x, y0, height) for b in panel.bands),
        "</g>",
        _grid(panel, x, y),
        inside,
        *(_rule(r, x, y) for r in panel.rules),
        *(_line(line, x, y) for line in panel.lines),
        *(f'<rect class="r-mark" x="{x.at(b.x0):.1f}" y="{y.at(b.y1):.1f}" '
          f'width="{max(float(x.at(b.x1) - x.at(b.x0)), 2):.1f}" '
          f'height="{max(float(y.at(b.y0) - y.at(b.y1)), 2):.1f}"/>' for b in panel.boxes),
        *(names.mark(m.role, float(x.at(m.x)), float(y.at(m.y)), 8) for m in panel.marks),
        *(_branch(b, x, y) for b in reversed(panel.branches)),
        "</g>",
        names.rule_labels(panel, x, y0, CHARACTER, _cut),
        f'<rect class="frame" x="{left:.1f}" y="{y0:.1f}" width="{width - _RIGHT - left:.1f}" '
        f'height="{height:.1f}"/>']
    bottom = y1 + (_BOTTOM if panel.x_label else _GAP)
    if panel.x_label:
        parts.append(f'<text x="{(left + width - _RIGHT) / 2:.0f}" y="{y1 + 34:.0f}" text-anchor="middle">'
                     f"{_cut(panel.x_label, width - left)}</text>")
    if panel.y_label:
        parts.append(f'<text transform="translate(14 {(y0 + y1) / 2:.0f}) rotate(-90)" text-anchor="middle">'
                     f"{_cut(panel.y_label, height + _GAP)}</text>")
    return "".join(parts), round(bottom)


def _grid(panel: Panel, x: Axis, y: Axis) -> str:
    """Grid lines and tick labels; x labels only where the panel has an x label."""
    parts = []
    across = axes.log_ticks(x.low, x.high) if x.log else axes.ticks(x.low, x.high, int((x.end - x.start) / 60))
    step = across[1] - across[0] if len(across) > 1 and not x.log else 1.0
    top, bottom = min(y.start, y.end), max(y.start, y.end)
    for value in across:
        at = float(x.at(value))
        parts.append("" if panel.cells else f'<path class="grid" d="M{at:.1f} {top:.1f}V{bottom:.1f}"/>')
        if panel.x_label:
            label = f"{value:g}" if x.log else axes.tick_text(value, step)
            parts.append(f'<text x="{at:.1f}" y="{bottom + 16:.1f}" text-anchor="middle">{label}</text>')
    if panel.names:
        parts += [f'<text x="{x.start - 6:.0f}" y="{float(y.at(i)) + 4:.1f}" text-anchor="end">'
                  f"{_cut(name, x.start - 8)}</text>" for i, name in enumerate(panel.names)]
        return "".join(parts)
    if panel.branches:
        return "".join(parts)
    up = axes.ticks(y.low, y.high, max(2, int((bottom - top) / 34)))
    step = up[1] - up[0] if len(up) > 1 else 1.0
    for value in up:
        at = float(y.at(value))
        parts.append("" if panel.cells else f'<path class="grid" d="M{x.start:.1f} {at:.1f}H{x.end:.1f}"/>')
        parts.append(f'<text x="{x.start - 6:.0f}" y="{at + 4:.1f}" text-anchor="end">'
                     f"{axes.tick_text(value, step)}</text>")
    return "".join(parts)


def _band(band: Band, x: Axis, top: float, height: float) -> str:
    start, end = float(x.at(band.start)), float(x.at(band.end))
    return (f'<rect class="b-{band.role}" x="{start:.1f}" y="{top:.1f}" width="{max(end - start, 1.5):.1f}" '
            f'height="{height:.1f}"/>')


def _rule(rule: Rule, x: Axis, y: Axis) -> str:
    """The line of a rule; its label is outside the frame."""
    if rule.axis == "x":
        return f'<path class="r-{rule.role}" d="M{float(x.at(rule.value)):.1f} {min(y.start, y.end):.1f}' \
               f'V{max(y.start, y.end):.1f}"/>'
    return f'<path class="r-{rule.role}" d="M{x.start:.1f} {float(y.at(rule.value)):.1f}H{x.end:.1f}"/>'


def _line(line: Line, x: Axis, y: Axis) -> str:
    px, py = x.at(line.x), y.at(line.y)
    good = np.isfinite(px) & np.isfinite(py)
    if line.style == "dots":
        path = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(px[good], py[good], strict=True))
        return f'<path class="r-{line.role} dots" d="{path}"/>'
    if line.style == "points":
        return "".join(f'<circle class="f-{line.role}" cx="{a:.1f}" cy="{b:.1f}" r="4"/>'
                       for a, b in zip(px[good], py[good], strict=True))
    if line.style == "bars":
        zero = float(x.at(max(0.0, min(x.low, x.high))))
        return "".join(f'<rect class="f-{line.role}" x="{min(zero, a):.1f}" y="{b - 7:.1f}" '
                       f'width="{max(abs(a - zero), 1):.1f}" height="14"/>'
                       for a, b in zip(px[good], py[good], strict=True))
    if line.style == "stems":
        zero = float(y.at(0.0))
        path = "".join(f"M{a:.1f} {zero:.1f}V{b:.1f}" for a, b in zip(px[good], py[good], strict=True))
        return f'<path class="r-{line.role}" d="{path}"/>'
    drawn = f'<path class="r-{line.role}" d="{_path(px, py, good)}"/>'
    return drawn + (_arrows(line.role, px[good], py[good]) if line.style == "arrows" else "")


def branch_label(start: float, end: float, low: float, size: float) -> tuple[float, str, bool]:
    """Place and anchor of the label of a branch from `start` to `end`, and whether it stands above the edge.

    A label of width `size` goes along an edge that is long enough, else to the left of it, else, where the frame
    begins at `low` too near, to the right of it.
    """
    left, right = min(start, end), max(start, end)
    if right - left > size + 2 * BESIDE:
        return (end + BESIDE, "start", True) if end < start else (end - BESIDE, "end", True)
    return (left - BESIDE, "end", False) if left - size - BESIDE > low else (right + BESIDE, "start", False)


def _branch(branch: Branch, x: Axis, y: Axis) -> str:
    """A node of a tree with the edge that leads to it; its note appears under the pointer."""
    start, end, row = float(x.at(branch.from_x)), float(x.at(branch.x)), float(y.at(branch.row))
    room = x.end - x.start - 20
    size = min(CHARACTER * len(branch.label), room)
    at, anchor, above = branch_label(start, end, x.start, size)
    look = {"optimum": "halo strong", "guide": "halo soft"}.get(branch.role, "halo")
    joined = branch.from_row != branch.row
    edge = f'<path class="r-{branch.role}" d="M{start:.1f} {float(y.at(branch.from_row)):.1f}V{row:.1f}H{end:.1f}"/>'
    return (f"<g><title>{_safe(branch.note)}</title>" + edge * joined
            + f'<circle class="f-{branch.role}" cx="{end:.1f}" cy="{row:.1f}" r="{5 if joined else 6}"/>'
            f'<text class="{look}" x="{at:.1f}" y="{row - 5 if above else row + 4:.1f}" text-anchor="{anchor}">'
            f"{_cut(branch.label, room)}</text></g>")


def _path(px: FloatArray, py: FloatArray, good: np.ndarray) -> str:
    """Moves and lines through the finite points; one point between two gaps is not drawn."""
    parts, pen = [], False
    for a, b, ok in zip(px.tolist(), py.tolist(), good.tolist(), strict=True):
        if ok:
            parts.append(f"{'L' if pen else 'M'}{a:.1f} {b:.1f}")
        pen = ok
    return "".join(parts)


def arrow_places(px: FloatArray, py: FloatArray) -> list[int]:
    """Points of a curve, in px, from which an arrow head leads to the next: every _ARROW_EVERY px, at most 40."""
    if px.size < 2:
        return []
    length = np.hypot(np.diff(px), np.diff(py))
    walked = np.cumsum(length)
    every = max(_ARROW_EVERY, float(walked[-1]) / 40)
    where = np.unique(np.searchsorted(walked, np.arange(every / 2, walked[-1], every)))
    return [int(k) for k in where if k < length.size and length[k] >= 0.5]


def _arrows(role: str, px: FloatArray, py: FloatArray) -> str:
    """Arrow heads along a curve."""
    heads = []
    for k in arrow_places(px, py):
        dx, dy = px[k + 1] - px[k], py[k + 1] - py[k]
        ux, uy = np.array([dx, dy]) / np.hypot(dx, dy)
        tip = (px[k] + px[k + 1]) / 2 + 5 * ux, (py[k] + py[k + 1]) / 2 + 5 * uy
        left = tip[0] - 9 * ux - 4 * uy, tip[1] - 9 * uy + 4 * ux
        right = tip[0] - 9 * ux + 4 * uy, tip[1] - 9 * uy - 4 * ux
        heads.append(f"M{tip[0]:.1f} {tip[1]:.1f}L{left[0]:.1f} {left[1]:.1f}L{right[0]:.1f} {right[1]:.1f}Z")
    return f'<path class="f-{role}" d="{"".join(heads)}"/>' if px.size > 1 else ""


def _cells(cells: Cells, x: Axis, y: Axis) -> str:
    """A cost map as runs of equal class per row: far fewer rectangles than cells."""
    span = palette.map_span(cells.values)
    if span is None:
        return ""
    ex, ey = x.at(axes.edges(cells.x)), y.at(axes.edges(cells.y))
    parts = []
    for j, row in enumerate(cells.values[: len(cells.y)]):
        classes = [None if v is None else palette.map_class(v, *span) for v in row[: len(cells.x)]]
        for kind, run in groupby(range(len(classes)), classes.__getitem__):
            columns = list(run)
            start, end = ex[columns[0]], ex[columns[-1] + 1]
            if kind is not None:
                parts.append(f'<rect class="m{kind}" x="{start:.1f}" y="{ey[j + 1]:.1f}" '
                             f'width="{end - start + 0.4:.1f}" height="{ey[j] - ey[j + 1] + 0.4:.1f}"/>')
    return "".join(parts)
