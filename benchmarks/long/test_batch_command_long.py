"""Batches through processes at length: one that is terminated keeps what is done and goes on as it says."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
import test_batch_command
from batch_files import records, write_csv
from test_batch_command import WHAT, batch, linux

# Fixtures of tests/.
site, clean = test_batch_command.site, test_batch_command.clean


@test_batch_command.linux
def test_terminated_it_keeps_what_is_done_and_says_how_to_go_on(site: Path, clean: Any, tmp_path: Path,
                                                                monkeypatch: pytest.MonkeyPatch) -> None:
    test_batch_command.test_stopped_it_keeps_what_is_done_and_says_how_to_go_on(signal.SIGTERM, site, clean, tmp_path,
                                                                                monkeypatch)

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
