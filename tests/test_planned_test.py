"""The planned manual test: what it proposes, within its limits, and what `--test steps` reads from it.

Further records, and the plan in reports and on the command line, are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from commands import run
from quick_loops import asked_only

from stictionid import laws
from stictionid.errors import UsageError
from stictionid.model.closed_loop import preset, simulate
from stictionid.options import Options
from stictionid.process.linear import Dynamics, free_run
from stictionid.record.loop import Loop
from stictionid.record.planned_test import PlannedTest
from stictionid.record.study import Study, Verdict, study_from_json, to_json
from stictionid.record.write import write_loop
from stictionid.verbs.identify import identify
from stictionid.verdict.planned_test import with_plan

S, J, NOISE = 1.0, 0.3, 1.2
PV = (20.0, 80.0)


@cache
def undecided() -> tuple[Study, Loop]:
    """A loop with more noise than friction, whose record leaves it open whether the valve sticks."""
    made = preset("foptd")
    moves = ((0.0, 5.0), (100.0, -5.0), (200.0, 5.0), (300.0, -5.0))
    setting = replace(made, S=S, J=J, noise_sd=NOISE, duration_s=400.0, setpoint_moves=moves,
                      controller=replace(made.controller, scan_s=1.0))
    loop = replace(simulate(setting, seed=1).loop, position=None)
    with asked_only("extra-lag"):
        return identify(loop), loop


@cache
def plan(pv_limits: tuple[float, float] | None = PV) -> PlannedTest:
    study, loop = undecided()
    found = with_plan(study, loop, pv_limits=pv_limits).planned_test
    assert found is not None
    return found


def in_open_loop(test: PlannedTest, S: float, J: float, seed: int, noise: float = NOISE) -> Loop:
    """The record of a test on a valve, on the true process of the loop, from any initial force."""
    rng, law, plant = np.random.default_rng([77, seed]), laws.get("chen"), preset("foptd").plant
    levels = test.start + np.concatenate([[0.0], np.cumsum(test.moves)])
    output = np.repeat(levels, round(test.hold_s))
    stem = law.positions(output, law.friction(S, J), share=rng.uniform(-0.9, 0.9))
    linear = Dynamics(np.array([plant.time_constant_s]), np.array([plant.dead_time_s]), np.zeros(1), False)
    value = 52.0 + plant.gain * free_run(stem, linear, step_s=1.0)[:, 0]
    return Loop(output=output, process_value=value + noise * rng.standard_normal(value.size), units={"output": "%"})


def test_an_undecided_loop_gets_a_test_within_its_limits() -> None:
    study, _ = undecided()
    assert study.verdict.stiction == "undecided" and study.estimate is not None
    test = plan()
    assert test.moves and abs(sum(test.moves)) < 1e-9
    assert {a.S for a in test.answers} == {0.0, study.estimate.S}
    assert test.likelihood_ratio >= test.needed and test.assumed == ("op",) and test.pv_limits == PV
    for valve in ((S, J), (0.0, 0.0)):
        value = in_open_loop(test, *valve, 0, noise=0.0).process_value
        assert PV[0] < value.min() and value.max() < PV[1]


@pytest.mark.parametrize("seed", range(1))
@pytest.mark.parametrize(("valve", "answer"), [((S, J), "stiction")])
def test_the_proposed_test_tells_a_sticking_valve_from_one_that_follows(valve: tuple[float, float], answer: str,
                                                                       seed: int) -> None:
    study = identify(in_open_loop(plan(), *valve, seed), options=Options(test="steps"))
    assert study.verdict.stiction == answer
    assert study.estimate is not None and study.estimate.S_interval is not None
    if valve[0]:
        assert study.estimate.S_interval[0] <= S <= study.estimate.S_interval[1]


def test_an_integrator_comes_back_and_a_settled_study_has_no_test() -> None:
    study, loop = undecided()
    assert study.estimate is not None
    error = replace(study.steps[-1].error, rmse=0.1, rmse_one_step=0.1)
    tank = replace(study, estimate=replace(study.estimate, integrating=True, gain=0.05),
                   steps=(*study.steps[:-1], replace(study.steps[-1], error=error)))
    test = with_plan(tank, loop, pv_limits=(0.0, 100.0)).planned_test
    assert test is not None and test.moves
    levels = np.cumsum(test.moves)
    assert abs(levels[-1]) < 1e-9 and abs(levels.sum()) < 1e-6
    settled = replace(study, verdict=Verdict("no stiction", "", 0.9))
    assert with_plan(settled, loop).planned_test is None


def test_a_model_in_which_pv_does_not_answer_has_no_test_and_says_so() -> None:
    study, loop = undecided()
    assert study.estimate is not None
    silent = replace(study, estimate=replace(study.estimate, gain=0.0, gain_interval=(-0.1, 0.1)))
    test = with_plan(silent, loop).planned_test
    assert test is not None and not test.moves and "gain is 0" in test.reason


@pytest.mark.parametrize("name", ["op_limits", "pv_limits"])
def test_limits_beside_the_record_are_refused_with_the_value(name: str) -> None:
    study, loop = undecided()
    with pytest.raises(UsageError, match="do not hold the mean of the record") as caught:
        with_plan(study, loop, **{name: (90.0, 95.0)})
    assert "LO below and HI above" in caught.value.hint


def test_the_plan_survives_json_and_its_steps_csv() -> None:
    study = replace(undecided()[0], planned_test=plan())
    assert study_from_json(to_json(study)).planned_test == plan()
    rows = np.loadtxt(plan().csv.splitlines(), delimiter=",", skiprows=1)
    assert plan().csv.startswith("time_s,OP\n")
    assert np.allclose(np.diff(rows[:-1, 1]), plan().moves) and rows[-1, 0] == plan().duration_s
    assert rows[0, 1] == rows[-1, 1] == plan().start and (np.diff(rows[:, 0]) == plan().hold_s).all()


@pytest.mark.parametrize(("moves", "said"), [((1.0, 1.0, 1.0), "in one direction"), ((0.0, 0.0, 0.0), "is constant")])
def test_a_test_without_a_reversal_abstains(moves: tuple[float, ...], said: str) -> None:
    test = replace(plan(), moves=moves)
    study = identify(in_open_loop(test, S, J, 0), options=Options(test="steps"))
    assert study.estimate is None and study.verdict.stiction == "undecided" and said in study.verdict.reason


def test_a_loop_in_automatic_is_no_manual_test(tmp_path: Path) -> None:
    study = identify(undecided()[1], options=Options(test="steps"))
    assert study.estimate is None and "a loop in automatic" in study.verdict.reason
    write_loop(undecided()[1], tmp_path / "loop.csv")
    for words, said in ((("--test", "ramps"), "give --test steps"),
                        (("--test", "steps", "--method", "arx"), "--test has no meaning")):
        done = run("identify", "loop.csv", *words, cwd=tmp_path)
        assert done.returncode == 2 and said in done.stderr, done.stderr
