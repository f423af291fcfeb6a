"""The order of a summary: worst loop first, by the effect of the valve on the process."""

from __future__ import annotations

from typing import Any

from ..task import FAILED, SKIPPED

_VERDICTS = {"stiction": 0, "undecided": 1, "no stiction": 2}
_NO_VERDICT = 3


def rank_key(row: dict[str, Any]) -> tuple[Any, ...]:
    """Sort key of summary rows: sticking valves first, by their share of PV's variance, then S, J.

    Failed loops come after the others, skipped files last.
    """
    return (row["status"] == SKIPPED, row["status"] == FAILED, _VERDICTS.get(row["verdict"] or "", _NO_VERDICT),
            *(-(row[name] or 0.0) for name in ("friction_share", "S", "J")), row["loop"])
