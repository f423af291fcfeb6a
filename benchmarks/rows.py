"""Rows of a benchmark, one JSON line a task: a run that stops is continued, and rows of several runs are one table."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import get_context
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def options(parser: argparse.ArgumentParser, *, out: str) -> None:
    """Add the options of a run that can be continued: --out, --minutes, --jobs, --seed."""
    parser.add_argument("--out", default=out, help="rows, one JSON line a task; those in it are skipped")
    parser.add_argument("--minutes", type=float, default=60.0, help="no new task after so long")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1000)


def read(path: Path | str) -> list[Row]:
    """Rows of a file; a last line that an interrupted run has cut is left out."""
    path = Path(path)
    if not path.exists():
        return []
    found = []
    for line in path.read_text().splitlines():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


def run(tasks: Iterable[tuple[str, tuple[Any, ...]]], one: Callable[..., Row], given: argparse.Namespace) -> list[Row]:
    """Rows of all tasks done so far. A task is its key and the arguments of `one`; done keys are skipped."""
    out, stop = Path(given.out), time.monotonic() + 60.0 * given.minutes
    done = {row["key"] for row in read(out)}
    left = iter([(key, call) for key, call in tasks if key not in done])
    with out.open("a") as file, ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        if out.stat().st_size and not out.read_bytes().endswith(b"\n"):
            file.write("\n")  # the last run was cut within a line
        running: dict[Future[Row], str] = {}
        while True:
            while len(running) < given.jobs and time.monotonic() < stop and (task := next(left, None)):
                running[pool.submit(one, *task[1])] = task[0]
            if not running:
                break
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                row = {"key": running.pop(future), **future.result()}
                print(json.dumps(row), file=file, flush=True)
    return read(out)
