"""Tasks of the search in several processes or in this one: answers in the order of the tasks, equal for any number.

Other processes are forked, so they inherit kernels, data and model at no cost. Where the system can't fork everything
runs in this process.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor

from .looks import Ground, Packed, Task, performed

Work = Callable[[Ground, Task], Packed]
_GROUND: Ground | None = None


def _enter(ground: Ground) -> None:
    global _GROUND
    _GROUND = ground
    # The parent answers an interrupt for all.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _call(work: Work, task: Task) -> Packed:
    assert _GROUND is not None
    return work(_GROUND, task)


class Crew:
    """Runs tasks over one ground, in `jobs` processes or in this one; answers come in the order of the tasks."""

    def __init__(self, ground: Ground, jobs: int) -> None:
        self.ground = ground
        self._pool: ProcessPoolExecutor | None = None
        if jobs > 1 and "fork" in multiprocessing.get_all_start_methods():
            self._pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("fork"), _enter, (ground,))

    def map(self, tasks: Sequence[Task], work: Work = performed) -> Iterator[Packed]:
        """The answers to tasks, one after the other."""
        if self._pool is None:
            return (work(self.ground, task) for task in tasks)
        return self._pool.map(_call, [work] * len(tasks), tasks)

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=kind is None, cancel_futures=True)
