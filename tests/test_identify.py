"""Identify: S and J of the paper's loops, of the shared loops with nothing hidden, of integrators, by `arx` too."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import naive
import numpy as np
import pytest
from quick_loops import PLAIN, asked_only, quick

from stictionid.errors import UsageError
from stictionid.fit.fit import search
from stictionid.fit.points.arx_cost import Arx
from stictionid.historian import read_loop
from stictionid.methods.auto import samples_a_turn
from stictionid.model.closed_loop import preset, simulate, with_stiction
from stictionid.model.model import Model
from stictionid.model.restore import rerun
from stictionid.model.spec import Spec
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import SAMPLES_PER_PERIOD
from stictionid.record.study import Study, study_from_json, to_json
from stictionid.reports.facts import facts
from stictionid.verbs.identify import Options, identify

ROOT = Path(__file__).parent.parent
SHARED = ROOT.parent / "shared"
HIDDEN = SHARED / "hidden_effects"
# Without the intervals, which are not asked for here.
POINTS = Options(intervals=False)
needs_hidden = pytest.mark.skipif(not HIDDEN.is_dir(), reason="../shared/hidden_effects is not here")


@pytest.mark.parametrize(("name", "S", "J", "e_S", "e_J"), [("foptd", 5.0, 1.5, 0.38, 0.87)])
def test_noise_free_rows_of_the_paper_come_back_closer_than_the_paper(name, S, J, e_S, e_J) -> None:
    """From the first 500 of the paper's 1,000 samples."""
    e = identify(simulate(with_stiction(preset(name), S, J)).loop.cut(0, 500),
                 options=replace(POINTS, base_only=True)).estimate
    assert e is not None and e.integrating == (name == "itptd")
    assert 100 * abs(e.S / S - 1) < e_S and 100 * abs(e.J / J - 1) < e_J


@needs_hidden
@pytest.mark.parametrize("name", ["hidden_01"])
def test_loops_with_nothing_hidden(name: str) -> None:
    """The other one, and the effects of others, are in benchmarks/long."""
    truth = json.loads((HIDDEN / "truth.json").read_text())[name]["plant"]
    study = identify(read_loop(HIDDEN / f"{name}.csv"), options=POINTS)
    e, error = study.estimate, study.steps[-1].error
    assert e is not None
    assert pytest.approx(truth["S_pct"], rel=0.01) == e.S and pytest.approx(truth["J_pct"], rel=0.05) == e.J
    assert error.rmse == pytest.approx(truth["noise_sd"], rel=0.05)
    assert error.noise_sd == pytest.approx(truth["noise_sd"], rel=0.05)
    assert study.adequate and study.verdict.stiction == "stiction" and [s.added for s in study.steps] == [None]
    assert e.from_position is not None and pytest.approx(truth["S_pct"], rel=0.01) == e.from_position.S


def scanned(S: float = 4.0, J: float = 2.0, noise: float = 0.05, seed: int = 3) -> Loop:
    base = with_stiction(preset("foptd"), S, J)
    return simulate(replace(base, noise_sd=noise, controller=replace(base.controller, scan_s=1.0), duration_s=800,
                            setpoint_moves=((0.0, 5.0), (300.0, -6.0), (550.0, 4.0))), seed=seed).loop


@cache
def known() -> tuple[Loop, Study]:
    """The scanned loop and its study."""
    loop = quick()
    return loop, identify(loop, options=PLAIN)


def test_the_study_survives_json_and_its_model_runs_again_without_a_search() -> None:
    loop, study = known()
    assert study_from_json(to_json(study)) == study
    curves = rerun(loop, study.steps[-1].model)
    skip = 50
    assert np.isnan(curves.residual[0]) and np.isfinite(curves.residual[skip:]).all()
    error = float(np.sqrt(np.nanmean(curves.residual ** 2)))
    assert error == pytest.approx(study.steps[-1].error.rmse, rel=1e-6)
    assert np.abs(curves.position - loop.position)[skip:].max() < 0.2


def test_a_model_that_extrapolates_on_held_out_blocks_has_no_held_out_error() -> None:
    """Thirty spikes at the start of PV: without their block the model runs away from it."""
    loop = quick()
    y = loop.process_value.copy()
    y[:30] = 1e6 * (1.0 + 0.1 * (np.arange(30) % 3))
    study = identify(replace(loop, process_value=y), options=PLAIN)
    step = study.steps[-1]
    assert step.extrapolates and step.error.rmse_holdout is None and step.error.rmse_one_step_holdout is None
    ladder = next(s for s in facts(study).sections if s.key == "ladder")
    assert ladder.tables[0].rows[0][3] == "extrapolates"


def test_the_same_seed_gives_the_same_study() -> None:
    loop, study = known()
    assert to_json(identify(loop, options=PLAIN)) == to_json(study)


def test_a_valve_that_does_not_stick_is_not_called_sticking() -> None:
    base = with_stiction(preset("foptd"), 0.0, 0.0)
    moves = tuple((80.0 * k, (-1.0) ** k * 4.0) for k in range(10))
    loop = simulate(replace(base, noise_sd=0.1, controller=replace(base.controller, scan_s=1.0), setpoint_moves=moves,
                            duration_s=800), seed=1).loop
    assert identify(loop, options=POINTS).verdict.stiction == "no stiction"


