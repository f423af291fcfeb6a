"""The manual test that would settle an open answer, as a frozen dataclass of a study."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate


@dataclass(frozen=True, slots=True)
class ValveAnswer:
    """One answer that a test has to tell from the others: S and J in the unit of OP, both 0 for a valve that follows.
    """

    S: float
    J: float


@dataclass(frozen=True, slots=True)
class PlannedTest:
    """Steps of OP in manual that tell the answers apart; without `moves` the `reason` says why there is no such test.

    OP rests at `start` for `hold_s` seconds, then takes one of the `moves` every `hold_s` seconds. PV moves by at most
    `pv_change`, whichever answer is true. `likelihood_ratio` is the expected one, twice its logarithm, of the two
    answers that are most alike; `needed` is the least that settles. Limits that nobody gave are named in `assumed` as
    "op" or "pv". `otherwise` names the record that would do where no test is possible.
    """

    answers: tuple[ValveAnswer, ...]
    start: float
    moves: tuple[float, ...]
    hold_s: float
    pv_change: float
    likelihood_ratio: float
    needed: float
    op_limits: tuple[float, float]
    pv_limits: tuple[float, float]
    assumed: tuple[str, ...] = ()
    reason: str = ""
    otherwise: str = ""

    @property
    def duration_s(self) -> float:
        """Seconds from the start to the end of the last hold."""
        return (len(self.moves) + 1) * self.hold_s

    @property
    def csv(self) -> str:
        """The steps as CSV: seconds since the start, and OP from then on; the last row is the end."""
        levels = [*accumulate(self.moves, initial=self.start)]
        rows = [*((i * self.hold_s, level) for i, level in enumerate(levels)), (self.duration_s, levels[-1])]
        return CSV_HEAD + "".join(f"{time:.10g},{output:.10g}\n" for time, output in rows)


CSV_HEAD = "time_s,OP\n"
"""First line of the steps as CSV, by which an older file of this kind may be replaced."""
