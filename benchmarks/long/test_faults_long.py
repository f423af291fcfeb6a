"""Faults at length: a device as output, and studies that are interrupted or killed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import test_faults
from test_faults import Bench, fault_files, judge

# Fixtures of tests/.
bench = test_faults.bench


def test_a_device_is_written_to_and_never_replaced(bench: Bench) -> None:
    trials, problems, skipped = fault_files.device_as_output(bench)
    assert trials and not problems and not skipped


@pytest.mark.parametrize(("which", "trials"), [("interrupt", 2), ("terminate", 1)])
def test_interrupted_at_random_times_studies_are_whole_or_absent(bench: Bench, which: str, trials: int) -> None:
    test_faults.test_interrupted_at_random_times_studies_are_whole_or_absent(bench, which, trials)


def test_a_name_that_is_no_unicode_goes_through_a_study_and_back(bench: Bench) -> None:
    place = os.fsencode(bench.place("names"))
    with open(place + b"/b\xff.csv", "wb") as file:
        file.write(bench.csv.read_bytes())
    name = os.fsdecode(place + b"/b\xff.csv")
    assert not judge(bench.run("identify", name, "--base-only", "-q", "-o", "names.json"), 0)
    assert not judge(bench.run("report", "names.json", "-o", "n.md"), 0)
    assert b"No pictures" not in (bench.folder / "n.md").read_bytes()
    (bench.folder / "names.json").read_text(encoding="utf-8")


def test_a_full_stdout_is_one_sentence(bench: Bench) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    for arguments in (("range", bench.csv, "--json"), ("report", bench.study), ("laws",)):
        with open("/dev/full", "wb") as full:
            assert not judge(bench.run(*arguments, stdout=full), 2)
