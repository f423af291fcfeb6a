"""Pictures as SVG, inline in a page or as files: small, the same bytes every time, light and dark by style sheet.

Only draws; the numbers come from `pictures`. Text is real text, so it can be searched, translated and read aloud.
"""

from __future__ import annotations

from html import escape

import numpy as np

from ..loop import FloatArray
from . import axes, palette, wording
from .axes import Axis
from .picture import Band, Line, Panel, Picture

# Sizes in px of the drawing's own grid. A wide picture fills a page, a square one half of it or a phone.
WIDE, SQUARE = 920, 440
_HEIGHT_WIDE, _HEIGHT_SQUARE = 230, 350
_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP = 62, 14, 30, 40, 16
_TEXT = 12.5
# Mean width of a character at _TEXT size. Unit: px; for legends and margins, measured on DejaVu Sans and Arial.
_CHARACTER = 6.9
# Distance of arrow heads along a curve. Unit: px.
_ARROW_EVERY = 95.0
# Most of a picture's width that names of bars may take. Unit: 1; longer names are cut in the middle.
_WIDEST_NAMES = 0.42
SVG_KIND = b"<!-- stictionid figure -->"


def style(selector: str = "") -> str:
    """Style rules for inline pictures under `selector`, from CSS variables the page defines."""
    rules = []
    for role, look in palette.LOOKS.items():
        dash = f"stroke-dasharray:{' '.join(map(str, look.dash))};" if look.dash else ""
        rules.append(f"{selector} .r-{role}{{stroke:var(--{role});stroke-width:{look.width};{dash}fill:none}}")
        rules.append(f"{selector} .f-{role}{{fill:var(--{role});stroke:none}}")
    rules += [f"{selector} text{{fill:var(--ink);font:{_TEXT}px system-ui,-apple-system,'Segoe UI',Arial,sans-serif}}",
              f"{selector} .grid{{stroke:var(--grid);stroke-width:1}}",
              f"{selector} .frame{{stroke:var(--soft);stroke-width:1;fill:none}}",
              f"{selector} .b-failing{{fill:var(--failing)}}", f"{selector} .b-unused{{fill:url(#hatch)}}",
              f"{selector} .hatch{{stroke:var(--unused);stroke-width:4}}",
              f"{selector} .halo{{paint-order:stroke;stroke:var(--ground);stroke-width:3px}}"]
    rules += [f"{selector} .m{i}{{fill:var(--map{i})}}" for i in range(len(palette.MAP_LIGHT))]
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


def inline(picture: Picture, prefix: str, *, narrow: bool = False) -> str:
    """The picture as an <svg> element; `prefix` keeps its ids apart from other pictures on the page."""
    width = WIDE if picture.wide and not narrow else SQUARE
    body, height = _body(picture, width, prefix)
    return (f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{_safe(picture.title)}. '
            f'{_safe(picture.alt)}">{body}</svg>')


def _safe(text: str) -> str:
    """Text for element content and attributes, without characters XML forbids."""
    return escape("".join(c for c in text if c >= " " and not "\ud800" <= c <= "\udfff" and c not in "\ufffe\uffff"))


def _cut(text: str, room: float) -> str:
    """Text for the picture itself, the middle left out where it is longer than `room` px."""
    return _safe(wording.clean(text, max(int(room / _CHARACTER), 6)))


def _body(picture: Picture, width: int, prefix: str) -> tuple[str, int]:
    named = max((len(p.names) for p in picture.panels), default=0)
    base = 46 + 26 * named if named else _HEIGHT_WIDE if picture.wide else _HEIGHT_SQUARE
    wide = picture.wide and width == WIDE
    if picture.wide and not wide:
        base = 170
    parts, top = [], 4
    for i, panel in enumerate(picture.panels):
        height = round(base * panel.height) if len(picture.panels) > 1 else base
        last = i == len(picture.panels) - 1
        text, top = _panel(panel, width, top, height, f"{prefix}-{i}", last)
        parts.append(text)
    return "".join(parts), top


