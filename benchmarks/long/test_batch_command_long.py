"""Batches through processes at length: one that is terminated keeps what is done and goes on as it says."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
import test_batch_command
from batch_files import records, write_csv
from test_batch_command import RESULTS, WHAT, batch, children, first_loops, gone, here, linux, results, start

# Fixtures of tests/.
site, clean = test_batch_command.site, test_batch_command.clean


@test_batch_command.linux
def test_terminated_it_keeps_what_is_done_and_says_how_to_go_on(site: Path, clean: Any, tmp_path: Path,
                                                                monkeypatch: pytest.MonkeyPatch) -> None:
    test_batch_command.test_stopped_it_keeps_what_is_done_and_says_how_to_go_on(signal.SIGTERM, site, clean, tmp_path,
                                                                                monkeypatch)

# Fixtures of tests/.
clean = test_batch_command.clean
site = test_batch_command.site


@linux
def test_kill_9_loses_only_loops_in_flight_and_resume_makes_it_whole(site, clean, tmp_path, monkeypatch,
                                                                     capsys) -> None:
    process = start(site, tmp_path / "out", "--jobs", "1")
    seen = first_loops(process, 2)
    # A worker that is killed does not stop the batch.
    os.kill(int(seen[-1]["worker"].rpartition(":")[2]), signal.SIGKILL)
    seen += first_loops(process, 2)
    workers = children(process.pid)
    process.kill()
    process.wait()
    process.stdout.close(), process.stderr.close()
    assert gone(workers), "workers outlive a killed parent"
    left = results(tmp_path / "out")
    assert not set(RESULTS) & set(left)
    for line in seen:
        name = f"studies/{line['loop']}.json"
        assert left[name] == clean[1][name]
    assert not [name for name in left if name.endswith(".part")]
    assert here(monkeypatch, site, "-o", tmp_path / "out", *WHAT, "--resume", "--json") == 0
    again = capsys.readouterr()
    assert json.loads(again.out)["failed"] == 0
    assert results(tmp_path / "out") == clean[1]
    kept = {line["loop"] for line in map(json.loads, (x for x in again.err.splitlines() if x[:1] == "{"))
            if line["kept"]}
    assert {line["loop"] for line in seen} <= kept


@linux
def test_no_room_is_exit_2_with_one_sentence_and_a_way_on(tmp_path) -> None:
    import resource

    for name, loop in records(2).items():
        write_csv(tmp_path / f"{name}.csv", loop)

    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1500, 1500))

    out = tmp_path / "out"
    done = batch(tmp_path / "FIC100.csv", tmp_path / "FIC101.csv", "-o", out, *WHAT, "--jobs", 1, preexec_fn=small)
    assert done.returncode == 2 and "no room left" in done.stderr and "--resume" in done.stderr, done.stderr
    assert "Traceback" not in done.stderr
    assert not [p for p in out.rglob("*") if p.name.endswith(".part")]
