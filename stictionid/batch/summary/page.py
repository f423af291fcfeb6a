"""The summary as one HTML page: all loops in a table to sort and filter, each linked to its study or its page.

Frame, style, script and escaping are those of the report, so the page needs no network and runs no foreign text.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import quote

from ... import _version
from ...reports.document import PageTable
from ...reports.pages import html as report
from ...system.plurals import counted
from ..task import SKIPPED
from .groups import groups_said
from .rows import COLUMNS, counts_said, shown

_HEADS = {"loop": "loop", "rank": "rank", "status": "status", "verdict": "verdict", "S": "S", "S_low": "S from",
          "S_high": "S to", "J": "J", "unit": "unit", "period_median_s": "period, s", "group": "group", "role": "role",
          "missing": "missing effects", "rmse_before": "error before", "rmse_after": "error after",
          "message": "message", "file": "file"}


def page_of(rows: list[dict[str, Any]], folder: Path | None = None) -> str:
    """The page for summary rows; loops link to `pages/NAME.html` in `folder` where that exists, else to the study."""
    sticks = sum(row["verdict"] == "stiction" for row in rows)
    loops = sum(row["status"] != SKIPPED for row in rows)
    title = f"Valve stiction: {counted(loops, 'loop')}, {counted(sticks, 'sticks', 'stick')}"
    table = PageTable("All loops, worst first", tuple(_HEADS.values()),
                  tuple(tuple(shown(row, name) for name in _HEADS) for row in rows),
                  tuple(i for i, name in enumerate(_HEADS) if COLUMNS[name]))
    body = (f"<h1>{report.escaped(title)}</h1>"
            f"<p>{counts_said(rows)}.</p>"
            f"{''.join(f'<p>{report.escaped(said)}</p>' for said in groups_said(rows))}"
            f'<section aria-label="All loops"><p class="filter" hidden><label>Show loops with '
            f'<input type="search" id="{report.FILTER}" autocomplete="off"></label> <output></output></p>'
            f"{report.table_html(table, report.COMPARED, links=[_link(row, folder) for row in rows])}</section>")
    return report.page_html(title, body, _version.__version__)


def _link(row: dict[str, Any], folder: Path | None) -> str:
    if row["study"] is None:
        return ""
    study = str(row["study"])
    own = f"pages/{Path(study).stem}.html"
    return quote(own if folder is not None and (folder / own).is_file() else study)