def _panel(panel: Panel, width: int, top: float, height: float, key: str, last: bool) -> tuple[str, int]:
    """One panel from `top` on, and where the next one starts."""
    legend, rows = _legend(panel, width, top)
    left = min(max(_LEFT, 12 + _CHARACTER * max((len(n) for n in panel.names), default=0)), _WIDEST_NAMES * width)
    y0 = top + (_TOP - 18) + 18 * rows
    y1 = y0 + height
    x = Axis(*axes.limits(panel, "x"), left, width - _RIGHT, panel.log_x)
    y = Axis(*axes.limits(panel, "y"), y1, y0)
    parts = [legend, f'<clipPath id="{key}"><rect x="{left:.0f}" y="{y0:.0f}" width="{width - _RIGHT - left:.0f}" '
             f'height="{height:.0f}"/></clipPath>', f'<g clip-path="url(#{key})">']
    parts += [_cells(panel, x, y)] if panel.cells else []
    parts += [_band(b, x, y0, height) for b in panel.bands]
    parts.append("</g>")
    parts.append(_grid(panel, x, y, last))
    parts.append(f'<g clip-path="url(#{key})">')
    parts += [_rule(panel, r, x, y) for r in panel.rules]
    parts += [_line(line, x, y) for line in panel.lines]
    parts += [f'<rect class="r-mark" x="{x.at(b.x0):.1f}" y="{y.at(b.y1):.1f}" '
              f'width="{max(float(x.at(b.x1) - x.at(b.x0)), 2):.1f}" '
              f'height="{max(float(y.at(b.y0) - y.at(b.y1)), 2):.1f}"/>' for b in panel.boxes]
    parts += [_mark(m.x, m.y, m.label, m.role, x, y) for m in panel.marks]
    parts.append("</g>")
    parts.append(f'<rect class="frame" x="{left:.1f}" y="{y0:.1f}" width="{width - _RIGHT - left:.1f}" '
                 f'height="{height:.1f}"/>')
    bottom = y1 + (_BOTTOM if panel.x_label else _GAP)
    if panel.x_label:
        parts.append(f'<text x="{(left + width - _RIGHT) / 2:.0f}" y="{y1 + 34:.0f}" text-anchor="middle">'
                     f"{_cut(panel.x_label, width - left)}</text>")
    if panel.y_label:
        parts.append(f'<text transform="translate(14 {(y0 + y1) / 2:.0f}) rotate(-90)" text-anchor="middle">'
                     f"{_cut(panel.y_label, height + _GAP)}</text>")
    return "".join(parts), round(bottom)


def _legend(panel: Panel, width: int, top: float) -> tuple[str, int]:
    """Samples of each line with its name, wrapped; and how many rows that took."""
    entries: list[tuple[str, str, str]] = []
    for line in panel.lines:
        entry = (line.name, line.role, {"points": "dot", "bars": "bar"}.get(line.style, "line"))
        if entry not in entries:
            entries.append(entry)
    seen = {b.role for b in panel.bands}
    entries += [("model fails", "failing", "band")] if "failing" in seen else []
    entries += [("not used", "unused", "band")] if "unused" in seen else []
    entries += [(b.label, "mark", "box") for b in panel.boxes]
    if panel.cells is not None:
        entries.append(("optimum", "optimum", "cross"))
    parts, at, row = [], float(_LEFT), 0
    for name, role, kind in entries:
        size = 30 + _CHARACTER * len(name) + 14
        if at + size > width and at > _LEFT:
            at, row = float(_LEFT), row + 1
        y = top + 13 + 18 * row
        parts.append(_sample(kind, role, at, y))
        parts.append(f'<text x="{at + 30:.0f}" y="{y + 4:.0f}">{_cut(name, width - at - 30)}</text>')
        at += size
    return "".join(parts), row + 1 if entries else 0


def _sample(kind: str, role: str, at: float, y: float) -> str:
    if kind == "band":
        return f'<rect class="b-{role}" x="{at:.0f}" y="{y - 6:.0f}" width="24" height="12"/>'
    if kind == "bar":
        return f'<rect class="f-{role}" x="{at:.0f}" y="{y - 5:.0f}" width="24" height="10"/>'
    if kind == "dot":
        return f'<circle class="f-{role}" cx="{at + 12:.0f}" cy="{y:.0f}" r="4"/>'
    if kind == "box":
        return f'<rect class="r-{role}" x="{at:.0f}" y="{y - 6:.0f}" width="24" height="12"/>'
    if kind == "cross":
        return f'<path class="r-{role}" d="{_cross(at + 12, y)}"/>'
    return f'<path class="r-{role}" d="M{at:.0f} {y:.0f}h24"/>'


def _cross(x: float, y: float, r: float = 6) -> str:
    return f"M{x - r:.1f} {y:.1f}h{2 * r}M{x:.1f} {y - r:.1f}v{2 * r}"


