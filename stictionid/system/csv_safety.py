"""Cells of CSV and TSV files from foreign text, quoted so that no spreadsheet takes one for a formula."""

from __future__ import annotations

# First characters of a cell that a spreadsheet takes for a formula. Source: OWASP, "CSV Injection".
_FORMULA = "=+-@\t\r"


def cell(text: str, separator: str = ",") -> str:
    """`text` as one cell: control characters become blanks, a formula gets a leading ', quotes where CSV needs them.

    For text only: numbers are written as they are, so that -1.5 stays a number.
    """
    flat = harmless(text)
    if separator in flat or '"' in flat or flat != flat.strip():
        return '"' + flat.replace('"', '""') + '"'
    return flat


def harmless(text: str) -> str:
    """`text` without control characters, and a leading ' where a spreadsheet would take it for a formula; no quotes."""
    flat = "".join(c if c.isprintable() else " " for c in text)
    hostile = text[:1] in tuple(_FORMULA) or flat.lstrip()[:1] in tuple(_FORMULA)
    return "'" + flat if hostile else flat
