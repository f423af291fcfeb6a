"""Headline, verdict and what to do: they follow from the last model of a study, whatever the way to it."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from real_nodes import recorded, scored
from scipy.signal import lfilter

from stictionid import methods
from stictionid.effects import get
from stictionid.effects.contract import Context
from stictionid.fit.context import Run
from stictionid.fit.noise.whiteness import NEEDED
from stictionid.fit.points.fitted import as_it_stands
from stictionid.fit.points.moves import descend_model
from stictionid.fit.study_steps import with_steps
from stictionid.historian import read_loop
from stictionid.methods.contract import Outcome
from stictionid.model.closed_loop import Setting, preset, simulate, with_stiction
from stictionid.model.model import Model
from stictionid.model.parts import Part, join_parts
from stictionid.model.restore import rerun
from stictionid.model.spec import Spec
from stictionid.options import Options
from stictionid.record.evidence import Evidence
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.study import Estimate, PositionEstimate, Study, Verdict
from stictionid.record.swing import Share
from stictionid.reports import effect_words, story
from stictionid.reports.facts import facts
from stictionid.selection.decide import missing_reason
from stictionid.selection.entry import Entry
from stictionid.selection.policy import Policy
from stictionid.verbs.by_hand import judged_anew
from stictionid.verbs.identify import data_record, identify, made_by
from stictionid.verdict.judge import with_position

SAMPLES = Path(__file__).resolve().parent.parent / "sample_data"
DRIFT = ("stiction-drift", {"stickband_growth": 2.0, "jump_growth": 0.5})
SINE = ("sinusoidal-disturbance", {"period_s": 61.0, "amplitude": 1.5})
STOP = ("travel-limit", {"upper": 52.0})
MOVES = ((0.0, 2.0), (200.0, -3.0), (450.0, 4.0), (700.0, -3.0))


def setting_of(S: float, J: float, *effects: tuple[str, dict[str, float]], duration_s: float = 900.0,
               moves: tuple[tuple[float, float], ...] | None = None) -> Setting:
    """The first-order loop of the presets with a scanning controller, noise 0.1 and hidden effects."""
    made = with_stiction(preset("foptd"), S, J)
    return replace(made, controller=replace(made.controller, scan_s=1.0), noise_sd=0.1, duration_s=duration_s,
                   effects=effects, setpoint_moves=made.setpoint_moves if moves is None else moves)


def loop_of(setting: Setting, seed: int) -> Loop:
    return replace(simulate(setting, seed=seed).loop, position=None)


def study_of(loop: Loop, S: float, J: float, ways: tuple[tuple[str, ...], ...], name: str,
             values: dict[str, float]) -> Study:
    """The study whose steps hold the effects of `ways`, fitted from the true `values` of one, judged by the last."""
    run = Run(loop, find_range(loop), Options(), law="chen", rng=np.random.default_rng(0),
              tell=lambda text, share: None)
    base = {"S": max(S, 0.05), "J": J, "time_constant_s": 5.0, "dead_time_s": 5.0,
            **{f"{name}:{key}": value for key, value in values.items()}}
    steps, before = [], set()
    for effects in ways:
        model = run.model(Spec(effects=effects))
        starts = np.stack([model.vector({**base, "initial_residual_force": force})
                           for force in np.linspace(-0.9, 0.9, 13)], axis=1)
        points = model.cube(starts)
        found = descend_model(model, points[np.argsort(model.costs(points))[:3]])
        fit = as_it_stands(model, model.values(found.points[:1])[:, 0])
        steps.append(run.step(fit, next(iter(set(effects) - before), None)))
        before = set(effects)
    blank = Estimate(S, J, "%", None, None, 0.9, "chen", 1.0, (1.0,), 0.0, False, 0.0)
    study = Study(made_by(Options()), data_record(loop, loop), run.found, Verdict("undecided", ""), blank)
    return judged_anew(loop, with_steps(study, tuple(steps), fit), 0)


@cache
def drifting(by_way_of: str = "") -> Study:
    """A valve whose friction grows; the steps may go by way of another effect that the last model has not."""
    ways = (("stiction-drift",),) if not by_way_of else ((by_way_of,), ("stiction-drift",))
    return study_of(loop_of(setting_of(4.0, 2.0, DRIFT), 8), 4.0, 2.0, ways, *DRIFT)


@cache
def stopped() -> Study:
    return study_of(loop_of(setting_of(4.0, 2.5, STOP), 3), 4.0, 2.5, ((), ("travel-limit",)), "travel-limit",
                    {"upper": 52.0, "lower": 30.0})


@cache
def disturbed() -> Study:
    return study_of(loop_of(setting_of(0.0, 0.0, SINE), 9), 0.0, 0.0, (("sinusoidal-disturbance",),),
                    "sinusoidal-disturbance", {"period_s": 61.0})


def section(study: Study, key: str):
    return next(s for s in facts(study).sections if s.key == key)


# Verdict -----------------------------------------------------------------------------------------------------------


def test_a_valve_whose_friction_drifts_sticks_and_no_neighbour_makes_its_swing() -> None:
    study = drifting()
    assert study.steps[-1].error.rmse < 0.12 and study.verdict.stiction == "stiction"
    assert study.verdict.evidence.looks_like is None
    assert study.swing.causes[0].part == Share.VALVE and study.swing.causes[0].share > 0.8
    said = facts(study)
    assert "the valve's friction" in said.headline and "neighbour" not in " ".join((said.headline, *said.then))
    assert "Service the valve" in said.then[-1]


def test_the_same_model_has_the_same_verdict_and_headline_by_either_way() -> None:
    one, other = drifting(), drifting("re-sticking")
    assert one.steps[-1].effects == other.steps[-1].effects and len(one.steps) != len(other.steps)
    assert one.verdict.stiction == other.verdict.stiction
    assert facts(one).headline == facts(other).headline and facts(one).then == facts(other).then


@pytest.mark.parametrize(("effect", "seed", "values"), [
    (("asymmetric-stiction", {"jump_up": 3.0, "jump_down": 1.0}), 5, {"jump_difference": 2.0}),
    (("re-sticking", {"restick_speed": 0.3}), 6, {"restick_speed": 0.3})])
def test_a_valve_that_sticks_in_its_own_way_sticks(effect, seed: int, values: dict[str, float]) -> None:
    name = effect[0]
    study = study_of(loop_of(setting_of(4.0, 2.0, effect), seed), 4.0, 2.0, ((name,),), name, values)
    assert study.verdict.stiction == "stiction"


def test_a_healthy_valve_beside_a_step_does_not_stick() -> None:
    hidden = ("step-disturbance", {"time_s": 350.0, "size": 2.0})
    name = "step-disturbance@output"
    study = study_of(loop_of(setting_of(0.0, 0.0, hidden, moves=MOVES), 10), 0.0, 0.0, ((name,),), name,
                     {"time_s": 350.0})
    assert study.verdict.stiction == "no stiction"


def test_only_a_valve_that_is_denied_leaves_its_cycle_to_a_neighbour() -> None:
    """A position that shows a sticking valve takes the other cause away."""
    seen = PositionEstimate(4.0, 2.0, 0.01, 1.0, None, 1.0, True)
    other = Evidence(looks_like="y repeats every 60 s: this valve or a neighbour's")
    doubt = Verdict("undecided", "y repeats", 0.4, other)
    found = with_position(doubt, seen)
    assert found.stiction == "stiction" and found.evidence.looks_like is None


def test_the_reason_tells_the_error_of_the_last_step() -> None:
    study = drifting()
    assert f"{study.steps[-1].error.rmse:.4g}" in study.verdict.reason
    assert "of the variance of y" not in study.verdict.reason


# A healthy valve ---------------------------------------------------------------------------------------------------


def test_a_healthy_valve_has_one_statement_on_its_stickband() -> None:
    study = disturbed()
    assert study.verdict.stiction == "no stiction"
    above = study.verdict.evidence.S_excluded_above
    assert above >= study.estimate.S and above >= (study.estimate.S_interval or (0.0, 0.0))[1]
    said = facts(study)
    stated = re.search(r"S above (\S+) % is excluded", said.reason)[1]
    assert above <= float(stated) < 1.1 * above and "contradict" not in said.reason
    state = next(text for text in said.then if text.startswith("No stiction found"))
    assert "is excluded" in state and " to " not in state


def test_no_stickband_is_excluded_that_the_printed_interval_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    auto = methods.get("auto")

    def reaching(run: Run, policy: Policy) -> Outcome:
        return replace(auto.run(run, policy), reach={"S": ((0.0, 0.0614),), "J": ((0.0, 0.05),)})

    monkeypatch.setattr(methods, "get", lambda name: replace(auto, run=reaching))
    study = identify(read_loop(SAMPLES / "healthy.csv"))
    assert study.verdict.stiction == "no stiction" and study.estimate.S_interval == (0.0, 0.0614)
    said = facts(study)
    for text in (said.reason, next(text for text in said.then if text.startswith("No stiction found"))):
        assert float(re.search(r"S above (\S+) % is excluded", text)[1]) >= 0.0614


def test_a_sine_is_a_cause_of_the_swing_and_its_work_is_not_the_valves() -> None:
    said = facts(disturbed())
    assert re.search(r"% an oscillation of 6[01]\.\d+ s from outside", said.headline)
    assert "Service the valve" not in " ".join(said.then)


def test_a_sine_that_the_process_took_is_tried_at_the_line_of_y() -> None:
    t, rng = np.arange(800.0), np.random.default_rng(4)
    y = np.sin(2.0 * np.pi * t / 80.0) + 0.1 * rng.standard_normal(t.size)
    context = Context(np.zeros(t.size), y, None, 1.0, 80.0, residual=rng.standard_normal(t.size))
    guess = get("sinusoidal-disturbance").guess
    assert guess is not None and np.abs(guess(context)[:, 0] / 80.0 - 1.0).min() < 0.02


def test_parts_that_cancel_are_joined() -> None:
    wave = np.sin(np.arange(100.0))
    parts = (Part("valve", 2.3 * wave, 2.3), Part("start", -1.4 * wave, -1.4), Part("noise", 0.1 * wave, 0.1))
    found = join_parts(parts)
    assert [p.name for p in found] == ["valve+start", "noise"] and found[0].share == pytest.approx(0.9)
    assert found[0].curve == pytest.approx(0.9 * wave) and join_parts(parts[::2]) == parts[::2]
    words = effect_words.fitted_part(disturbed(), "valve+start")
    assert words == "valve, process and the start of the record"


# The story ---------------------------------------------------------------------------------------------------------


def test_an_effect_of_the_model_is_in_the_headline_and_in_what_to_do() -> None:
    study = stopped()
    said = facts(study)
    assert "Also in the model: a hard stop at 52.0" in said.headline
    assert "Check end stops" in said.then[-1]
    bullets = section(study, "next").bullets
    assert any("The stem moves only below 52.0" in b and "Check end stops" in b for b in bullets)


def test_a_limit_that_the_record_does_not_meet_is_not_told() -> None:
    study = stopped()
    lower, upper = (next(p for p in study.steps[-1].parameters if p.name == name) for name in ("lower", "upper"))
    assert upper.identifiable and not lower.identifiable
    assert "above" not in effect_words.sentence(study, "travel-limit")
    both = replace(study.steps[-1], parameters=tuple(
        replace(p, identifiable=True) for p in study.steps[-1].parameters))
    told = effect_words.sentence(replace(study, steps=(both,)), "travel-limit")
    assert "above" in told and "below" in told


def test_the_headline_has_one_share_of_friction_about_the_setpoint() -> None:
    study = drifting()
    assert facts(study).headline.startswith("What moves PV about its setpoint: ")
    assert study.severity.statement.startswith("without friction the valve would travel")
    parts = section(study, "swing")
    assert "about its mean" in parts.text[0] and "about the setpoint" in parts.tables[0].columns[2]


def test_what_is_missing_may_be_an_effect_that_was_not_asked() -> None:
    winner = Entry(Spec(), scored(recorded(np.sin(np.arange(600.0) ** 1.5))))
    said = missing_reason(winner, False, unasked=("leak", "positioner"))
    assert "the effects asked so far do not explain (not asked: leak, positioner)" in said
    assert "not asked" not in missing_reason(winner, False) and "catalogue" not in said


def test_a_record_too_short_for_the_tests_says_so() -> None:
    """The tests for whiteness need 380 samples, and nothing is said of what they would have found."""
    for samples, short in ((NEEDED - 40, True), (600, False)):
        winner = Entry(Spec(), scored(recorded(np.sin(np.arange(float(samples)) ** 1.5))))
        assert ("are needed to tell whether something is missing" in missing_reason(winner, False)) is short


def test_a_record_slower_than_the_scan_says_what_it_can_not_tell() -> None:
    noise = np.random.default_rng(2).standard_normal(600)
    coloured, white = (Entry(Spec(), scored(recorded(lfilter([1.0], [1.0, -root], noise)))) for root in (0.9, 0.0))
    assert "between the samples of 1 s" in missing_reason(coloured, True, unseen=True)
    assert "coloured noise, or what the output did between" in missing_reason(coloured, True, slow=True)
    for winner, slow in ((coloured, False), (white, True), (white, False)):
        assert missing_reason(winner, True, slow=slow) == ""


def test_a_model_that_fails_tells_what_the_measured_position_shows() -> None:
    study = drifting()
    seen = PositionEstimate(1.18, 1.589, 0.4009, 0.909, None, 0.6004, False)
    failing = replace(study, adequate=False, estimate=replace(study.estimate, from_position=seen))
    assert "leave 0.401 of it" in story.asked_position(failing) and "a positioner" in story.asked_position(failing)
    assert any("The measured position gives S 1.18 %" in b for b in section(failing, "next").bullets)
    assert not story.asked_position(replace(failing, adequate=True)) and not story.asked_position(study)


# Position ----------------------------------------------------------------------------------------------------------


def test_the_position_of_a_model_is_that_of_the_stem_in_front_of_the_trim() -> None:
    loop = simulate(setting_of(4.0, 2.0, ("valve-characteristic", {"log_rangeability": 3.5}), duration_s=600.0),
                    seed=2).loop
    model = Model(loop, Spec(effects=("valve-characteristic",)), s_max=7.0, period_s=60.0)
    truth = {"S": 4.0, "J": 2.0, "initial_residual_force": 0.0, "time_constant_s": 5.0, "dead_time_s": 5.0,
             "valve-characteristic:log_rangeability": 3.5}
    values = model.vector(truth)
    shown = rerun(loop, model.describe(values)).position
    assert loop.position is not None
    late = slice(300, None)  # behind the first slips, which an unknown start force moves
    assert np.abs(shown - loop.position)[late].max() < 0.1
    assert np.abs(model.evaluate(values).position - loop.position)[late].max() > 10.0
