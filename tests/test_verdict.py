"""Verdict, severity, descent and completion with a noise model, on loops whose truth is known.

Whole real loops, a valve that hardly moves, and what a record without friction looks like are in benchmarks/long.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import naive
import numpy as np
import pytest
from quick_loops import HELD, asked_only, known, quick
from real_nodes import SAMPLES, model_on, recorded, scored, true_values
from scipy.signal import lfilter

from stictionid.errors import UsageError
from stictionid.fit.context import Run
from stictionid.fit.cross_validation import Held
from stictionid.fit.friction_free import friction_free
from stictionid.fit.noise.prewhitening import whiten_model, whitened, with_noise_of
from stictionid.historian import read_loop
from stictionid.model.closed_loop import Controller, Plant, Setting, preset, simulate, with_stiction
from stictionid.model.model import Model
from stictionid.model.spec import SOFT, Spec
from stictionid.numerics.autoregression import first_rows
from stictionid.numerics.gauss_newton import descend
from stictionid.numerics.narrow_band import shape
from stictionid.numerics.population import refine
from stictionid.process.controller_law import usual_law
from stictionid.record.loop import Finding, Loop
from stictionid.record.oscillation import find_range
from stictionid.record.study import Study, Verdict
from stictionid.record.swing import band, touched_bands
from stictionid.reports.wording import severity_sentence
from stictionid.typing import FloatArray
from stictionid.verbs.identify import Options, identify
from stictionid.verdict.causes import steady_sine
from stictionid.verdict.detectable import detectable_sizes, need
from stictionid.verdict.from_position import from_position
from stictionid.verdict.judge import cap_verdict, checks_of, compare_with_free, judge, with_position
from stictionid.verdict.measured import Gain, Measured
from stictionid.verdict.odds import BLOCKS, FrictionGain

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))

import loops

SHARED = Path(__file__).resolve().parent.parent.parent / "shared" / "real_loops"


# Without the intervals, which no verdict is asked for here.
POINTS = Options(intervals=False)


def scanned(S: float, J: float, **changes: object):
    setting = with_stiction(preset("foptd"), S, J)
    return replace(setting, controller=replace(setting.controller, scan_s=1.0), noise_sd=0.1, **changes)


@cache
def fitted(make: Callable[[], Loop]) -> tuple[Study, tuple[Any, ...]]:
    """The study of a loop, and what `judge` was given of it: run, fit, record and position, to be judged again."""
    with mock.patch("stictionid.verbs.identify.judge", side_effect=judge) as asked:
        study = identify(make(), options=POINTS)
    return study, asked.call_args.args


def healthy() -> Loop:
    return loops.clean(12, "tight").loop


def sticking() -> Loop:
    return replace(simulate(scanned(5.0, 3.0), seed=1).loop, position=None)


# Descent -----------------------------------------------------------------------------------------------------------


def test_descent_finds_the_bottom_of_a_narrow_curved_valley() -> None:
    def residuals(p):
        x, y = 4.0 * p[:, 0] - 2.0, 4.0 * p[:, 1] - 1.0
        return np.stack([10.0 * (y - x**2), 1.0 - x])

    starts = np.array([[0.2, 0.9], [0.9, 0.1], [0.5, 0.5]])
    found = descend(residuals, lambda p: (residuals(p) ** 2).sum(axis=0), starts, turns=60, settle=1e-9)
    assert found.costs.max() < 1e-6
    assert found.points == pytest.approx(np.tile([0.75, 0.5], (3, 1)), abs=1e-3)


def test_descent_leaves_held_dimensions_and_bounds_alone() -> None:
    def residuals(p):
        return np.stack([p[:, 0] + 1.0, p[:, 1] - 0.3, p[:, 2] - 0.4])

    found = descend(residuals, lambda p: (residuals(p) ** 2).sum(axis=0), np.array([[0.5, 0.9, 0.9]]),
                    spread=np.array([1e-3, 1e-3, 0.0]))
    assert found.points[0] == pytest.approx([0.0, 0.3, 0.9], abs=1e-6)


def test_residuals_of_the_model_are_those_of_its_costs() -> None:
    loop = simulate(scanned(5.0, 3.0)).loop
    for spec in (Spec(), Spec(fixed={"gain": 3.0}), Spec(taps=(-0.5,)), Spec(process="integrator", increments=True)):
        model = Model(loop, spec, s_max=7.0, period_s=60.0)
        cube = np.random.default_rng(1).random((7, model.space.size))
        r = model.residuals(cube)
        assert np.sum(r**2, axis=0) == pytest.approx(model.costs(cube), rel=1e-8)


def test_a_population_does_not_settle_before_it_has_found_its_valley() -> None:
    # A valley 1000 times longer than wide, started beside its end: half the rounds go into learning its direction.
    def cost(p):
        a, b = p[:, 0] + p[:, 1] - 1.0, p[:, 0] - p[:, 1]
        return 1e6 * a**2 + (b - 0.4) ** 2 + 1e-3

    found = refine(cost, np.array([[0.3, 0.7]]), np.random.default_rng(3), spread=0.003, rounds=400, settle=1e-4)
    assert found.costs[0] < 1e-3 * 1.001


# Noise -------------------------------------------------------------------------------------------------------------


@asked_only("coloured-noise", "extra-lag")
def test_coloured_noise_is_a_step_of_its_own_and_gives_s_and_j_back() -> None:
    """A random walk is in benchmarks/long."""
    sd = 0.05
    study = identify(quick(1, effects=(("coloured-noise", {"root": 0.8, "innovation_sd": sd}),), noise_sd=0.0))
    assert study.steps[-1].added == "coloured-noise" or "coloured-noise" in study.steps[-1].effects
    assert pytest.approx(4.0, rel=0.01) == study.estimate.S
    assert pytest.approx(2.5, rel=0.15) == study.estimate.J
    assert study.steps[-1].error.rmse_one_step == pytest.approx(sd, rel=0.1)
    # A lag of 6 s has the root 0.85, so that white noise of the load would look the same.
    assert study.completed and study.carried_by == "disturbances of the load or the output"
    assert study.adequate_reason.startswith("explained but for disturbances of the load or the output")


def test_white_noise_gets_no_noise_model() -> None:
    assert [s.added for s in fitted(sticking)[0].steps] == [None]


def test_whitened_innovations_are_white_and_smaller() -> None:
    noise = ("coloured-noise", {"root": 0.9, "innovation_sd": 0.1})
    loop = simulate(replace(scanned(5.0, 3.0, effects=(noise,)), noise_sd=0.0), seed=2).loop
    model = Model(loop, Spec(), s_max=7.0, period_s=60.0)
    values = model.vector({"S": 5.0, "J": 3.0, "initial_residual_force": 0.0, "time_constant_s": 5.0,
                           "dead_time_s": 5.0})
    done = whiten_model(model, values)
    x = done.innovation[done.good]
    assert len(done.model.spec.taps) >= 1 and done.innovation_sd < 0.6 * done.rmse
    assert abs(float(x[1:] @ x[:-1] / (x @ x))) < 0.2  # AR(1) residuals of the same model have 0.9


def test_a_root_next_to_1_does_not_lose_the_level() -> None:
    """The innovations are blind to the level; the free run is not."""
    loop = simulate(scanned(5.0, 3.0), seed=2).loop
    values = {"S": 5.0, "J": 3.0, "initial_residual_force": 0.0, "time_constant_s": 5.0, "dead_time_s": 5.0}
    plain, blind = (Model(loop, Spec(taps=taps), s_max=7.0, period_s=60.0) for taps in ((), (-0.999999,)))
    level, same = (m.evaluate(m.vector(values)) for m in (plain, blind))
    assert abs(np.mean(same.residual[same.counted > 0])) < 1e-6
    assert same.rmse < 1.1 * level.rmse


def test_both_models_get_the_noise_of_either() -> None:
    noise = ("coloured-noise", {"root": 0.9, "innovation_sd": 0.1})
    loop = simulate(replace(scanned(5.0, 3.0, effects=(noise,)), noise_sd=0.0), seed=2).loop
    model = Model(loop, Spec(), s_max=7.0, period_s=60.0)
    values = model.vector({"S": 5.0, "J": 3.0, "initial_residual_force": 0.0, "time_constant_s": 5.0,
                           "dead_time_s": 5.0})
    rich = whiten_model(model, values)
    poor = whitened(model, rich.values)
    helped = with_noise_of(poor, rich)
    assert len(helped.model.spec.taps) == len(rich.model.spec.taps) and helped.innovation_sd < 1.01 * rich.innovation_sd
    assert with_noise_of(rich, poor) is rich  # white noise predicts worse here


def run_of(loop: Loop) -> Run:
    """The context of a verdict on a record."""
    return Run(loop, find_range(loop), Options(), law="chen", rng=np.random.default_rng(0),
               tell=lambda text, share: None)


def compared_on(errors: FloatArray, spec: Spec) -> Verdict:
    """The verdict on the true model of a record with these errors."""
    loop = recorded(errors)
    model = model_on(loop, spec)
    return compare_with_free(run_of(loop), whiten_model(model, model.vector(true_values())))


def wandering(root: float, sd: float, seed: int) -> FloatArray:
    """Errors of a root, or a walk, beside white noise of 0.05."""
    rng = np.random.default_rng(seed)
    return lfilter([1.0], [1.0, -root], sd * rng.standard_normal(1500)) + 0.05 * rng.standard_normal(1500)


def test_a_walk_proves_no_valve_by_its_free_run() -> None:
    """Friction lowers the one-step error by 7 % on one walk, by 9 % on another one; the free run by a third of both."""
    one, other = wandering(1.0, 0.15, 9), wandering(1.0, 0.15, 11)
    walks = Spec(increments=True, taps=SOFT)
    assert compared_on(one, Spec()).stiction == "stiction"
    assert compared_on(one, walks).stiction == "undecided"
    by_prediction = compared_on(other, walks)
    assert by_prediction.stiction == "stiction"
    assert by_prediction.confidence < compared_on(other, Spec()).confidence


@pytest.mark.parametrize("roots", [[0.9], [0.95, -0.3], [0.8, 0.7, -0.5, 0.2]])
def test_the_first_samples_of_a_noise_are_whitened_as_their_covariance_asks(roots: list[float]) -> None:
    taps = np.poly(roots)[1:]
    assert first_rows(taps) == pytest.approx(naive.whitening_of_first(taps), abs=1e-9)


def test_the_start_of_an_unstable_noise_says_nothing() -> None:
    assert not first_rows(np.poly([1.2, 0.5])[1:]).any()


def test_noise_that_decays_like_the_process_does_not_let_the_start_of_the_free_run_go() -> None:
    # The filter of the noise wipes out the start-up transient: without a say of the level it came out 100 times as big.
    root = float(np.exp(-1.0 / 10.0))
    setting = replace(scanned(5.0, 3.0, effects=(("coloured-noise", {"root": root, "innovation_sd": 0.1}),)),
                      noise_sd=0.0, plant=Plant(1.2, 10.0, 5.0))
    for seed in range(3):
        loop = simulate(setting, seed=seed).loop
        model = Model(loop, Spec(taps=(-root,)), s_max=7.0, period_s=60.0)
        done = model.evaluate(model.vector({"S": 5.0, "J": 3.0, "initial_residual_force": 0.0,
                                            "time_constant_s": 10.0, "dead_time_s": 5.0}))
        sd = 0.1 / np.sqrt(1.0 - root**2)
        assert done.rmse < 1.6 * sd  # the valve may have started elsewhere
        first = np.flatnonzero(done.counted > 0)[:5]
        assert np.abs(done.residual[first]).max() < 4.0 * sd


# Verdict -----------------------------------------------------------------------------------------------------------


def test_a_sticking_valve_is_called_so_with_its_evidence() -> None:
    verdict = fitted(sticking)[0].verdict
    assert verdict.stiction == "stiction" and verdict.confidence > 0.9
    assert verdict.evidence.likelihood_ratio > 200 and verdict.evidence.blocks_won == 5
    assert verdict.evidence.held_out_gain > 0.3 and verdict.evidence.held_out_won == 5
    assert "better on blocks it was not fitted to (5 of 5)" in verdict.reason
    assert len({c.name for c in verdict.checks}) == 10 and all(c.passed for c in verdict.checks)


def test_no_stiction_without_a_gain_on_blocks_that_were_not_fitted(monkeypatch) -> None:
    held = [Held(np.full(5, size), np.full(5, 100.0), np.full(5, size), np.full(5, 100.0)) for size in (1.1, 1.0)]
    answers = iter(held)
    _, given = fitted(sticking)
    monkeypatch.setattr("stictionid.verdict.measured.held_out_of", lambda *_: next(answers))
    verdict = judge(*given)
    assert verdict.stiction == "undecided" and "5 % worse on blocks" in verdict.reason


def test_a_record_of_which_nothing_can_be_held_out_is_trusted_less(monkeypatch) -> None:
    _, given = fitted(sticking)
    monkeypatch.setattr("stictionid.verdict.measured.held_out_of", lambda *_: None)
    verdict = judge(*given)
    assert verdict.stiction == "stiction" and verdict.confidence <= 0.6
    assert "the samples it was fitted to" in verdict.reason and "weaker" in verdict.reason
    assert verdict.evidence.held_out_gain is None


def test_a_model_with_friction_far_from_its_noise_is_never_sure() -> None:
    """An effect that the model lacks leaves several times the noise: the reason begins with it."""
    loop = read_loop(SHARED.parent / "hidden_effects" / "hidden_05.csv")
    verdict = identify(loop, options=replace(POINTS, base_only=True)).verdict
    assert verdict.stiction == "stiction" and verdict.confidence <= 0.6
    assert verdict.reason.startswith("the model is far from the noise, so the confidence is at most 0.6; ")
    # Held back it has a lower confidence, and the sentence does not state the other one.
    bad = Finding("compressed", "warning", "half of the samples lie on straight lines", caps_verdict=True)
    held_back = cap_verdict(verdict, replace(loop, origin=replace(loop.origin, findings=(bad,))))
    assert held_back.stiction == "undecided" and held_back.confidence <= 0.4
    assert "; otherwise: the model is far from the noise; " in held_back.reason and "at most" not in held_back.reason


def test_what_reading_found_caps_the_verdict() -> None:
    loop = sticking()
    verdict = fitted(sticking)[0].verdict
    bad = Finding("compressed", "warning", "half of the samples lie on straight lines", caps_verdict=True)
    spoilt = replace(loop, origin=replace(loop.origin, findings=(bad,)))
    assert cap_verdict(verdict, loop) is verdict
    held_back = cap_verdict(verdict, spoilt)
    assert held_back.stiction == "undecided" and "straight lines" in held_back.reason


@pytest.mark.skipif(not SHARED.is_dir(), reason="the real loops are not here")
def test_a_real_loop_is_judged_as_its_experts_do() -> None:
    """The base of its half; benchmarks/long judges the whole records of all loops."""
    loop = read_loop(SHARED / "loop_B.csv").cut(0, 500)
    assert identify(loop, options=replace(POINTS, base_only=True)).verdict.stiction == "stiction"


@pytest.mark.skipif(not SHARED.is_dir(), reason="the real loops are not here")
@pytest.mark.parametrize(("name", "code"), [("export_I.txt", "dead-signal"), ("export_K.txt", "output-not-a-valve")])
def test_real_records_that_cannot_tell_say_why(name, code) -> None:
    study = identify(read_loop(SHARED / name))
    assert study.estimate is None and study.verdict.evidence.code == code


# What moves it instead ---------------------------------------------------------------------------------------------


def test_a_steady_sine_holds_its_variance_and_a_wandering_wave_does_not() -> None:
    rng, t = np.random.default_rng(3), np.arange(1500)
    everywhere = np.ones(t.size, bool)
    period, sine, _ = steady_sine(np.sin(2 * np.pi * t / 73.4) + 0.1 * rng.standard_normal(t.size), everywhere)
    assert period == pytest.approx(73.4, rel=0.005) and sine > 0.95
    phase = np.cumsum(0.15 * rng.standard_normal(t.size))
    assert steady_sine(np.sin(2 * np.pi * t / 73.4 + phase), everywhere)[1] < 0.6
    square = np.sign(np.sin(2 * np.pi * t / 60.0 + 0.3))
    _, one, all_ = steady_sine(square, everywhere)
    assert one == pytest.approx(8 / np.pi**2, abs=0.02) and all_ > one + 0.05


# Severity ----------------------------------------------------------------------------------------------------------


def test_the_controller_is_read_from_the_record() -> None:
    law = usual_law(simulate(scanned(5.0, 3.0), seed=1).loop)
    assert law is not None
    assert law.gain == pytest.approx(0.1, rel=0.02) and law.integral_time_s == pytest.approx(5.0, rel=0.02)


def test_a_loop_without_setpoint_has_no_usual_law() -> None:
    assert usual_law(replace(simulate(scanned(5.0, 3.0)).loop, setpoint=None)) is None


def test_severity_is_what_the_same_loop_does_without_friction() -> None:
    setting = scanned(4.0, 2.5, setpoint_moves=((0.0, 0.0), (10.0, 2.0)), duration_s=500.0)
    study = identify(simulate(setting, seed=1).loop, options=replace(POINTS, base_only=True))
    found, swing = study.severity, study.swing
    repaired = simulate(replace(setting, S=0.0, J=0.0), seed=1).loop.process_value
    assert found.pv_sd_repaired == pytest.approx(float(np.std(repaired)), rel=0.3)
    assert 0.8 < found.share_of_pv_variance <= 1.0 and found.band == "significant"
    assert found.travel_per_day_repaired < found.travel_per_day
    # Parts and causes add up; the cycle is the valve's own and ends with a perfect one.
    assert sum(s.share for s in swing.parts) == pytest.approx(1.0)
    assert sum(s.share for s in swing.causes) == pytest.approx(1.0)
    assert swing.causes[0].part == "valve" and swing.causes[0].share > 0.8 and swing.goes_on is not True


@pytest.mark.parametrize(("S", "word"), [(0.2, "negligible"), (0.7, "watch"), (1.5, "moderate"), (3.0, "significant"),
                                         (9.0, "severe")])
def test_bands_of_severity(S, word) -> None:
    assert band(S) == word


def test_the_smallest_size_of_a_ratio_has_no_unit() -> None:
    rng = np.random.default_rng(3)
    done = scored(recorded(0.05 * rng.standard_normal(SAMPLES)), full=False).done
    said = detectable_sizes(["direction-dependent-lag"], done)["direction-dependent-lag"]
    assert re.fullmatch(r"closing_ratio (from|down to) [\d.]+", said)


def test_the_smallest_noise_would_raise_the_likelihood_by_what_a_test_needs() -> None:
    """The expected rise is that of the mean over its geometric mean, of the spectrum over that of white noise."""
    done = scored(recorded(0.05 * np.random.default_rng(3).standard_normal(SAMPLES)), full=False).done
    rows, sd = float(done.good.sum()), done.innovation_sd
    said = {name: float(words.split()[2]) for name, words in detectable_sizes(
        ["random-walk-disturbance", "narrow-band-disturbance", "coloured-noise"], done).items()}
    w = np.pi * (np.arange(40_000) + 0.5) / 40_000
    ratio, amplitude = said["random-walk-disturbance"] / sd, said["narrow-band-disturbance"] / sd
    period = 0.6 * done.model.period_s / done.model.step_s
    band = shape(w, np.array([2.0 * np.pi / period]), np.array([5.0]), np.array([amplitude**2 / 2.0]))[:, 0]
    walk = np.log((1.0 + ratio**2 * rows / 6.0) / (1.0 + ratio + 0.5 * ratio**2))
    root = -np.log1p(-said["coloured-noise"]**2)
    for gain, count in ((walk, 1), (np.log(band.mean()) - np.log(band).mean(), 3), (root, 1)):
        assert rows * gain == pytest.approx(need(rows, count), rel=0.12)


def test_an_interval_touches_the_bands_between_its_ends() -> None:
    assert touched_bands(1.5, (0.3, 6.0)) == ("negligible", "watch", "moderate", "significant", "severe")
    assert touched_bands(1.5, (1.6, 1.9)) == touched_bands(1.5, None) == ("moderate",)
    assert severity_sentence(1.5, (0.7, 2.5)) == "moderate, could be watch or significant"
    assert severity_sentence(3.0, (0.7, 3.5)) == "significant, could be watch or moderate"


def test_a_disturbance_of_another_length_is_refused() -> None:
    with pytest.raises(UsageError, match="7 samples"):
        simulate(preset("foptd"), disturbance=np.zeros(7))


# A measured position -----------------------------------------------------------------------------------------------


def seen(loop):
    return from_position(loop, law="chen", s_max=float(np.ptp(loop.output)), rng=np.random.default_rng(0))


def test_a_position_that_rests_and_jumps_is_a_valve_that_sticks_whatever_y_shows() -> None:
    position = seen(simulate(scanned(5.0, 3.0, duration_s=600.0), seed=2).loop)
    assert position is not None and position.shows_stiction and pytest.approx(5.0, rel=0.01) == position.S
    said = with_position(Verdict("no stiction", "nothing to see", 0.9), position)
    assert said.stiction == "stiction" and "nothing to see" in said.reason and "S is 5" in said.reason
    sure = Verdict("stiction", "seen in y", 0.98)
    assert with_position(sure, position) is sure and with_position(sure, None) is sure


@pytest.mark.parametrize("deviation", [0.0, 0.5, 2.0])
def test_a_position_recorded_by_exception_shows_no_stiction(deviation: float) -> None:
    rng = np.random.default_rng(4)
    u = 50.0 + 3.0 * np.sin(np.arange(800) / 9.0) + 0.05 * rng.standard_normal(800)
    z, last = u + 0.02 * rng.standard_normal(800), np.inf
    for k in range(z.size):
        last = z[k] if abs(z[k] - last) > deviation else last
        z[k] = last
    position = seen(Loop(output=u, process_value=u, position=z))
    assert position is not None and not position.shows_stiction
    clean = Verdict("no stiction", "nothing to see", 0.9)
    assert with_position(clean, position) is clean


# A valve that rests ------------------------------------------------------------------------------------------------


# "No stiction" is a claim ------------------------------------------------------------------------------------------


def test_no_stiction_says_which_S_is_excluded() -> None:
    verdict = fitted(healthy)[0].verdict
    assert verdict.stiction == "no stiction" and "is excluded" in verdict.reason
    passed = {c.name for c in verdict.checks if c.passed}
    assert {"no friction predicts better", "S excluded"} <= passed and "likelihood ratio" not in passed
    assert 0.0 < verdict.evidence.S_excluded_above <= 0.2 * np.ptp(healthy().output)


@pytest.mark.parametrize("seed", [10_001])
def test_the_bound_on_S_does_not_exclude_the_true_one(seed: int) -> None:
    from stictionid.fit.context import Run
    from stictionid.verdict.excluded import largest_possible

    known = loops.sticky(seed)
    run = Run(known.loop, find_range(known.loop), Options(), law="chen", order=1, rng=np.random.default_rng(0),
              tell=lambda text, share: None)
    fit = run.fit(Spec())
    sticking = whiten_model(fit.model, fit.values)
    found = largest_possible(sticking, friction_free(run, sticking), float(np.ptp(known.loop.output)))
    assert found is not None and (found.above is None or found.above >= known.S)
    assert found.gain.ratio > 40.0  # a valve that sticks: friction predicts better than none


def even_gain(ratio: float) -> FrictionGain:
    """Friction that gains alike in each block of 1,000 samples, with free S, J and initial force."""
    return FrictionGain(np.full(BLOCKS, ratio / BLOCKS), 3, 1000)


def test_a_smaller_bound_makes_the_claim_surer(monkeypatch: pytest.MonkeyPatch) -> None:
    from stictionid.verdict.excluded import Possible

    (_, given), told = fitted(healthy), []
    swing = float(np.ptp(healthy().output))
    for share in (0.02, 0.15, 0.19, 0.3):
        monkeypatch.setattr("stictionid.verdict.judge.largest_possible",
                            lambda *_, s=share: Possible(s * swing, even_gain(14.0)))
        told.append(judge(*given))
    assert [v.stiction for v in told] == ["no stiction"] * 3 + ["undecided"]
    assert told[0].confidence == 0.98
    # ln(1/2) + (14 - 2 ln 1000) / 2 + ln(share), as odds of friction
    for verdict, share in zip(told[1:3], (0.15, 0.19), strict=True):
        odds = 0.5 * share * float(np.exp(7.0)) / 1000.0
        assert verdict.confidence == pytest.approx(1.0 / (1.0 + odds), abs=1e-6)
    assert "S up to 30 % of it is not excluded" in told[3].reason


def test_friction_that_predicts_better_in_the_structure_without_it_denies_the_claim(
        monkeypatch: pytest.MonkeyPatch) -> None:
    from stictionid.verdict.excluded import Possible

    _, given = fitted(healthy)
    monkeypatch.setattr("stictionid.verdict.judge.largest_possible", lambda *_: Possible(0.01, even_gain(60.0)))
    verdict = judge(*given)
    assert verdict.stiction == "undecided" and "likelihood ratio 60" in verdict.reason


def test_the_prediction_alone_is_never_sure_of_stiction() -> None:
    """Slow errors hide the free run: friction then explains 2 % of the variance of y, and next to nothing of a walk."""
    by_free_run = compared_on(wandering(0.0, 0.2, 4), Spec())
    assert by_free_run.stiction == "stiction" and by_free_run.confidence > 0.95
    alone = compared_on(wandering(0.997, 0.11, 4), Spec())
    assert (alone.evidence.likelihood_ratio or 0.0) > 200.0 and (alone.evidence.share_of_pv_variance or 0.0) < 0.03
    assert (alone.stiction, alone.confidence) == ("stiction", 0.6)
    nothing = compared_on(wandering(1.0, 0.25, 4), Spec())
    assert (nothing.evidence.error_drop or 0.0) < 0.05 and nothing.stiction == "undecided"


def test_every_check_of_a_verdict_says_what_was_measured_and_what_is_needed() -> None:
    """A ratio of 30 is more than nothing speaks for and less than sticks; a worse held-out block fails."""
    checks = checks_of(Measured(even_gain(30.0), 3, 0.5, 0.6, 0.3), Gain(-0.1, 1, 5))
    assert (checks.speaks.passed, checks.sticks.passed, checks.blocks.passed) == (True, False, False)
    assert checks.sticks.statistic == 30.0 < checks.sticks.threshold and checks.blocks.statistic == 3
    assert not checks.held_out.passed and checks.held_out.statistic == -0.1
    unknown = checks_of(Measured(even_gain(30.0), 3, 0.5, 0.6, 0.3), None).held_out
    assert unknown.passed and unknown.statistic is None


def test_the_controller_turned_round_is_no_process() -> None:
    """A command that moves with y between samples tells y by the controller's law, with a gain of the wrong sign."""
    rng, n = np.random.default_rng(3), 900
    wander = np.convolve(rng.standard_normal(n + 40), np.hanning(40), "valid")[:n]
    setting = Setting(Plant(0.65, 24.7, 6.0), Controller(3.0, 24.0), 0.0, 0.0, duration_s=float(n))
    loop = replace(simulate(setting, seed=3, disturbance=2.0 * wander / np.ptp(wander)).loop, position=None)
    valve = {"S": 0.5, "J": 0.3, "initial_residual_force": 0.0, "time_constant_s": 24.7, "dead_time_s": 6.0}
    gains = []
    for seen in (replace(loop, setpoint=None), loop):
        model = Model(seen, Spec(between="corner", substeps=8), s_max=7.0, period_s=60.0)
        gains.append(friction_free(run_of(seen), whiten_model(model, model.vector(valve))).evaluated.gain)
    assert gains[0] == pytest.approx(-1.0 / 3.0, rel=0.2)
    assert gains[1] > 0.0
    spec = Spec(between="corner", substeps=8, friction_free=True, taps=(-0.999,))
    model = Model(replace(loop, setpoint=None), spec, s_max=7.0, period_s=60.0)
    # The law of r, y and u tells the sign: then the wrong one explains nothing.
    known = Model(loop, spec, s_max=7.0, period_s=60.0)
    turned = np.array([0.0, 0.0, 0.0, 0.05, 0.0])
    assert known.costs_of(turned[:, None])[0] == pytest.approx(known.shared.target_energy)
    evaluated, before = known.evaluate(turned), model.evaluate(turned)
    assert evaluated.gain == 0.0 and evaluated.sse == pytest.approx(known.shared.target_energy, rel=1e-6)
    assert before.gain < 0.0 and before.sse < 0.2 * evaluated.sse


