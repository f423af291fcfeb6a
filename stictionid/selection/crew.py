"""Tasks of the search in several processes or in this one, as long as its budget lasts.

Answers come in the order of the tasks, equal for any number of processes. Other processes are forked, so they inherit
kernels, data and model at no cost. Where the system can't fork everything runs in this process.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..system import evaluations
from .looks import Ground, Packed, Task, perform_task
from .node import key

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

Work = Callable[[Ground, Task], Packed]
_GROUND: Ground | None = None


def _enter(ground: Ground) -> None:
    global _GROUND
    _GROUND = ground
    # The parent answers an interrupt for all, and shows the progress.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    evaluations.listeners.clear()


def _call(work: Work, task: Task) -> Packed:
    assert _GROUND is not None
    return work(_GROUND, task)


class Crew:
    """Runs tasks over one ground, in `jobs` processes or in this one; answers come in the order of the tasks."""

    def __init__(self, ground: Ground, jobs: int) -> None:
        self.ground = ground
        self._pool = _fork_pool(jobs, ground) if jobs > 1 else None

    def map(self, tasks: Sequence[Task], work: Work = perform_task) -> Iterator[Packed]:
        """The answers to tasks, one after the other."""
        if self._pool is None:
            return (work(self.ground, task) for task in tasks)
        return self._pool.map(_call, [work] * len(tasks), tasks)

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=kind is None, cancel_futures=True)


def _fork_pool(jobs: int, ground: Ground) -> ProcessPoolExecutor | None:
    """So many processes that hold the ground; None where the system can't fork."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    if "fork" not in multiprocessing.get_all_start_methods():
        return None
    return ProcessPoolExecutor(jobs, multiprocessing.get_context("fork"), _enter, (ground,))


@dataclass(slots=True)
class Budget:
    """Evaluations that a search may spend, those that it spent, and the nodes that it did not expand."""

    # Evaluations allowed, and samples that count as one.
    allowed: float
    unit: int
    spent: int = 0
    # Those for valves that are searched once for a record, charged to nothing: they are few, and bounded.
    once: int = 0
    # Evaluations spent after the budget on late answers, and the limit of `spent` for the answer in work.
    apart: int = 0
    until: float = 0.0
    unasked: list[str] = field(default_factory=list)
    # Searches for valves that were counted already.
    questions: set[str] = field(default_factory=set)

    @property
    def over(self) -> bool:
        """True where nothing is left to spend."""
        return self.share >= 1 and self.spent >= self.until

    @property
    def share(self) -> float:
        """Evaluations spent over those allowed, late answers left out; last questions may raise it to 2."""
        return (self.spent - self.apart) / self.allowed

    @property
    def counted(self) -> int:
        """All evaluations, those that are charged to nothing included."""
        return self.spent + self.once

    @contextmanager
    def allow_late_answer(self) -> Iterator[None]:
        """Allow half the budget more for a best node found at its end; nothing once such answers took a budget."""
        before, self.until = self.spent, self.spent + self.allowed / 2 if self.apart < self.allowed else 0.0
        yield
        self.apart, self.until = self.apart + self.spent - before, 0.0

    @contextmanager
    def allow_last_question(self) -> Iterator[None]:
        """Allow a whole budget for one last question, whatever was spent before; it takes few looks."""
        spent, apart = self.spent, self.apart
        self.spent = self.apart = 0
        yield
        self.spent, self.apart = self.spent + spent, self.apart + apart

    def note_unasked(self, names: Iterable[str]) -> None:
        """Note nodes that the search does not come to, each once."""
        self.unasked += [name for name in dict.fromkeys(names) if name not in self.unasked]

    def answers(self, crew: Crew, tasks: Sequence[Task], always: bool = False) -> Iterator[tuple[Task, Packed]]:
        """Tasks with their answers while the budget lasts, or `always`; the remaining nodes are noted as unasked."""
        answers = iter(crew.map(tasks))
        for i, task in enumerate(tasks):
            if self.over and not always:
                self.note_unasked(key(left.spec) for left in tasks[i:])
                return
            answer = next(answers)
            # A search that several tasks share counts once.
            fresh = {q: samples for q, samples in answer.questions.items() if q not in self.questions}
            self.questions |= fresh.keys()
            self.spent += answer.spent
            self.once += sum(fresh.values()) // self.unit
            yield task, answer
