"""Records slower than the scan, walks, and valves without friction: what is named there and what is not.

Studies of whole records are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from stictionid.fit.noise.completion import Refit, complete_quickly, stroke_score
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.segments import bind_model
from stictionid.model.spec import SOFT, Spec
from stictionid.selection.decide import _explains_little, prune_effects
from stictionid.selection.gates import GATES, Edge
from stictionid.selection.looks import edge_adding
from stictionid.selection.policy import Policy
from stictionid.selection.score import (
    COLOURED,
    NARROW,
    WALKING,
    Scored,
    complete_with_noise,
    least_free_run,
    noise_name,
)
from stictionid.typing import FloatArray

SETTING = Setting(Plant(2.5, 17.0, 5.0), Controller(0.35, 14.0, scan_s=1.0), S=3.6, J=2.6, duration_s=1500.0)


def true_model_under(noise: np.ndarray[Any, Any]) -> Refit:
    """The true model of a simulated loop, with `noise` (n,) added to its y, completed with a noise model."""
    loop = simulate(SETTING, seed=3).loop
    loop = replace(loop, process_value=loop.process_value + noise[:loop.samples])
    model = bind_model(loop, Spec(), s_max=8.0, period_s=60.0)
    true = {"S": 3.6, "J": 2.6, "time_constant_s": 17.0, "dead_time_s": 5.0}
    starts = [model.vector({**true, "initial_residual_force": force}) for force in np.linspace(-0.98, 0.98, 99)]
    best = min(starts, key=lambda start: model.evaluate(start).rmse)
    return complete_with_noise(model, best, best[None, :5], np.random.default_rng(0), Policy())


def test_a_slow_record_names_noise_but_not_slips_that_come_early_or_late(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, policy = np.random.default_rng(5), Policy()
    white, slips = rng.standard_normal(4000), np.where(rng.random(4000) < 0.03, rng.standard_normal(4000), 0.0)
    coloured, walk, late = (true_model_under(noise) for noise in (
        lfilter([0.3], [1.0, -0.8], white), 0.1 * np.cumsum(white), lfilter([1.5], [1.0, -0.8], slips)))
    assert noise_name(Scored(coloured, True), policy, slow=True) == COLOURED
    assert noise_name(Scored(walk, True), policy, slow=True) == WALKING
    assert not late.white and noise_name(Scored(late, True), policy, slow=True) == ""
    # Where an autoregression leaves more, a band is named that whitens it and gains enough.
    for white, gain, name in ((True, 50.0, NARROW), (False, 50.0, ""), (True, 10.0, "")):
        band = SimpleNamespace(white=white, gain_over=lambda other, gain=gain: gain)
        monkeypatch.setattr("stictionid.selection.score.complete_with_band", lambda done, band=band: band)
        assert noise_name(Scored(late, True), policy) == name


def test_an_effect_that_a_walk_stands_for_is_asked_for_in_levels() -> None:
    walking = Spec(increments=True, taps=SOFT)
    assert not edge_adding(walking, "step-disturbance@output").spec.increments
    assert edge_adding(walking, "extra-lag").spec.increments
    assert edge_adding(replace(walking, process="integrator"), "step-disturbance@load").spec.increments


@pytest.mark.parametrize(("name", "without", "blurred", "rejected"), [
    ("sinusoidal-disturbance", 1.04, True, True), ("sinusoidal-disturbance", 1.06, True, False),
    ("sinusoidal-disturbance", 1.04, False, False), ("slip-overshoot", 1.04, False, True),
    ("step-disturbance@load", 1.04, False, False), ("inverse-response", 1.04, False, True),
    ("inverse-response", 1.06, False, False), ("extra-lag", 1.04, False, False)])
def test_beside_a_valve_without_friction_no_effect_of_friction_is_named(
        name: str, without: float, blurred: bool, rejected: bool) -> None:
    """An inverse response is rejected, too: it may be the controller turned round. A further lag is not.

    Nor is a sine, whose gain over a process decides, unless the command between the samples is unknown.
    """
    child: Any = SimpleNamespace(done=SimpleNamespace(increments=False), rmse=1.0, without_friction=without)
    assert bool(dict(GATES)["friction"](Edge(name, child, child, Policy(), blurred=blurred))) is rejected


def known(spec: Spec, rmse: float, bic: float) -> Any:
    """A node in the memo of a search, with its free run, innovations of 0.5, and a BIC."""
    done = SimpleNamespace(bic=bic, innovation_sd=0.5)
    done.gain_over = lambda other: other.bic - bic
    scored = SimpleNamespace(rmse=rmse, done=done, needs_no_noise_model=lambda policy: rmse <= policy.carried * 0.5)
    return SimpleNamespace(spec=spec, scored=scored, passed=True, failed="")


@pytest.mark.parametrize(("slow", "error", "without", "stays"), [
    (True, 1.0, 1.2, False), (True, 0.5, 0.6, False), (True, 1.0, 1.4, True), (True, 0.5, 0.7, True),
    (False, 1.0, 1.2, True), (False, 0.5, 0.51, True)])
def test_in_a_slow_record_a_name_must_lower_the_least_free_run_clearly(
        slow: bool, error: float, without: float, stays: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A drift of the gain lowered the free run of clean loops by a tenth, or only that under a noise model."""
    winner, parent = known(Spec(effects=("travel-limit",)), error, 0.0), known(Spec(), 9.0 if slow else without, 500.0)
    search: Any = SimpleNamespace(policy=Policy(), slow=slow, memo={}, drop_effect=lambda entry, name: parent)
    monkeypatch.setattr("stictionid.selection.decide.least_free_run", lambda scored, beside: without)
    assert prune_effects(search, winner) is (winner if stays else parent)


