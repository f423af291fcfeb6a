"""Bookkeeping of rows: every row of the file is either used or listed under exactly one reason."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

REASONS = (
    "used",
    "filled",
    "bad",
    "no time",
    "duplicate",
    "off grid",
    "resampled",
    "outside window",
    "masked",
    "manual",
    "start-up",
    "saturated",
    "other valve",
    "frozen",
    "repeat",
    "short segment",
    "other tag",
    "other loop",
    "repeated header",
    "footer",
    "damaged",
    "blank",
)
"""Reasons a row can have. Filled, masked, manual, start-up, saturated, other-valve and frozen rows stay in the loop,
unused, and so do bad ones and repeats of PV inside a stretch of OP."""

CODE = {reason: code for code, reason in enumerate(REASONS)}


class RowBook:
    """Reason of each row of a table; the first reason given to a row stays."""

    def __init__(self, rows: int, dropped: dict[str, int]) -> None:
        self._reason: NDArray[np.uint8] = np.zeros(rows, np.uint8)
        self._dropped = dropped

    def mark(self, rows: NDArray[Any], reason: str) -> None:
        """Give rows (indices, of which -1 is no row, or a mask) a reason unless they have one."""
        rows = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows[rows >= 0]
        self._reason[rows[self._reason[rows] == 0]] = CODE[reason]

    def mark_codes(self, rows: NDArray[np.int64], codes: NDArray[np.uint8]) -> None:
        """Give each of `rows` (-1 = no row) the reason with the code at the same place in `codes`; 0 leaves it used."""
        wanted = (rows >= 0) & (codes > 0)
        rows, codes = rows[wanted], codes[wanted]
        free = self._reason[rows] == 0
        self._reason[rows[free]] = codes[free]

    def first(self, reason: str) -> int | None:
        """The first row (index) that has this reason; None where no row has it."""
        rows = np.flatnonzero(self._reason == CODE[reason])
        return int(rows[0]) if rows.size else None

    def counts(self) -> dict[str, int]:
        """Rows in, rows used, and rows by reason; they add up."""
        found = np.bincount(self._reason, minlength=len(REASONS))
        listed = {reason: int(found[code]) for code, reason in enumerate(REASONS) if code and found[code]}
        for reason, count in self._dropped.items():
            if count:
                listed[reason] = listed.get(reason, 0) + count
        return {"in": self._reason.size + sum(self._dropped.values()), "used": int(found[0]), **listed}
