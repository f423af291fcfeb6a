"""Settings of the whole suite: one BLAS thread, one core a worker, one source for all, each kernel compiled once."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
# Tests of a run that needs most kernels; fewer compile what they ask for.
_WHOLE_SUITE = 1000

# Read by numpy when it is first imported, and by the processes that tests start.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# Workers of the suite keep all cores busy: none of them starts helpers to compile kernels.
os.environ["STICTIONID_COMPILE_ALONE"] = "1"
# Processes that tests start find the bytecode of the modules: without it each compiles some thousand of them.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# Processes in other folders run the source under test, not an installed copy, and find the kernels compiled so far.
# Under PYTHONSAFEPATH it is the installed copy that is tested (.ci/elsewhere.py).
if not sys.flags.safe_path:
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])


def _compile_each_kernel_once() -> None:
    """Make a test worker that needs a kernel wait for the one that compiles it; numba's cache then hands it over."""
    try:
        import fcntl
    except ImportError:
        return
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    compiled = Dispatcher.compile

    def once(self: Any, signature: Any) -> Any:
        folder = getattr(self._cache, "cache_path", None)
        if folder is None:
            return compiled(self, signature)
        Path(folder).mkdir(parents=True, exist_ok=True)
        # Threads of this process first, then other processes: in the other order each could wait for the other.
        name = f".{self.py_func.__module__}.{self.py_func.__qualname__}.lock"
        with global_compiler_lock, open(Path(folder) / name, "a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return compiled(self, signature)

    Dispatcher.compile = once


def _keep_to_one_core() -> None:
    """Give a test worker a core of its own, so that a command starts no processes for those of the other workers.

    A search with a small budget asks ahead in two processes, and takes eight times the processor time (measured).
    """
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        worker = int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw"))
        os.sched_setaffinity(0, {cores[worker % len(cores)]})


def pytest_collection_finish(session: pytest.Session) -> None:
    """Let each worker compile its share of the kernels of `identify` before the first test.

    The first tests of all workers need the same kernels: without shares one worker compiles and the others wait. This
    holds for the whole suite and for the tests of printed text.
    """
    many = len(session.items) >= _WHOLE_SUITE or session.config.option.markexpr == "printed"
    if many and "PYTEST_XDIST_WORKER" in os.environ:
        from stictionid.numerics.machine_code import ahead

        worker = int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw"))
        ahead.compile_share(worker, int(os.environ["PYTEST_XDIST_WORKER_COUNT"]), lambda: True)


if "PYTEST_XDIST_WORKER" in os.environ:
    _compile_each_kernel_once()
    _keep_to_one_core()