def test_the_least_free_run_is_found_from_the_point_of_either_node() -> None:
    true = true_model_under(np.random.default_rng(5).standard_normal(4000) / 10)
    values = true.values.copy()
    values[3] *= 1.2
    bent = Scored(complete_quickly(true.model, values), False)
    assert bent.rmse > 1.1 * true.evaluated.rmse
    assert least_free_run(bent, bent) < 1.001 * true.evaluated.rmse
    values[0] *= 1.5
    lost = Scored(complete_quickly(true.model, values), False)
    assert least_free_run(lost, Scored(true, True)) < 1.001 * true.evaluated.rmse < least_free_run(lost, lost)


def scans(name: str, child_error: float, *, blurred: bool = True, strokes: int = 1) -> str:
    """Words of the gate on unknown scans for an effect, over a free run that errs by 1; empty where it passes.

    The effect lowers the one-step error in so many of 50 strokes.
    """
    before = 0.2 * np.random.default_rng(0).standard_normal(1000)
    after = np.where(np.arange(1000) < 20 * strokes, 0.8 * before, before)

    def scored(rmse: float, innovation: FloatArray, parameters: int) -> Any:
        done = SimpleNamespace(innovation_sd=0.2, increments=False, innovation=innovation, parameters=parameters,
                               good=np.ones(1000, bool), model=SimpleNamespace(period_s=40.0, step_s=1.0))
        return SimpleNamespace(rmse=rmse, done=done, free_run_at_noise=False,
                               needs_no_noise_model=lambda policy: rmse < 1.05 * done.innovation_sd)

    edge = Edge(name, scored(child_error, after, 7), scored(1.0, before, 6), Policy(), blurred=blurred)
    return dict(GATES)["scans"](edge)


def test_an_effect_must_leave_noise_or_help_in_most_strokes_under_unknown_scans() -> None:
    assert scans("travel-limit", 0.45) and not scans("step-disturbance", 0.45) and scans("step-disturbance", 0.55)
    assert not scans("travel-limit", 0.2) and not scans("travel-limit", 0.45, blurred=False)
    assert not scans("re-sticking", 0.45)
    assert not scans("travel-limit", 0.45, strokes=50) and not scans("step-disturbance", 0.55, strokes=50)


def test_numbers_that_are_paid_for_lower_the_score_of_strokes() -> None:
    rng = np.random.default_rng(1)
    before = rng.standard_normal(400)
    model = SimpleNamespace(period_s=40.0, step_s=1.0)
    one, two = (SimpleNamespace(innovation=e, good=np.ones(400, bool), parameters=n, model=model)
                for e, n in ((before, 6), (0.9 * before + 0.1 * rng.standard_normal(400), 9)))
    free, paid = (stroke_score(one, two, paid=p) for p in (False, True))  # type: ignore[arg-type]
    gains = [np.log(np.mean(before**2) / np.mean(two.innovation**2)) * 20.0
             + float(np.sum(before[k:k + 20]**2)) / np.mean(before**2)
             - float(np.sum(two.innovation[k:k + 20]**2)) / np.mean(two.innovation**2) for k in range(0, 400, 20)]
    spread = float(np.linalg.norm(np.array(gains) - np.mean(gains)))
    assert free == pytest.approx(np.sum(gains) / spread)
    assert paid == pytest.approx((np.sum(gains) - 3.0 * np.log(400)) / spread)


@pytest.mark.parametrize(("rmse", "stays"), [(1.9, False), (2.1, True)])
def test_a_rival_that_errs_twice_as_much_prunes_nothing(rmse: float, stays: bool) -> None:
    """A step disturbance gave way to a moving command that erred 13 times as much and cost 13 BIC."""
    winner, parent = known(Spec(effects=("travel-limit",)), 1.0, 0.0), known(Spec(), 3.0, 500.0)
    rival = known(Spec(between="corner", substeps=8), rmse, 5.0)
    search: Any = SimpleNamespace(policy=Policy(), slow=False, memo={"rival": rival}, drop_effect=lambda *_: parent)
    assert prune_effects(search, winner) is (winner if stays else rival)


def test_a_rest_beside_noise_alone_must_show_in_a_slow_record() -> None:
    policy = Policy()

    def scored(rmse: float) -> Any:
        return SimpleNamespace(rmse=rmse, done=SimpleNamespace(innovation_sd=rmse),
                               needs_no_noise_model=lambda policy: True)

    slow: Any = SimpleNamespace(policy=policy, slow=True)
    quick: Any = SimpleNamespace(policy=policy, slow=False)
    assert _explains_little(slow, scored(1.0), scored(1.05), "re-sticking")
    assert not _explains_little(slow, scored(1.0), scored(1.2), "re-sticking")
    assert not _explains_little(slow, scored(1.0), scored(1.05), "extra-lag")
    assert not _explains_little(quick, scored(1.0), scored(1.05), "re-sticking")


@pytest.mark.parametrize(("error", "alone", "stays"), [(1.0, False, True), (8.0, True, True), (8.0, False, False)])
def test_an_effect_that_is_asked_last_must_leave_noise(error: float, alone: bool, stays: bool) -> None:
    """A positioner stood for a slew limit, at 8 times the noise and 12 times the stickband."""
    policy = Policy()

    def scored(rmse: float) -> Any:
        return SimpleNamespace(rmse=rmse, noise_alone=alone, done=SimpleNamespace(innovation_sd=1.0),
                               needs_no_noise_model=lambda policy: False,
                               leaves_little=lambda policy: rmse < policy.nearly)

    search: Any = SimpleNamespace(policy=policy, slow=False)
    assert _explains_little(search, scored(error), scored(20.0), "positioner") is not stays
    assert not _explains_little(search, scored(error), scored(20.0), "travel-limit")
