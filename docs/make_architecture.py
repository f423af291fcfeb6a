"""Draw the rooms of the package, floor by floor, and write docs/architecture.md, both from tests/architecture.toml.

Run: python docs/make_architecture.py
"""

from __future__ import annotations

import textwrap
import tomllib
from collections.abc import Iterator
from html import escape
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE, PICTURE = "architecture.md", "pictures/architecture.svg"
# The rooms that a sample passes, in order, and what each does with it.
WAY = {
    "historian": "`historian/reading.py` finds the cell in the export, its time and its unit. A bad cell is "
                 "dropped and counted.",
    "record": "`record/loop.py` holds it as one of SP, PV and OP on an even grid. Its cycles are found, and "
              "`record/preconditions.py` asks whether the record holds enough.",
    "model": "`model/model.py` moves a stem by OP alone, through law, effects and process. What PV shows beyond that "
             "is the residual.",
    "fit": "`fit/fit.py` changes S, J and the process until the residual is smallest. `fit/intervals/` says how far "
           "the numbers can move.",
    "selection": "`selection/search.py` adds effects and noise, and keeps those that predict held-out blocks better.",
    "methods": "`methods/auto.py` hands back the models that were tried, and the one that was chosen.",
    "verdict": "`verdict/judge.py` compares it with the best model without friction: the valve sticks, or not, or the "
               "record can't tell.",
    "verbs": "`verbs/identify.py` has called all of these in turn, and makes the study.",
    "reports": "`reports/pages/` writes the study as a page.",
    "cli": "`cli/identify.py` prints the verdict.",
}
_ABOUT = """`stictionid/` is a house of floors, drawn here from the ground up. A file imports from its own room and from
rooms below it. Within a floor, rooms named earlier in `tests/architecture.toml` count as below. That file holds the
order and the sentences, and `tests/test_architecture.py` fails on an import up. The second and the fifth floor are
drawn from right to left. `python docs/make_architecture.py` writes this page."""
_LEAD = "A sample is one row of an export. The blue rooms change it into a verdict, in the order of their numbers:"
# Sizes in the picture, all in px.
_WIDTH, _EDGE, _GAP, _ROOM, _STEP, _LETTER = 1060, 16, 22, 88, 130, 6.6
_STYLE = """text{font:13px system-ui,sans-serif;fill:#1b2127}.floor{font-weight:600;fill:#4a5560}
.room{fill:#fff;stroke:#8b949e}.passed{fill:#eaf2fb;stroke:#1358a8}.name{font-weight:700;font-size:14px}
.way{stroke:#1358a8;stroke-width:2.5;fill:none;marker-end:url(#tip)}.stop{fill:#1358a8}.count{fill:#fff;font-weight:700}"""


def floors() -> list[dict[str, dict[str, str]]]:
    """Floors from the ground up: name, and the sentence of each room."""
    rules = tomllib.loads((ROOT / "tests" / "architecture.toml").read_text(encoding="utf-8"))
    return list(rules["floors"])


def picture() -> str:
    """The house as SVG: the ground below, rooms with their sentences, and the way of a sample through them."""
    height = _EDGE + len(floors()) * _STEP
    boxes = {name: box for name, box in _boxes(height)}
    said = {room: words for floor in floors() for room, words in floor["rooms"].items()}
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" role="img" aria-labelledby="t">',
           '<title id="t">The rooms of stictionid, and the way of a sample from file to verdict</title>',
           f"<style>{_STYLE}</style>",
           '<marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="5" markerHeight="5" orient="auto">'
           '<path d="M0 0L8 4L0 8z" fill="#1358a8"/></marker>', '<rect width="100%" height="100%" fill="#f4f6f8"/>']
    stops = list(WAY)
    for floor in floors():
        rooms = list(floor["rooms"])
        left, y, _ = boxes[max(rooms, key=lambda room: stops.index(room) if room in WAY else -1)]
        # The floor's name stands where no arrow leaves it.
        there = rooms[0] in WAY and left < _EDGE + _GAP
        place = f'x="{_WIDTH - _EDGE}" text-anchor="end"' if there else f'x="{_EDGE}"'
        out += [f'<text class="floor" {place} y="{y - 9}">{escape(str(floor["name"]))}</text>']
    for name, (x, y, wide) in boxes.items():
        passed = name in WAY
        kind = "passed" if passed else "room"
        out += [f'<rect class="{kind}" x="{x}" y="{y}" width="{wide}" height="{_ROOM}" rx="6"/>',
                f'<text class="name" x="{x + (38 if passed else 12)}" y="{y + 23}">{name}</text>']
        if passed:
            out += [f'<circle class="stop" cx="{x + 20}" cy="{y + 18}" r="11"/><text class="count" x="{x + 20}" '
                    f'y="{y + 23}" text-anchor="middle">{stops.index(name) + 1}</text>']
        out += [f'<text x="{x + 12}" y="{y + 44 + 17 * i}">{escape(line)}</text>'
                for i, line in enumerate(textwrap.wrap(said[name], int((wide - 20) / _LETTER)))]
    out += [f'<path class="way" d="{_arrow(boxes[a], boxes[b])}"/>' for a, b in pairwise(stops)]
    return "\n".join([*out, "</svg>"]) + "\n"


def _boxes(height: int) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Left edge, upper edge and width of each room; every second floor runs to the left, so that the way climbs."""
    for i, floor in enumerate(floors()):
        names = [*floor["rooms"]][::-1 if i in (1, 4) else 1]
        wide = (_WIDTH - 2 * _EDGE - _GAP * (len(names) - 1)) // len(names)
        for j, name in enumerate(names):
            yield name, (_EDGE + j * (wide + _GAP), height - i * _STEP - _ROOM - _EDGE, wide)


def _arrow(a: tuple[int, int, int], b: tuple[int, int, int]) -> str:
    """From room to room: across the gap beside it, or up to the floor above where the two are closest."""
    if a[1] == b[1]:
        x, other = (a[0] + a[2], b[0]) if a[0] < b[0] else (a[0], b[0] + b[2])
        return f"M{x} {a[1] + _ROOM // 2}L{other} {a[1] + _ROOM // 2}"
    middle = (max(a[0], b[0]) + min(a[0] + a[2], b[0] + b[2])) // 2
    x, other = (min(max(middle, box[0] + _EDGE), box[0] + box[2] - _EDGE) for box in (a, b))
    return f"M{x} {a[1]}L{other} {b[1] + _ROOM}"


def page() -> str:
    """The page around the picture."""
    steps = [f"{i}. **{room}**: {said}" for i, (room, said) in enumerate(WAY.items(), 1)]
    lines = ["# Architecture", "", _ABOUT, "", f"![The rooms, floor by floor, and the way of a sample]({PICTURE})",
             "", "## The way of a sample", "", _LEAD, "", *steps]
    return "\n".join(textwrap.fill(line, 120, subsequent_indent="   " * line[:1].isdigit(), break_on_hyphens=False)
                     for line in lines) + "\n"


if __name__ == "__main__":
    for name, text in ((PAGE, page()), (PICTURE, picture())):
        (ROOT / "docs" / name).parent.mkdir(exist_ok=True)
        (ROOT / "docs" / name).write_text(text, encoding="utf-8")
