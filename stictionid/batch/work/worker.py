"""One task in a worker: read, check whether its study exists already, study, return. It writes nothing.

Every fault of a loop ends in its outcome; only the death of the process does not.
"""

from __future__ import annotations

import functools
import os
import socket
import time
import traceback
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from ..._version import __version__
from ...errors import DataError, StictionidError
from ...historian.bytes.options import ALL_TAGS
from ...historian.bytes.source import PARQUET, open_source
from ...historian.dataset import narrowed, open_dataset, rows_of, table_per_tag
from ...historian.reading import read, reading_of
from ...historian.table.formats import read_table
from ...historian.table.table import Table
from ...record.loop import Loop
from ...record.rhythm import rhythm_of
from ...record.study import Study, to_json
from ...system.files import sha256_of
from ..task import ABSTAINED, FAILED, OK, Task, TaskOutcome, Work
from .warm import first_turn

# Libraries that would start threads of their own: every worker has one core.
SINGLE_THREADED = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
                   "VECLIB_MAXIMUM_THREADS")
_DETAIL = 4000

# Cache from one loop to the next: the last table with several loops, dataset, fingerprint. Threads of a cluster's
# worker may do the work twice, but never see half of it.
_table: dict[str, tuple[Any, Table]] = {}
_opened = functools.lru_cache(maxsize=1)(open_dataset)


def attempt(task: Task, work: Work) -> TaskOutcome:
    """The outcome of one task; never raises an Exception."""
    times: dict[str, float] = {}
    begun = time.perf_counter()
    detail = ""
    try:
        if pa.cpu_count() != 1:
            pa.set_cpu_count(1)
            pa.set_io_thread_count(1)
        out = _study(task, work, times)
    except StictionidError as error:
        out = TaskOutcome(task.key, FAILED, None, error.message + (f"; {error.hint}" if error.hint else ""))
    except MemoryError:
        out = TaskOutcome(task.key, FAILED, None, "not enough memory for this record; cut it with --start and --end")
    except Exception as error:
        detail = "".join(traceback.format_exception(error))[-_DETAIL:]
        out = TaskOutcome(task.key, FAILED, None, f"a defect in the program: {type(error).__name__}: {error}")
    times["total"] = time.perf_counter() - begun
    return replace(out, seconds=times, worker=f"{socket.gethostname()}:{os.getpid()}", detail=detail,
                   version=__version__)


def version() -> str:
    """The version of the program that a worker runs."""
    return __version__


def _study(task: Task, work: Work, times: dict[str, float]) -> TaskOutcome:
    clock = time.perf_counter
    start = clock()
    if task.problem:
        raise DataError(task.problem)
    sha256 = fingerprint_of(task)
    reading = None if sha256 is not None and sha256 == task.have else read_task(task, sha256)
    if reading is None:
        return TaskOutcome(task.key, task.had, kept=True)
    loop = replace(reading.loop, name=task.loop)
    times["read"] = clock() - start
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        study = _done(loop, replace(work, options=replace(work.options, command=task.command)), times)
    found = study.range
    study = replace(study, rhythm=rhythm_of(loop, found.period_median_s) if found.oscillating else None)
    status = ABSTAINED if study.estimate is None and study.verdict.evidence.code is not None else OK
    # A path may hold bytes that are no UTF-8; the study must be a valid file all the same.
    text = to_json(study).encode("utf-8", "replace").decode("utf-8")
    page = _page(loop, study, times) if work.pages else None
    return TaskOutcome(task.key, status, text, study.verdict.reason if status == ABSTAINED else "", page=page)


def _page(loop: Loop, study: Study, times: dict[str, float]) -> str:
    """The loop's report as one HTML page."""
    from ...reports.pages.html import html
    from ...reports.pictures.curves import Case, curves
    from ...reports.pictures.gallery import pictures

    start = time.perf_counter()
    case = Case(study, loop, tuple(curves(study, loop)))
    page = html([case], [pictures(case)])
    times["page"] = time.perf_counter() - start
    return page


def _done(loop: Loop, work: Work, times: dict[str, float]) -> Study:
    clock, start = time.perf_counter, time.perf_counter()
    with first_turn(work.level):
        if work.level == "screen":
            from ...verbs.screen import screen

            study = screen(loop, options=work.options)
            times["screen"] = clock() - start
            return study
        from ...verbs.identify import identify

        study = identify(loop, options=work.options, policy=work.policy)
        times["identify"] = clock() - start
        if work.level in ("diagnose", "study") and study.steps:
            from ...verbs.diagnose import diagnose

            start = clock()
            study = diagnose(loop, study, apply=True, seed=work.options.seed, policy=work.policy)
            times["diagnose"] = clock() - start
    return study


def fingerprint_of(task: Task) -> str | None:
    """SHA-256 of the task's file, computed once per file; None for folders, where it comes with the rows."""
    if task.kind == "tags" or not os.path.isfile(task.path):
        return None
    state = os.stat(task.path)
    return _sha256(task.path, state.st_mtime_ns, state.st_size)


@functools.lru_cache(maxsize=1)
def _sha256(path: str, changed_ns: int, size: int) -> str:
    """SHA-256 of a file as it was when it had this size and was changed at this time."""
    return sha256_of(path)


def read_task(task: Task, sha256: str | None) -> Any:
    """The Reading of the task's loop; None where its rows are those of the existing study."""
    path = Path(task.path)
    if task.kind == "tags":
        source, table = table_per_tag(path, [Path(f) for f in task.files], task.reading)
        return None if source.sha256 == task.have else reading_of(source, table, task.reading)
    if task.kind == "dataset" or (task.kind == "wide" and path.suffix.lower() in PARQUET):
        return _of_dataset(task, path, sha256)
    if task.kind == "part" or (task.kind == "file" and task.reading.loop is None):
        return read(path, options=task.reading)
    return _of_table(task, path)


def _of_dataset(task: Task, path: Path, sha256: str | None) -> Any:
    source, table = rows_of(_opened(path), task.select)
    # A single file is known by its bytes, as everywhere; a folder by the rows of the loop.
    source = replace(source, sha256=sha256 or source.sha256)
    if source.sha256 == task.have:
        return None
    return reading_of(source, table, task.reading)


def _of_table(task: Task, path: Path) -> Any:
    """A loop of a text file with several: the file is parsed once and kept until another one comes."""
    kept = _table.get(task.path)
    if kept is None:
        source = open_source(path)
        kept = replace(source, data=b""), read_table(source, task.reading)
        _table.clear()
        _table[task.path] = kept
    source, table = kept
    # (Other loops of a table may be what disturbs this one.)
    narrow = task.select and ALL_TAGS not in task.reading.extra
    return reading_of(source, narrowed(table, task.select) if narrow else table, task.reading)

