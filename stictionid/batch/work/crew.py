"""Executors of a batch with the interface of `concurrent.futures`: local processes or a Dask cluster.

Both have `submit`, `room` (number of tasks that keeps them busy), `sure` (true where a death is known to belong to the
call itself, not to a call beside it), `dead` (true where the worker died under the call, rather than the call failing),
`lost` (true where the whole crew is gone) and `shutdown`. Nothing else in the batch knows which of the two it has.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any

from ..._version import __version__
from ...errors import UsageError
from .worker import SINGLE_THREADED, version

# A scheduler that does not answer within this time counts as absent. Unit: s.
_REACHED_S = 5.0


class Processes(Executor):
    """Local worker processes, each a pool of one, so that a death concerns one known call.

    They are spawned, not forked: a fork would copy locks of threads that do not exist in it. Workers ignore Ctrl-C (the
    parent decides) and end themselves when the parent is gone.
    """

    sure = True

    def __init__(self, jobs: int) -> None:
        self.room = jobs
        self._free: list[ProcessPoolExecutor] = []
        self._all: list[ProcessPoolExecutor] = []
        self._guard = threading.Lock()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run the call in a free worker, or in a new one where none is free; the caller keeps to `room`."""
        while True:
            with self._guard:
                pool = self._free.pop() if self._free else None
            if pool is None:
                pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)
                self._all.append(pool)
            try:
                with _one_thread_each():
                    future = pool.submit(fn, *args, **kwargs)
            except BrokenProcessPool:
                self._all.remove(pool)  # it died idle, so no loop is lost
                continue
            future.add_done_callback(partial(self._back, pool))
            return future

    def _back(self, pool: ProcessPoolExecutor, future: Future[Any]) -> None:
        broken = future.cancelled() or isinstance(future.exception(), BrokenProcessPool)
        with self._guard:
            if not broken:
                self._free.append(pool)
            elif pool in self._all:
                self._all.remove(pool)

    def dead(self, error: BaseException) -> bool:
        """True for a broken pool: in a pool of one the worker is dead."""
        return isinstance(error, BrokenProcessPool)

    def lost(self, error: BaseException) -> bool:
        """Always False: a new process replaces a dead one."""
        return False

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers; without `wait` they are killed."""
        for pool in self._all:
            processes = list((getattr(pool, "_processes", None) or {}).values())
            pool.shutdown(wait=wait, cancel_futures=cancel_futures)
            if not wait:
                for process in processes:
                    process.kill()


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Limit the libraries of a starting worker to one core: they look before any of this package's code runs."""
    before = {name: os.environ.get(name) for name in SINGLE_THREADED}
    os.environ.update(dict.fromkeys(SINGLE_THREADED, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _begin() -> None:
    """Start of a worker: leave Ctrl-C to the parent, and end when the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent,), daemon=True).start()


def _follow(parent: Any) -> None:
    parent.join()
    os._exit(1)


class Cluster:
    """A Dask cluster through its executor interface; twice as many calls as cores keep it busy.

    Its scheduler repeats a call by itself after a death (three times by default). Then it gives up the call and all
    others that waited for the same workers.
    """

    sure = False

    def __init__(self, address: str) -> None:
        try:
            import distributed
        except ImportError:
            raise UsageError("--scheduler needs Dask, which is not installed",
                             "pip install distributed, or leave --scheduler out") from None
        import logging

        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._errors: Any = distributed
        self._address = address
        self._client = _client(distributed, address)
        try:
            try:
                self._client.wait_for_workers(1, timeout=_REACHED_S)
            except Exception:
                raise UsageError(f"the scheduler {address} has no workers",
                                 f"start some with dask worker {address} --nthreads 1") from None
            self.room = 2 * sum(self._client.ncores().values())
            self._executor = self._client.get_executor(pure=False, retries=0)
            self._check_workers()
        except BaseException:
            self._client.close(timeout=1)
            raise

    def _check_workers(self) -> None:
        """Refuse workers without this program, or with another version of it."""
        try:
            there = self._client.run(version)
        except Exception as error:
            raise UsageError(f"the workers of {self._address} can't run stictionid: {type(error).__name__}: "
                             f"{str(error)[:120]}", f"install stictionid {__version__} where they run") from None
        for worker, theirs in sorted(there.items()):
            if theirs != __version__:
                raise UsageError(f"the worker {worker} runs stictionid {theirs}, this is {__version__}",
                                 f"install stictionid {__version__} where it runs")

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run the call somewhere on the cluster."""
        return self._executor.submit(fn, *args, **kwargs)

    def dead(self, error: BaseException) -> bool:
        """True for Dask's KilledWorker, its answer once it gives up a call."""
        return isinstance(error, self._errors.scheduler.KilledWorker)

    def lost(self, error: BaseException) -> bool:
        """True for calls that are cancelled, or whose connection closes, without a request from here."""
        import asyncio
        from concurrent.futures import CancelledError

        return isinstance(error, (CancelledError, asyncio.CancelledError, self._errors.CancelledError,
                                  self._errors.comm.CommClosedError)) \
            or type(error).__name__ in ("FutureCancelledError", "FuturesCancelledError")

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster as it was; the calls still running for this batch are cancelled."""
        with contextlib.suppress(Exception):
            self._executor.shutdown(wait=wait)
        with contextlib.suppress(Exception):
            self._client.close(timeout=2)


def _client(distributed: Any, address: str) -> Any:
    """A client of the scheduler at an address; UsageError where no scheduler answers there."""
    hint = "start one with dask scheduler, and give its tcp://HOST:PORT"
    known = re.fullmatch(r"(tcp|tls)://(\[[^\]]+\]|[^:/\s]+):(\d{1,5})", address)
    if known is None or not 0 < int(known[3]) < 65536:
        raise UsageError(f"{address!r} is no address of a scheduler", hint)

    class Quiet(distributed.Client):  # type: ignore[misc]
        """A client that could not connect, without a second wait when it is discarded."""

        def __del__(self) -> None:
            pass

    try:
        # Ask the port first: a closed one is known at once, while Dask would try for the whole time.
        socket.create_connection((known[2].strip("[]"), int(known[3])), timeout=_REACHED_S).close()
        return Quiet(address, timeout=f"{_REACHED_S:g}s", set_as_default=False)
    except OSError as error:
        raise UsageError(f"the scheduler {address} can't be reached: {error.strerror or error}", hint) from None
    except Exception:  # another program's answer ends in some error of Dask's
        raise UsageError(f"what answers at {address} is no Dask scheduler that this version understands", hint) \
            from None


Crew = Processes | Cluster


def crew_for(jobs: int, scheduler: str | None) -> Crew:
    """The crew for the options. UsageError where a scheduler cannot be reached."""
    return Cluster(scheduler) if scheduler is not None else Processes(jobs)
