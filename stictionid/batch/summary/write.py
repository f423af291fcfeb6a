"""Files of a summary, made from the store: CSV, Parquet, markdown and page."""

from __future__ import annotations

from ...system.files import write_whole
from ..work.store import Store
from .page import page_of
from .rows import Row, as_csv, as_markdown, as_parquet, rows_of


def write_summary(store: Store) -> list[Row]:
    """Write summary.csv, .parquet, .md and .html from the store and return the rows. UsageError as `write_whole`."""
    rows = rows_of(store)
    made: dict[str, bytes | str] = {"summary.csv": as_csv(rows), "summary.md": as_markdown(rows),
                                    "summary.parquet": as_parquet(rows), "summary.html": page_of(rows, store.folder)}
    for name, content in made.items():
        write_whole(store.folder / name, content, force=True)
    return rows