def test_friction_that_explains_most_of_the_free_run_is_not_denied(monkeypatch: pytest.MonkeyPatch) -> None:
    from stictionid.verdict.excluded import Possible

    _, (run, fit, *_) = fitted(healthy)
    sticks = whiten_model(fit.model, fit.values)
    monkeypatch.setattr("stictionid.verdict.judge.largest_possible", lambda *_: Possible(0.01, even_gain(-200.0)))
    told = [compare_with_free(run, replace(sticks, rmse=share * sticks.rmse)) for share in (1.0, 0.1)]
    assert all((v.evidence.likelihood_ratio or 0.0) < 15.0 for v in told)
    assert [v.stiction for v in told] == ["no stiction", "undecided"]
    assert "most of the free-run error" in told[1].reason


@pytest.mark.parametrize("scan_s", [0.0, 1.0])
def test_an_error_that_no_transmitter_resolves_is_near_the_noise_in_every_sentence(scan_s: float) -> None:
    """Without noise a held command may leave a few times what a linear model does: nobody would see that."""
    loop = quick(noise_sd=0.0, controller=Controller(0.15, 6.0, scan_s=scan_s))
    study = known(loop, options=replace(HELD, between="hold" if scan_s else "corner"))
    error = study.steps[-1].error
    assert error.noise_sd is not None and error.noise_sd < error.rmse < loop.resolution
    # (a moving one leaves less: its valve turns at the peaks between samples)
    assert error.rmse > 2.0 * error.noise_sd if scan_s else error.rmse < 0.3 * loop.resolution
    assert study.adequate and "no transmitter resolves it" in study.adequate_reason
    assert "far from the noise" not in study.verdict.reason
    assert not {"intervals-conditional", "noise-model"} & {f.code for f in study.steps[-1].findings}
