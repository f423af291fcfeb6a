"""Planned tests at length: further records of the proposed test."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest
import test_planned_test
from commands import run
from study_factory import doubtful
from test_planned_test import J, S, plan, undecided

from stictionid.record.write import write_loop
from stictionid.reports.facts import facts
from stictionid.reports.test_plan import sentences
from stictionid.verbs.identify import data_record
from stictionid.verdict.planned_test import with_plan


@pytest.mark.parametrize(("valve", "answer", "seed"), [
    ((S, J), "stiction", 1), ((0.0, 0.0), "no stiction", 0), ((0.0, 0.0), "no stiction", 1)])
def test_the_proposed_test_tells_a_sticking_valve_from_one_that_follows(valve: tuple[float, float], answer: str,
                                                                       seed: int) -> None:
    test_planned_test.test_the_proposed_test_tells_a_sticking_valve_from_one_that_follows(valve, answer, seed)


def test_the_command_line_writes_the_steps_and_refuses_what_it_can_not_do(tmp_path: Path) -> None:
    study, loop = undecided()
    write_loop(loop, tmp_path / "loop.csv")
    with mock.patch("stictionid.verbs.identify.identify",
                    lambda read, **_: replace(study, data=data_record(read, read, ()))):
        done = run("identify", "loop.csv", "-o", "s.json", "--pv-limits", "20,80", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    kept = json.loads((tmp_path / "s.json").read_text())["planned_test"]
    assert kept["pv_limits"] == [20.0, 80.0]
    done = run("report", "s.json", "-o", "r.md", "--test-csv", "t.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "t.csv").read_text().startswith("time_s,OP\n0,")
    assert "Limits of PV: 20 to 80" in (tmp_path / "r.md").read_text()
    for words, said in ((("--pv-limits", "80,20"), "no range"), (("--op-limits", "abc"), "give two numbers"),
                        (("--pv-limits", "90,95"), "LO below and HI above"),
                        (("--pv-limits", "51,54", "--test-csv", "u.csv"), "give wider --op-limits and --pv-limits"),
                        (("--test-csv", "loop.csv"), "another kind of file")):
        done = run("report", "s.json", *words, cwd=tmp_path)
        assert done.returncode == 2 and said in done.stderr, done.stderr
    assert not (tmp_path / "u.csv").exists()
    done = run("report", "s.json", "-o", "why.md", "--pv-limits", "51,54", "--test-csv", "u.csv", cwd=tmp_path)
    assert done.returncode == 2 and not (tmp_path / "u.csv").exists()
    assert "The test that would settle it" in (tmp_path / "why.md").read_text()


def test_narrow_limits_leave_no_test_and_the_reason_says_what_it_takes() -> None:
    study, loop = undecided()
    found = with_plan(study, loop, pv_limits=(51.0, 54.0), op_limits=(45.0, 55.0))
    assert found.planned_test is not None and not found.planned_test.moves
    assert "stays within the limits" in found.planned_test.reason and found.planned_test.otherwise
    said = " ".join(sentences(found))
    assert "No manual test settles it" in said and "Limits of PV: 51 to 54" in said and "Where no test" in said


def test_the_report_ends_with_the_test_and_asks_for_limits() -> None:
    study = with_plan(*undecided())
    text = next(s.text for s in facts(study).sections if s.key == "test")
    said = " ".join(text)
    assert "pass --pv-limits LO,HI" in said and "pass --op-limits LO,HI" in said
    shown = " ".join(sentences(replace(study, planned_test=plan())))
    for part in ("in manual at", "PV moves by at most", "stictionid identify test.csv --test steps",
                 "A person must run it", "a valve that follows OP", "Where no test is possible"):
        assert part in shown
    # A study whose data are gone keeps its plan; one that never had any has no such section.
    assert with_plan(replace(study, planned_test=plan()), None).planned_test == plan()
    assert not any(s.key == "test" for s in facts(doubtful().study).sections)
