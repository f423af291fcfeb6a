"""The summary as one HTML page, all loops in a table to sort and filter, and beside it as CSV, Parquet and markdown.

Frame, style, script and escaping are those of the report, so the page needs no network and runs no foreign text.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ... import _version
from ...reports import wording
from ...reports.document import PageTable
from ...reports.pages import html as report
from ...system.files import write_whole
from ...system.plurals import counted
from ..task import OK, SKIPPED
from ..work.store import Store
from .groups import groups_said
from .rows import RULE, Row, as_csv, as_markdown, as_parquet, counts_said, rows_of, shown

# Columns of the page, and those that stand there only where a loop has a value.
_COLUMNS: dict[str, Callable[[Row], str]] = {
    "loop": lambda row: shown(row, "loop"),
    "rank": lambda row: shown(row, "rank"),
    "verdict": lambda row: shown(row, "verdict" if row["status"] == OK else "status"),
    "S": lambda row: _ranged(row, "S"),
    "J": lambda row: _ranged(row, "J"),
    "valve's share of the swing": lambda row: _percent(row["friction_share"]),
    "period, s": lambda row: shown(row, "period_median_s"),
    "group": lambda row: shown(row, "group"),
    "role": lambda row: shown(row, "role"),
    "free-run error": lambda row: _fallen(row),
    "model": lambda row: {"yes": "adequate", "no": "not adequate"}.get(row["adequate"], ""),
    "notes": lambda row: "; ".join(filter(None, (shown(row, "missing") and f"found: {shown(row, 'missing')}",
                                                 shown(row, "message")))),
}
_NUMERIC = ("rank", "period, s", "group")
_WHERE_ANY = ("group", "role")


def write_summary(store: Store) -> list[Row]:
    """Write summary.csv, .parquet, .md and .html from the store and return the rows. UsageError as `write_whole`."""
    rows = rows_of(store)
    made: dict[str, bytes | str] = {"summary.csv": as_csv(rows), "summary.md": as_markdown(rows),
                                    "summary.parquet": as_parquet(rows), "summary.html": page_of(rows, store.folder)}
    for name, content in made.items():
        write_whole(store.folder / name, content, force=True)
    return rows


def page_of(rows: list[dict[str, Any]], folder: Path | None = None) -> str:
    """The page for summary rows; loops link to `pages/NAME.html` in `folder` where that exists, else to the study."""
    sticks = sum(row["verdict"] == "stiction" for row in rows)
    loops = sum(row["status"] != SKIPPED for row in rows)
    poor = sum(row["adequate"] == "no" for row in rows)
    title = f"Valve stiction: {counted(loops, 'loop')}, {counted(sticks, 'sticks', 'stick')}"
    told = {name: cell for name, cell in _COLUMNS.items()
            if name not in _WHERE_ANY or any(cell(row) for row in rows)}
    table = PageTable("All loops, worst first", tuple(told), tuple(tuple(cell(row) for cell in told.values())
                                                                   for row in rows),
                      tuple(i for i, name in enumerate(told) if name in _NUMERIC))
    said = f"{counts_said(rows)}; {counted(poor, 'model is', 'models are')} not adequate."
    body = (f"<h1>{report.escaped(title)}</h1>"
            f"<p>{report.escaped(said)}</p><p>{report.escaped(RULE)}</p>"
            f"{''.join(f'<p>{report.escaped(said)}</p>' for said in groups_said(rows))}"
            f'<section class="loops" aria-label="All loops"><p class="filter" hidden><label>Show loops with '
            f'<input type="search" id="{report.FILTER}" autocomplete="off"></label> <output></output></p>'
            f"{report.table_html(table, report.COMPARED, links=[_link(row, folder) for row in rows])}</section>")
    return report.page_html(title, body, _version.__version__)


def _ranged(row: Row, name: str) -> str:
    """S or J with interval and unit, as a report shows it."""
    if row[name] is None:
        return ""
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    interval = None if low is None or high is None else (low, high)
    return wording.estimate(row[name], interval, row["unit"] or "")


def _percent(share: float | None) -> str:
    return "" if share is None else wording.percent(100.0 * share)


def _fallen(row: Row) -> str:
    """The error of the base model and that of the last one, where they differ."""
    before, after = shown(row, "rmse_before"), shown(row, "rmse_after")
    return after if before == after else f"{before} to {after}"


def _link(row: dict[str, Any], folder: Path | None) -> str:
    if row["study"] is None:
        return ""
    study = str(row["study"])
    own = f"pages/{Path(study).stem}.html"
    return quote(own if folder is not None and (folder / own).is_file() else study)
