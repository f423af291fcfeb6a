"""The screen at length: every next step runs as printed, from the record to the page."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from unittest import mock

import commands
from quick_loops import asked_only

from stictionid.record.loop import Finding
from stictionid.record.study import study_from_json, to_json
from stictionid.reports.answer import change


def test_every_next_step_runs_as_printed_from_the_record_to_the_page(tmp_path: Path) -> None:
    def run(*words: object) -> commands.Done:
        with asked_only("travel-limit", "extra-lag"):
            return commands.run(*words, cwd=tmp_path)

    made = run("simulate", "--S", 4, "--J", 2.5, "--noise", 0.05, "--scan", 1, "--duration", 500, "--seed", 3,
               "--setpoint", "0:4", "--setpoint", "250:-5", "--effect", "travel-limit:upper=52", "-o", "a.csv")
    assert told(made) == ["identify", "a.csv"]
    keep = ["identify", "a.csv", "--base-only", "-o", "a.json"]
    identified = run(*keep)
    made_before = study_from_json((tmp_path / "a.json").read_text())
    with mock.patch("stictionid.verbs.identify.identify", return_value=made_before):
        assert told(run("identify", "a.csv", "--base-only")) == keep
    assert told(identified) == told(run("compare", "a.json")) == ["diagnose", "a.json"]
    assert identified.stdout.splitlines()[0].startswith("verdict: stiction")
    assert identified.stdout.splitlines()[1].startswith("S ") and "adequate: no" in identified.stdout
    asked = run("diagnose", "a.json")
    assert asked.stdout.startswith("missing: ") and "(travel-limit" in asked.stdout.split(". Error")[0]
    add = told(asked)
    assert add == ["add", "travel-limit", "a.json"] and told(run("compare", "a.json")) == add
    before = study_from_json((tmp_path / "a.json").read_text())
    added = run(*add)
    after = study_from_json((tmp_path / "a.json").read_text())
    assert "answer: the record supports travel-limit" in " ".join(added.stdout.split())
    assert all(cell in added.stdout for row in change(before, after).rows for cell in row)
    assert told(added) == ["report", "a.json", "-o", "a.html"] and run(*told(added)).returncode == 0
    assert (tmp_path / "a.html").is_file()

    # An effect that makes the error worse is said to, and the next step takes it out again.
    last = after.steps[-1]
    worse = replace(last, supported=False, error=replace(last.error, rmse=2.0 * before.steps[-1].error.rmse),
                    findings=(Finding("not-supported", "warning", "the record does not support it", {}),
                              Finding("worse", "warning", "the free-run error rises", {})))
    with mock.patch("stictionid.verbs.add.add", return_value=replace(after, steps=(*after.steps[:-1], worse))):
        (tmp_path / "a.json").write_text(to_json(before))
        grown = run(*add)
    assert grown.stdout.startswith("warning: the free-run error rises")
    assert "answer: the record does not support it" in grown.stdout
    assert told(grown) == ["remove", "travel-limit", "a.json"]
    removed = run(*told(grown))
    assert told(removed) == ["diagnose", "a.json"] and "What changed" in removed.stdout
    assert study_from_json((tmp_path / "a.json").read_text()).steps[-1].effects == ()


def told(done: commands.Done) -> list[str]:
    """The words of the one next step that a command printed, without the program."""
    assert done.returncode == 0, done.stderr
    (said,) = [line for line in done.stderr.splitlines() if line.startswith("next: ")]
    program, *words = shlex.split(said.removeprefix("next: "))
    assert program == "stictionid"
    return words