def test_the_papers_method_searches_the_papers_range_and_reports_its_polynomials() -> None:
    loop = simulate(with_stiction(preset("foptd"), 5.0, 3.0)).loop
    study = identify(loop, options=Options(method="arx", order=1, delay=5))
    e, arx = study.estimate, study.steps[0].model["arx"]
    assert e is not None and study.range.s_max is not None
    assert study.range.s_max >= e.S and e.J <= e.S
    assert pytest.approx(5.0, rel=0.03) == e.S
    assert arx["delay"] == 5 and len(arx["a"]) == len(arx["b"]) == 1


def test_arx_cost_is_the_papers_v_n() -> None:
    loop = scanned()
    found = find_range(loop)
    model = Model(loop, Spec(), s_max=found.s_max, period_s=found.period_median_s)
    arx = Arx(model, 2, (5,), constant=False)
    values = np.array([[4.0, 3.0], [2.0, 1.0], [0.0, 0.0], [5.0, 5.0], [5.0, 5.0]])
    rows = loop.samples - arx.first
    ours = arx.costs(values)[0] / rows
    for p in range(2):
        theirs = naive.arx_cost(loop.output, loop.process_value, values[0, p], values[1, p], 2, 5, arx.first)
        assert ours[p] == pytest.approx(theirs, rel=1e-6)


def test_the_cost_is_never_above_that_of_the_true_parameters() -> None:
    loop = scanned()
    found = find_range(loop)
    model = Model(loop, Spec(), s_max=found.s_max, period_s=found.period_median_s)
    _, costs = search(model, np.random.default_rng(0))
    forces = np.linspace(-0.9, 0.9, 7)
    truth = np.stack([np.full(7, 4.0), np.full(7, 2.0), forces, np.full(7, 5.0), np.full(7, 5.0)])
    assert costs[0] <= model.costs_of(truth).min() * 1.001


@pytest.mark.parametrize("options", [
    Options(method="magic"), Options(between="never"), Options(law="nobody"), Options(order=9),
    Options(fixed={"dead_time_s": -1.0}),
])
def test_options_that_do_not_exist_are_refused(options: Options) -> None:
    with pytest.raises(UsageError):
        identify(Loop(output=np.zeros(9), process_value=np.zeros(9)), options=options)


@pytest.mark.parametrize(("loop", "code"), [
    (Loop(output=np.full(300, 40.0), process_value=np.random.default_rng(0).standard_normal(300)), "constant-output"),
    (Loop(output=np.random.default_rng(0).standard_normal(300) + 50, process_value=np.full(300, 3e-44)), "dead-signal"),
    (Loop(output=50 + np.sin(np.arange(300) / 1.0), process_value=np.cos(np.arange(300) / 1.0)), "too-slow-sampling"),
    (Loop(output=50 + np.sin(np.arange(300) / 30.0), process_value=np.cos(np.arange(300) / 30.0)), "too-few-cycles"),
    (Loop(output=np.arange(30.0), process_value=np.arange(30.0)), "too-short"),
    (Loop(output=50 * (1 + np.sign(np.sin(np.arange(600) / 9))), process_value=np.sin(np.arange(600) / 9)),
     "saturated-output"),
    (Loop(output=400 + 5 * np.sin(np.arange(600) / 9), process_value=np.sin(np.arange(600) / 9),
          units={"output": "unit of OP"}), "output-not-a-valve"),
])
def test_what_the_record_cannot_tell_is_an_abstention_with_its_reason(loop: Loop, code: str) -> None:
    study = identify(loop)
    assert study.estimate is None and study.verdict.stiction == "undecided"
    assert study.verdict.evidence.code == code and study.verdict.reason
    assert study_from_json(to_json(study)) == study


@pytest.mark.parametrize(("amplitude", "period", "noise", "slow"), [
    (1.0, 80.0, 0.05, True), (0.3, 3.3, 0.02, False), (1.0, 3.3, 0.1, False), (1.0, 2.2, 0.0, False)])
def test_turns_of_noise_are_no_oscillation_too_fast_for_the_samples(amplitude, period, noise, slow) -> None:
    rng, t = np.random.default_rng(5), np.arange(2000)
    y = 2.0 * np.sin(t / 300.0) * (period < 10) + amplitude * np.sin(2.0 * np.pi * t / period)
    per = samples_a_turn(y + noise * rng.standard_normal(t.size))
    assert per == pytest.approx(period, rel=0.3) and (per > SAMPLES_PER_PERIOD) == slow


@asked_only("coloured-noise", "extra-lag")
def test_noise_that_was_asked_for_stays_though_the_base_needs_none() -> None:
    loop = simulate(replace(with_stiction(preset("foptd"), 5.0, 3.0), noise_sd=0.05, duration_s=500.0)).loop
    asked = identify(loop, options=replace(POINTS, effects=("coloured-noise",)))
    assert [step.added for step in asked.steps] == [None, "coloured-noise"]
    assert asked.steps[0].error.rmse < 1.05 * asked.steps[0].error.noise_sd


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_held_command_is_found_in_its_basin_whatever_the_seed(seed: int) -> None:
    """Searches of this loop can end with a dead time that is a sample off and an error of 1.5 times the noise."""
    study = identify(read_loop(ROOT / "sample_data" / "foptd_scanned.parquet"),
                     options=replace(POINTS, base_only=True, seed=seed))
    truth = json.loads((ROOT / "sample_data" / "foptd_scanned.truth.json").read_text())
    e = study.estimate
    assert e is not None and study.steps[-1].model["between"] == "hold"
    assert e.dead_time_s == pytest.approx(5.0, abs=0.05)
    assert pytest.approx(truth["S"], rel=0.01) == e.S and pytest.approx(truth["J"], rel=0.05) == e.J
