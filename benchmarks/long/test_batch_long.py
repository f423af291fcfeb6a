"""Batches at length: a worker that dies costs its loop one retry."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
import test_batch
from test_batch import RESULTS, content, run

from stictionid.batch.summary.rows import rows_of
from stictionid.batch.task import FAILED, OK, Task, TaskOutcome, Work
from stictionid.batch.work.crew import Processes, crew_for
from stictionid.batch.work.worker import attempt

# Fixtures of tests/.
site, todo, clean = test_batch.site, test_batch.todo, test_batch.clean


def test_a_dead_worker_costs_its_loop_one_retry_and_nobody_else_anything(todo, clean, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("STICTIONID_TEST_ONCE", str(tmp_path / "once"))
    store = run(todo, tmp_path / "out", crew=Processes(2), attempt=dying)
    rows = {row["loop"]: row for row in rows_of(store)}
    assert rows["FIC100"]["status"] == FAILED and "died every time" in rows["FIC100"]["message"]
    assert {n: r["status"] for n, r in rows.items() if n not in ("FIC100", "FIC900")} == dict.fromkeys(
        ("FIC101", "FIC102", "FIC103"), OK)
    for name in ("FIC101", "FIC102", "FIC103"):
        assert (store.studies / f"{name}.json").read_bytes() == clean[f"studies/{name}.json"]
    assert content(run(todo, tmp_path / "out", resume=True).folder) == clean, "the failed loop is tried again"

# Fixtures of tests/.
clean = test_batch.clean
todo = test_batch.todo


def test_two_processes_leave_the_same_bytes_as_none(todo, clean, tmp_path) -> None:
    assert content(run(todo, tmp_path / "out", crew=Processes(2)).folder) == clean
    assert set(RESULTS) < set(clean)


def dying(task: Task, work: Work) -> TaskOutcome:
    """FIC100 kills its worker every time, FIC101 the first time."""
    once = Path(os.environ["STICTIONID_TEST_ONCE"])
    if task.loop == "FIC100" or (task.loop == "FIC101" and not once.exists()):
        if task.loop == "FIC101":
            once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return attempt(task, work)


def test_no_summary_stands_while_a_batch_runs(todo, tmp_path) -> None:
    """Killed at any moment, a batch leaves no summary that says something else than the studies."""
    run(todo, tmp_path / "out")
    seen = []
    run(todo, tmp_path / "out", tell=lambda *_: seen.append(any((tmp_path / "out" / n).exists() for n in RESULTS)))
    assert seen and not any(seen)
    assert all((tmp_path / "out" / n).exists() for n in RESULTS)


def test_a_dask_cluster_leaves_the_same_bytes(todo, clean, tmp_path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        crew = crew_for(1, cluster.scheduler_address)
        assert crew.room == 4
        assert content(run(todo, tmp_path / "out", crew=crew).folder) == clean
