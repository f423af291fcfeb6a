"""The order of a summary: worst loop first, by what the valve does to the process. The one place that decides it."""

from __future__ import annotations

from typing import Any

from ..task import FAILED

_VERDICTS = {"stiction": 0, "undecided": 1, "no stiction": 2}
_NO_VERDICT = 3


def rank_key(row: dict[str, Any]) -> tuple[Any, ...]:
    """Sorts summary rows: sticking valves first, by the share of PV's variance they cause, then S, J; failed last."""
    return (row["status"] == FAILED, _VERDICTS.get(row["verdict"] or "", _NO_VERDICT),
            *(-(row[name] or 0.0) for name in ("friction_share", "S", "J")), row["loop"])
