"""The order of a summary: worst loop first, by the verdict, the size of the stickband and the valve's share."""

from __future__ import annotations

from typing import Any

from ...reports.wording import SEVERITY_BANDS
from ..task import ABSTAINED, FAILED, SKIPPED

_VERDICTS = {"stiction": 0, "undecided": 1, "no stiction": 2}
_NO_VERDICT = 3
_LAST = {ABSTAINED: 1, FAILED: 2, SKIPPED: 3}
_BANDS = ", ".join(f"{word} from {low:g} %" for (low, _), (_, word)
                   in zip(SEVERITY_BANDS[-2::-1], SEVERITY_BANDS[:0:-1], strict=True))
# The rule in words; `rank_key` is the rule.
RULE = (f"Worst first: valves that stick, then undecided ones, then the others. Among them the band of S decides "
        f"({_BANDS}), within a band the share of PV's swing about its setpoint that a perfect valve would take away, "
        "then S. Loops without an answer and failed ones come last.")


def rank_key(row: dict[str, Any]) -> tuple[Any, ...]:
    """Sort key of summary rows, as `RULE` says; skipped files stand last."""
    S = row["S"] or 0.0
    return (_LAST.get(row["status"], 0), _VERDICTS.get(row["verdict"] or "", _NO_VERDICT),
            -sum(limit <= S for limit, _ in SEVERITY_BANDS),
            *(-(row[name] or 0.0) for name in ("friction_share", "S", "J")), row["loop"])
