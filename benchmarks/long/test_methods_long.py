"""Methods at length: laws that no signal tells apart, all laws on the command line, and a valve that rests."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import test_methods
from commands import run
from test_methods import J, S, loop_of, ranks, step_record

from stictionid.model.closed_loop import preset, simulate, with_stiction
from stictionid.record.loop import Loop
from stictionid.record.write import write_loop
from stictionid.verbs.identify import Options, identify


def test_chen_and_kano_cannot_be_told_apart_and_the_default_is_kept() -> None:
    study = identify(loop_of(), options=Options(law="all", base_only=True))
    finding = next(f for f in study.steps[-1].findings if f.code == "laws-alike")
    assert {"chen", "kano"} <= set(finding.laws.alike) and "he" not in finding.laws.alike
    assert study.estimate is not None and study.estimate.law == "chen"
    by_name = {law.law: law for law in study.laws}
    assert pytest.approx(by_name["chen"].S, rel=0.01) == by_name["kano"].S


def test_all_laws_are_ranked_on_the_command_line(tmp_path: Path) -> None:
    ranks(tmp_path, {"chen", "kano", "he", "he-wang", "choudhury", "stenman"})


def test_a_valve_that_rests_between_scans_becomes_a_step_of_its_own() -> None:
    base = with_stiction(preset("foptd"), 5.0, 3.0)
    held = simulate(replace(base, law="karnopp", noise_sd=0.09, duration_s=1000,
                            controller=replace(base.controller, scan_s=1.0)), seed=1).loop
    study = identify(held)
    assert [step.added for step in study.steps] == [None, "re-sticking"]
    e = study.estimate
    assert e is not None and pytest.approx(5.0, rel=0.02) == e.S and pytest.approx(3.0, rel=0.1) == e.J
    assert study.steps[1].error.rmse < 0.9 * study.steps[0].error.rmse

# Fixtures of tests/.
loop = test_methods.loop


def step_test_is_the_fixed_plant(folder: Path, loop: Loop) -> None:
    """The plant of a step test is held while S and J of a record are identified."""
    write_loop(step_record(3.0, 5.0, 5.0, n=250), folder / "step.csv")
    write_loop(loop.cut(0, 400), folder / "loop.csv")
    done = run("identify", "loop.csv", "--step-test", "step.csv", "--base-only", "--json",
               "--no-intervals", cwd=folder)
    assert done.returncode == 0, done.stderr
    study = json.loads(done.stdout)
    e = study["estimate"]
    assert e["gain"] == pytest.approx(3.0, rel=0.01) and e["time_constants_s"][0] == pytest.approx(5.0, rel=0.05)
    assert e["S"] == pytest.approx(S, rel=0.03) and e["J"] == pytest.approx(J, rel=0.06)
    assert [f["code"] for f in study["data"]["findings"]].count("step-test") == 1


def test_identify_uses_a_step_test_as_the_fixed_plant(tmp_path: Path, loop: Loop) -> None:
    step_test_is_the_fixed_plant(tmp_path, loop)


def test_laws_are_ranked_on_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of the laws; benchmarks/long ranks all of them."""
    monkeypatch.setattr("stictionid.verbs.identify.searchable", lambda: ("chen", "he"))
    ranks(tmp_path, {"chen", "he"})