def _grid(panel: Panel, x: Axis, y: Axis, last: bool) -> str:
    """Grid lines and tick labels; x labels only where the panel has an x label."""
    parts = []
    across = axes.log_ticks(x.low, x.high) if x.log else axes.ticks(x.low, x.high, int((x.end - x.start) / 70))
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


def _rule(panel: Panel, rule, x: Axis, y: Axis) -> str:
    if rule.axis == "x":
        at = float(x.at(rule.value))
        line = f'<path class="r-{rule.role}" d="M{at:.1f} {min(y.start, y.end):.1f}V{max(y.start, y.end):.1f}"/>'
        place = f'x="{at + 4:.1f}" y="{min(y.start, y.end) + 13:.1f}"'
    else:
        at = float(y.at(rule.value))
        line = f'<path class="r-{rule.role}" d="M{x.start:.1f} {at:.1f}H{x.end:.1f}"/>'
        place = f'x="{x.end - 4:.1f}" y="{at - 4:.1f}" text-anchor="end"'
    return line + (f'<text class="halo" {place}>{_safe(rule.label)}</text>' if rule.label else "")


def _line(line: Line, x: Axis, y: Axis) -> str:
    px, py = x.at(line.x), y.at(line.y)
    good = np.isfinite(px) & np.isfinite(py)
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


def _path(px: FloatArray, py: FloatArray, good: np.ndarray) -> str:
    """Moves and lines through the finite points; one point between two gaps becomes a dot."""
    parts, pen = [], False
    for a, b, ok in zip(px.tolist(), py.tolist(), good.tolist(), strict=True):
        if ok:
            parts.append(f"{'L' if pen else 'M'}{a:.1f} {b:.1f}")
        pen = ok
    return "".join(parts)


def _arrows(role: str, px: FloatArray, py: FloatArray) -> str:
    """Arrow heads along a curve, every _ARROW_EVERY px, at most 40."""
    if px.size < 2:
        return ""
    dx, dy = np.diff(px), np.diff(py)
    length = np.hypot(dx, dy)
    walked = np.cumsum(length)
    every = max(_ARROW_EVERY, float(walked[-1]) / 40)
    where = np.unique(np.searchsorted(walked, np.arange(every / 2, walked[-1], every)))
    heads = []
    for k in where[where < length.size]:
        if length[k] < 0.5:
            continue
        ux, uy = dx[k] / length[k], dy[k] / length[k]
        tip = (px[k] + px[k + 1]) / 2 + 5 * ux, (py[k] + py[k + 1]) / 2 + 5 * uy
        left = tip[0] - 9 * ux - 4 * uy, tip[1] - 9 * uy + 4 * ux
        right = tip[0] - 9 * ux + 4 * uy, tip[1] - 9 * uy - 4 * ux
        heads.append(f"M{tip[0]:.1f} {tip[1]:.1f}L{left[0]:.1f} {left[1]:.1f}L{right[0]:.1f} {right[1]:.1f}Z")
    return f'<path class="f-{role}" d="{"".join(heads)}"/>'


def _mark(vx: float, vy: float, label: str, role: str, x: Axis, y: Axis) -> str:
    at, up = float(x.at(vx)), float(y.at(vy))
    shape = (f'<circle class="r-{role}" cx="{at:.1f}" cy="{up:.1f}" r="3"/>' if role == "search" else
             f'<path class="r-{role}" d="{_cross(at, up, 8)}"/>')
    return shape


def _cells(panel: Panel, x: Axis, y: Axis) -> str:
    """A cost map as runs of equal class per row: far fewer rectangles than cells."""
    cells = panel.cells
    if cells is None:
        return ""
    values = [v for row in cells.values for v in row if v is not None]
    if not values:
        return ""
    best, worst = min(values), max(values)
    ex, ey = x.at(axes.edges(cells.x)), y.at(axes.edges(cells.y))
    parts = []
    for j, row in enumerate(cells.values[: len(cells.y)]):
        classes = [None if v is None else palette.map_class(v, best, worst) for v in row[: len(cells.x)]]
        start = 0
        for i in range(1, len(classes) + 1):
            if i == len(classes) or classes[i] != classes[start]:
                if classes[start] is not None:
                    parts.append(f'<rect class="m{classes[start]}" x="{ex[start]:.1f}" y="{ey[j + 1]:.1f}" '
                                 f'width="{ex[i] - ex[start] + 0.4:.1f}" height="{ey[j] - ey[j + 1] + 0.4:.1f}"/>')
                start = i
    return "".join(parts)
