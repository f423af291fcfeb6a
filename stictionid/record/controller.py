"""Controller of a record as a study keeps it, and the steps in which its signals were recorded."""

from __future__ import annotations

from dataclasses import dataclass, field

ROUNDED, FULL = "rounded", "full"
# Codes of the findings on the command: recorded with all its digits, rebuilt, rounded for the valve, too, and rounded
# with the digits lost.
FINE, REBUILT, SEEN_ROUNDED, LEFT = COMMAND_FINDINGS = "full-command", "rebuilt-command", "rounded-command", \
    "digits-lost"


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps in which output and process value were recorded, in their units; null where none shows."""

    output: float | None = None
    process_value: float | None = None


@dataclass(frozen=True, slots=True)
class Controller:
    """Law of the controller that made the output: "P", "PI" or "PID", with 90 % intervals of its numbers.

    The gain is in the unit of the output per unit of the process value, times in seconds. `residual` is the rms
    distance of law and output. `rebuilt` is true where the model runs on the output of the law in place of the recorded
    one. `seen_by_valve` is "rounded" for a valve that follows the output as recorded, and "full" for one that follows
    it as computed.
    """

    kind: str
    gain: float
    integral_time_s: float | None
    derivative_time_s: float | None
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    residual: float = 0.0
    rebuilt: bool = False
    seen_by_valve: str = FULL
