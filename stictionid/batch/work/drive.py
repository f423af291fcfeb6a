"""The main loop of a batch: keeps a crew busy with tasks and passes the outcomes to the store."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass, replace
from typing import Any

from ..._version import __version__
from ...errors import StictionidError, UsageError
from ..task import ABSTAINED, FAILED, Task, TaskOutcome, Work
from .crew import Crew
from .store import Store
from .worker import attempt as do_task

# Interval of the progress calls while no loop ends. Unit: s.
_PULSE_S = 0.5


@dataclass(slots=True)
class Tally:
    """Progress of a batch; `rate_per_s` counts loops worked on, not those kept from an earlier run."""

    total: int = 0
    done: int = 0
    failed: int = 0
    abstained: int = 0
    kept: int = 0
    begun: float = 0.0

    @property
    def rate_per_s(self) -> float:
        """Loops a second so far."""
        spent = time.monotonic() - self.begun
        return (self.done - self.kept) / spent if spent > 0 else 0.0

    @property
    def left_s(self) -> float | None:
        """Seconds left at this rate; None before the first loop is done."""
        return (self.total - self.done) / self.rate_per_s if self.rate_per_s > 0 else None


Tell = Callable[[Tally, Task | None, TaskOutcome | None], None]


def drive(tasks: Iterable[Task], work: Work, crew: Crew, store: Store, *, resume: bool = False,
          tell: Tell | None = None, attempt: Callable[[Task, Work], TaskOutcome] = do_task) -> Tally:
    """Do every task and keep every outcome, in the order of their arrival.

    `tell` is called for each outcome, and twice a second without one. A worker's death costs its loop one retry; then
    the loop has failed. Where the death may belong to another call, the retry comes last and alone. Raises UsageError
    where an outcome cannot be written or the crew is gone; kept outcomes stay.
    """
    tasks = list(tasks)
    waiting, suspects = deque(enumerate(tasks)), deque[tuple[int, Task]]()
    flying: dict[Future[TaskOutcome], tuple[int, Task]] = {}
    died: set[int] = set()
    tally = Tally(len(tasks), begun=time.monotonic())
    say = tell or (lambda tally, task, out: None)

    def fill() -> None:
        if not waiting and not flying and suspects:
            waiting.append(suspects.popleft())  # one at a time, so that a death has one cause
        while waiting and len(flying) < crew.room:
            number, task = waiting.popleft()
            if resume:
                have, had = store.standing(task, pages=work.pages)
                task = replace(task, have=have, had=had)
            flying[_handed_in(crew, attempt, task, work)] = (number, task)

    fill()
    while flying:
        landed, _ = wait(flying, timeout=_PULSE_S, return_when=FIRST_COMPLETED)
        ready = [(flying.pop(future), future) for future in landed]
        again = [(number, task) for (number, task), future in ready if _to_repeat(future, crew, number, died)]
        if crew.sure:
            waiting.extendleft(reversed(again))
        else:
            suspects.extend(again)
        try:
            fill()  # before the outcomes are written: workers should not wait for the disk
        finally:
            for (number, task), future in sorted(ready, key=lambda r: r[0][0]):
                if any(number == other for other, _ in again):
                    continue
                out = _outcome(future, task, crew)
                store.keep(task, out)
                tally.done += 1
                tally.failed += out.status == FAILED
                tally.abstained += out.status == ABSTAINED
                tally.kept += out.kept
                say(tally, task, out)
        if not landed:
            say(tally, None, None)
    return tally


def _handed_in(crew: Crew, attempt: Callable[[Task, Work], TaskOutcome], task: Task, work: Work) -> Future[TaskOutcome]:
    try:
        return crew.submit(attempt, task, work)
    except StictionidError:
        raise
    except Exception as error:  # a closed connection, a process that cannot be started: each library has its own error
        raise UsageError(f"no more work can be handed out: {type(error).__name__}: {str(error)[:120]}",
                         "see that workers can be started") from None


def _to_repeat(future: Future[TaskOutcome], crew: Crew, number: int, died: set[int]) -> bool:
    """True where the worker died under the call for the first time."""
    error = _error(future)
    if error is None or number in died or not crew.dead(error):
        return False
    died.add(number)
    return True


def _error(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _outcome(future: Future[TaskOutcome], task: Task, crew: Crew) -> TaskOutcome:
    error = _error(future)
    if error is None:
        out = future.result()
        if out.version and out.version != __version__:
            raise UsageError(f"a worker runs stictionid {out.version}, this is {__version__}",
                             f"install stictionid {__version__} where it runs")
        return out
    if crew.dead(error):
        return TaskOutcome(task.key, FAILED, None,
                       "its worker process died every time it was tried (killed, out of memory, or crashed)")
    if isinstance(error, StictionidError):
        raise error
    if crew.lost(error):
        raise UsageError("the workers are gone: the scheduler no longer answers", "start it again")
    return TaskOutcome(task.key, FAILED, None, f"a defect in the program: {type(error).__name__}: {error}"[:500])
