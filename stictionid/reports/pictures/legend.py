"""Legends of a picture as SVG, between title and frame: names of lines, bands and marks, and labels of rules.

Names go outside the frame, so that they never cover a curve.
"""

from __future__ import annotations

from collections.abc import Callable
from textwrap import wrap

from .. import wording
from . import palette
from .axes import Axis
from .picture import Panel, Rule

# Height of one row of names and of one row of rule labels, and width of a sample with its gaps. Unit: px.
ROW, RULE_ROW = 18, 15
SAMPLE, BETWEEN = 30, 14
# Side of one swatch of a cost map's scale. Unit: px.
_SWATCH = 13
BAND_NAMES = (("failing", "model fails"), ("unused", "not used"))

Cut = Callable[[str, float], str]


def entries(panel: Panel) -> list[tuple[str, str, str]]:
    """Name, role and kind of sample of everything in a panel that needs a name, each once."""
    kinds = {"points": "dot", "dots": "dot", "bars": "bar"}
    found = [(line.name, line.role, kinds.get(line.style, "line")) for line in panel.lines]
    seen = {b.role for b in panel.bands}
    found += [(word, role, "band") for role, word in BAND_NAMES if role in seen]
    found += [(r.label, r.role, "line") for r in panel.rules if r.axis == "y"]
    found += [(b.label, "mark", "box") for b in panel.boxes]
    found += [(m.label, m.role, "mark") for m in panel.marks]
    found += [(b.kind, b.role, "branch") for b in panel.branches]
    found = [e for e in found if e[0]]
    if len(found) == 1 and found[0][2] in ("bar", "line") and panel.names:
        return []  # one kind of bar, which the axis names
    return list(dict.fromkeys(found))


def legend(panel: Panel, left: float, width: int, top: float, character: float, cut: Cut) -> tuple[str, int]:
    """Samples of each entry with its name from `left` on, wrapped; and the number of rows."""
    parts, at, row = [], left, 0
    for name, role, kind in entries(panel):
        size = SAMPLE + character * min(len(name), wording.LONGEST_NAME) + BETWEEN
        if at + size > width and at > left:
            at, row = left, row + 1
        parts.append(_sample(kind, role, at, top + 13 + ROW * row))
        # A name that is wider than the picture goes on in the next row.
        whole = wording.clean(name, wording.LONGEST_NAME)
        for k, piece in enumerate(wrap(whole, max(int((width - at - SAMPLE) / character), 1))):
            row += k > 0
            parts.append(f'<text x="{at + SAMPLE:.0f}" y="{top + 17 + ROW * row:.0f}">'
                         f"{cut(piece, width - at - SAMPLE)}</text>")
        at += size
    rows = row + 1 if parts else 0
    scale = _scale(panel, left, top + 13 + ROW * rows, character, cut)
    return "".join(parts) + scale, rows + bool(scale)


def _scale(panel: Panel, left: float, y: float, character: float, cut: Cut) -> str:
    """The classes of a cost map between its smallest and its largest value."""
    span = palette.map_span(panel.cells.values) if panel.cells is not None else None
    if panel.cells is None or span is None:
        return ""
    low = f"{panel.cells.label} {wording.number(span[0])}"
    at = left + character * len(low) + 6
    swatches = "".join(f'<rect class="m{i}" x="{at + _SWATCH * i:.1f}" y="{y - 6:.1f}" width="{_SWATCH}" '
                       f'height="12"/>' for i in range(len(palette.MAP_LIGHT)))
    end = at + _SWATCH * len(palette.MAP_LIGHT) + 6
    high = f"{wording.number(span[1])} {panel.cells.unit}"
    return (f'<text x="{left:.0f}" y="{y + 4:.0f}">{cut(low, 400)}</text>{swatches}'
            f'<text x="{end:.0f}" y="{y + 4:.0f}">{cut(high, 400 - end + left)}</text>')


def rule_labels(panel: Panel, x: Axis, bottom: float, character: float, cut: Cut) -> str:
    """Labels of the vertical rules above the frame, whose top is at `bottom`; crowded ones go to higher rows."""
    return "".join(f'<text x="{start:.1f}" y="{bottom - 4 - RULE_ROW * row:.1f}">{cut(rule.label, 400)}</text>'
                   f'<path class="r-{rule.role}" d="M{at:.1f} {bottom:.1f}V{bottom - 3 - RULE_ROW * row:.1f}"/>'
                   for rule, at, start, row in rule_places(panel, x, character))


def rule_rows(panel: Panel, x: Axis, character: float) -> int:
    """Rows that the labels of the vertical rules take."""
    return max((row + 1 for *_, row in rule_places(panel, x, character)), default=0)


def rule_places(panel: Panel, x: Axis, character: float) -> list[tuple[Rule, float, float, int]]:
    """Labelled vertical rules: place of the rule, start of its text and row, so that no rule crosses a label.

    They are given from right to left; rules out of sight are left out.
    """
    starts: list[float] = []
    placed = []
    low, high = min(x.start, x.end), max(x.start, x.end)
    shown = [(float(x.at(r.value)), r) for r in panel.rules if r.axis == "x" and r.label]
    for at, rule in sorted(shown, key=lambda s: (s[0], s[1].label, s[1].role), reverse=True):
        if not low - 0.5 <= at <= high + 0.5:
            continue
        size = character * len(rule.label)
        start = max(min(at + 3, high - size), low)
        row = next((k for k, taken in enumerate(starts) if start + size < taken - 6), len(starts))
        starts[row:row + 1] = [min(start, at)]
        placed.append((rule, at, start, row))
    return placed


def _sample(kind: str, role: str, at: float, y: float) -> str:
    line = f'<path class="r-{role}" d="M{at:.0f} {y:.0f}h24"/>'
    dot = f'<circle class="f-{role}" cx="{at + 12:.0f}" cy="{y:.0f}" r="4"/>'
    return {"band": f'<rect class="b-{role}" x="{at:.0f}" y="{y - 6:.0f}" width="24" height="12"/>',
            "bar": f'<rect class="f-{role}" x="{at:.0f}" y="{y - 5:.0f}" width="24" height="10"/>',
            "box": f'<rect class="r-{role}" x="{at:.0f}" y="{y - 6:.0f}" width="24" height="12"/>',
            "branch": line + dot, "dot": dot, "line": line, "mark": mark(role, at + 12, y, 6)}[kind]


def mark(role: str, x: float, y: float, r: float) -> str:
    """A point's sign: a ring for searches, an oblique cross for the last model, an upright one for the rest."""
    if role == "search":
        return f'<circle class="r-{role}" cx="{x:.1f}" cy="{y:.1f}" r="3"/>'
    if role == "last":
        d = f"M{x - r:.1f} {y - r:.1f}l{2 * r} {2 * r}M{x - r:.1f} {y + r:.1f}l{2 * r} {-2 * r}"
    else:
        d = f"M{x - r:.1f} {y:.1f}h{2 * r}M{x:.1f} {y - r:.1f}v{2 * r}"
    return f'<path class="under" d="{d}"/><path class="r-{role}" d="{d}"/>'
