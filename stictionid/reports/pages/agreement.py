"""Agreement over records as markdown with its picture beside it, or as JSON."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...record.study import to_json
from ...system.files import ensure_writable
from ...typing import FloatArray
from ...verbs.agree import Agreement, Drift, RecordResult
from .. import wording
from ..document import PageTable
from ..pictures.picture import Line, Panel, Picture
from ..pictures.study_pictures import time_unit
from . import place
from .markdown import escape, picture_text, table_text

MARK = "<!-- stictionid agreement -->"
KINDS = {".md": MARK.encode(), ".json": b'{\n "schema": "stictionid.agreement/'}
# Margin before the first and after the last record, as a share of the span.
_MARGIN = 0.06


def check_place(out: Path, *, figures: str = "svg", force: bool = False) -> None:
    """Refuse an unknown extension or figure kind, or a place that cannot be written, before any work is done."""
    place.check_place("agreement", out, KINDS, " or ".join(KINDS), figures=figures, force=force)
    if out.suffix.lower() == ".md":
        ensure_writable(place.beside(out, "drift", figures), force=force, kind=place.FIGURES[figures])


def write_agreement(found: Agreement, out: Path, *, figures: str = "svg", force: bool = False) -> list[Path]:
    """Write the page and, for markdown, its picture beside it; the files written, the page last."""
    check_place(out, figures=figures, force=force)
    kind = KINDS[out.suffix.lower()]
    if out.suffix.lower() == ".json":
        return place.write_page(out, to_json(found), {}, force=force, kind=kind)
    picture, at = drift_picture(found), place.beside(out, "drift", figures)
    return place.write_page(out, _markdown(found, picture, at.name), {} if picture is None else {at: picture},
                            figures=figures, force=force, kind=kind)


def record_table(found: Agreement) -> PageTable:
    """One row for each record: time, verdict, S and J with intervals, and whether it counts."""
    unit = wording.name(found.unit)
    rows = tuple((wording.name(r.label), wording.name(r.middle or wording.NOTHING), r.verdict, *_numbers(r),
                  "yes" if r.counted else "no") for r in found.records)
    return PageTable(f"records of the loop; S and J in {unit}, {100 * found.interval_level:.0f} % intervals",
                 ("record", "middle", "verdict", "S", "J", "counts"), rows, (3, 4))


def _numbers(r: RecordResult) -> tuple[str, ...]:
    if not r.counted or r.S is None or r.J is None:
        return wording.NOTHING, wording.NOTHING
    return wording.estimate(r.S, r.S_interval, ""), wording.estimate(r.J, r.J_interval, "")


def left_out(found: Agreement) -> list[str]:
    """A sentence for each record that does not count."""
    return [f"{wording.name(r.label)}: {wording.clean(r.reason)}" for r in found.records if not r.counted]


def _markdown(found: Agreement, picture: Picture | None, name: str) -> str:
    parts = [MARK, "", "# Agreement over records", "", f"**{escape(wording.sentence(found.statement))}**", ""]
    statements = [*(s.statement for s in found.spreads), *(d.statement for d in found.drifts)]
    parts += [f"- {escape(wording.sentence(statement))}" for statement in statements]
    parts += ["", table_text(record_table(found)), ""]
    if picture is not None:
        parts += [picture_text(picture, name), ""]
    missing = left_out(found)
    if missing:
        parts += ["## Records that do not count", "", *(f"- {escape(line)}" for line in missing), ""]
    return "\n".join(parts).rstrip("\n") + "\n"


def drift_picture(found: Agreement) -> Picture | None:
    """S and J of the records over time with their intervals and the drift; None without a record that counts."""
    counted = [r for r in found.records if r.counted]
    if not counted:
        return None
    clock = all(r.at_s is not None for r in counted)
    t = np.array([r.at_s if clock else k for k, r in enumerate(counted, 1)], dtype=float)
    per, unit = time_unit(float(np.ptp(t))) if clock else (1.0, "")
    label = f"time since the first record, {unit}" if clock else "record, in the order given"
    panels = tuple(_panel(name, found, counted, t / per, label if name == "J" else "") for name in ("S", "J"))
    said = " ".join(wording.sentence(d.statement) for d in found.drifts) or wording.sentence(found.statement)
    return Picture("drift", "S and J over the records", said,
                   f"S above, J below, with {100 * found.interval_level:.0f} % intervals; the dashed line is the drift "
                   "where there are three records or more.", panels, wide=True)


def _panel(name: str, found: Agreement, counted: list[RecordResult], t: FloatArray, x_label: str) -> Panel:
    values = np.array([getattr(r, name) for r in counted])
    ends = [(at, *span) for at, r in zip(t, counted, strict=True) if (span := getattr(r, f"{name}_interval"))]
    x = np.array([v for at, _, _ in ends for v in (at, at, np.nan)])
    y = np.array([v for _, low, high in ends for v in (low, high, np.nan)])
    room = _MARGIN * (float(np.ptp(t)) or 1.0)
    edge = np.array([t.min() - room, t.max() + room])
    lines = [Line("interval", "mark", x, y)] if ends else []
    drift = next((d for d in found.drifts if d.name == name), None)
    lines.append(Line("drift", "model", edge, _line(drift, np.array([e[0] for e in ends]), edge)) if drift else
                 Line("mean", "guide", edge, np.full(2, values.mean())))
    return Panel(x_label, f"{name}, {wording.clean(found.unit, 24)}", (*lines, Line(name, "pv", t, values, "points")))


def _line(drift: Drift, t: FloatArray, at: FloatArray) -> FloatArray:
    """The drift's line at times `at`; `t` (k,) are the times of the records behind the line, on the same axis."""
    known = float(np.ptp(t)) or 1.0
    return drift.start + drift.change * (at - t.min()) / known
