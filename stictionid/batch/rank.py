"""The order of a summary: worst loop first. The one place to change when severity is told in money."""

from __future__ import annotations

from typing import Any

from .task import FAILED

_VERDICTS = {"stiction": 0, "undecided": 1, "no stiction": 2}
_NO_VERDICT = 3


def rank_key(row: dict[str, Any]) -> tuple[Any, ...]:
    """Sorts summary rows: sticking valves first, by S, then J, then friction's share of PV; failed loops last."""
    return (row["status"] == FAILED, _VERDICTS.get(row["verdict"] or "", _NO_VERDICT),
            *(-(row[name] or 0.0) for name in ("S", "J", "friction_share")), row["loop"])
