"""Records slower than the scan, walks, and valves without friction: what is named there and what is not.

Studies of whole records are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from real_nodes import PERIOD_S, SAMPLES, Values, recorded, scored, search_among
from scipy.signal import lfilter

from stictionid.fit.noise.completion import RANDOM_WALK, Refit, complete_quickly
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.segments import bind_model
from stictionid.model.spec import SOFT, Spec
from stictionid.selection.decide import prune_effects
from stictionid.selection.entry import ADD, Entry
from stictionid.selection.gates import GATES, Edge
from stictionid.selection.looks import edge_adding
from stictionid.selection.node import key, other_commands
from stictionid.selection.policy import Policy
from stictionid.selection.score import (
    COLOURED,
    NARROW,
    WALKING,
    Scored,
    complete_with_noise,
    noise_name,
)
from stictionid.typing import FloatArray

SETTING = Setting(Plant(2.5, 17.0, 5.0), Controller(0.35, 14.0, scan_s=1.0), S=3.6, J=2.6, duration_s=1500.0)
WHITE = np.random.default_rng(4).standard_normal(SAMPLES)
STOP, STEP, REST, BENT = "travel-limit", "step-disturbance@load", "re-sticking", "gain-nonlinearity"


def true_model_under(noise: np.ndarray[Any, Any]) -> Refit:
    """The true model of a simulated loop, with `noise` (n,) added to its y, complete_with_noise with a noise model."""
    loop = simulate(SETTING, seed=3).loop
    loop = replace(loop, process_value=loop.process_value + noise[:loop.samples])
    model = bind_model(loop, Spec(), s_max=8.0, period_s=60.0)
    true = {"S": 3.6, "J": 2.6, "time_constant_s": 17.0, "dead_time_s": 5.0}
    starts = [model.vector({**true, "initial_residual_force": force}) for force in np.linspace(-0.98, 0.98, 99)]
    best = min(starts, key=lambda start: model.evaluate(start).rmse)
    return complete_with_noise(model, best, np.random.default_rng(0), Policy())


def test_a_slow_record_names_noise_but_not_slips_that_come_early_or_late() -> None:
    rng, policy = np.random.default_rng(5), Policy()
    white, slips = rng.standard_normal(4000), np.where(rng.random(4000) < 0.03, rng.standard_normal(4000), 0.0)
    coloured, walk, late = (true_model_under(noise) for noise in (
        lfilter([0.3], [1.0, -0.8], white), 0.1 * np.cumsum(white), lfilter([1.5], [1.0, -0.8], slips)))
    assert noise_name(Scored(coloured, True), policy, slow=True) == COLOURED
    assert noise_name(Scored(walk, True), policy, slow=True) == WALKING
    assert not late.white and noise_name(Scored(late, True), policy, slow=True) == ""


@pytest.mark.parametrize(("root", "period_s", "name"), [(0.998, 30.0, NARROW), (0.99, 90.0, "")])
def test_a_band_under_white_noise_is_named_where_it_resonates(root: float, period_s: float, name: str) -> None:
    """No autoregression whitens a band under white noise; one that is as broad as its cycle has no name."""
    rng = np.random.default_rng(0)
    band = lfilter([0.02], [1.0, -2.0 * root * np.cos(2.0 * np.pi / period_s), root**2], rng.standard_normal(4500))
    found = scored(recorded(band[-SAMPLES:] + rng.standard_normal(SAMPLES)))
    assert not found.white and noise_name(found, Policy()) == name


@pytest.mark.parametrize(("white", "cycles", "seed"), [(0.2, 4.0, 0), (0.2, 5.0, 2), (0.1, 4.0, 3)])
def test_a_slow_record_names_a_band_that_gains_the_margin_over_other_noise(white: float, cycles: float,
                                                                          seed: int) -> None:
    """The autoregression that stands for band and white noise is long and resonates for less than two cycles."""
    rng, angle = np.random.default_rng(seed), 2.0 * np.pi / 78.0
    radius = np.exp(-1.0 / cycles * angle / (2.0 * np.pi))
    band = lfilter([1.0], [1.0, -2.0 * radius * np.cos(angle), radius**2], rng.standard_normal(SAMPLES + 500))[500:]
    found = scored(recorded(0.3 * band / band.std() + white * rng.standard_normal(SAMPLES)))
    assert not found.noise_alone and noise_name(found, Policy(), slow=True) == NARROW


def test_an_effect_that_a_walk_stands_for_is_asked_for_in_levels() -> None:
    walking = Spec(increments=True, taps=SOFT)
    assert not edge_adding(walking, "step-disturbance@output").spec.increments
    assert edge_adding(walking, "extra-lag").spec.increments
    assert edge_adding(replace(walking, process="integrator"), "step-disturbance@load").spec.increments


@pytest.mark.parametrize(("name", "blurred", "rejected"), [
    ("sinusoidal-disturbance", True, True), ("sinusoidal-disturbance", False, False), ("slip-overshoot", False, True),
    ("step-disturbance@load", False, False), ("step-disturbance@load", True, False), ("inverse-response", False, True),
    ("extra-lag", False, False)])
def test_beside_a_valve_without_friction_no_effect_of_friction_is_named(name: str, blurred: bool,
                                                                        rejected: bool) -> None:
    """An inverse response is rejected, too: it may be the controller turned round. A further lag is not.

    Nor is a sine, whose gain over a process decides, unless the command between the samples is unknown. Beside a valve
    that sticks none is rejected.
    """
    for valve, free in (({"S": 0.02, "J": 0.01}, True), ({}, False)):
        child = scored(recorded(0.2 * WHITE, Spec(), valve), Spec(effects=(name,)), valve)
        edge = Edge(name, child, child, Policy(), blurred=blurred)
        said = dict(GATES)["friction"](edge)
        assert bool(said and said.reason) is (rejected and free)


def test_under_a_random_walk_the_likelihood_tells_a_valve_that_follows_its_command() -> None:
    """There a free run says nothing: the walk makes most of its error, with friction and without."""
    walk = 0.1 * np.cumsum(WHITE)
    for valve, free in (({"S": 0.02, "J": 0.01}, True), ({}, False)):
        child = scored(recorded(walk, Spec(), valve), Spec(effects=("inverse-response",)), valve)
        walking = complete_quickly(child.done.model, child.done.values, noise=RANDOM_WALK)
        edge = Edge("inverse-response", replace(child, done=walking), child, Policy())
        friction = dict(GATES)["friction"](edge)
        assert bool(friction.reason) is free and friction.threshold == Policy().alike
        assert friction.statistic < 5.0 if free else friction.statistic > 100.0


def pruned_of(name: str, errors: FloatArray, values: Values, *, slow: bool = False,
              plain: Spec = Spec()) -> tuple[str, ...]:
    """Effects that remain of a node with one on a record that has it, beside the `plain` node without it."""
    spec = replace(plain, effects=(name,))
    loop = recorded(errors, spec, values)
    root, child = Entry(plain, scored(loop, plain)), Entry(spec, scored(loop, spec, values), key(plain), ADD, name)
    return prune_effects(search_among(root, child, slow=slow), child).spec.effects


@pytest.mark.parametrize(("upper", "slow", "stays"), [
    (53.0, True, True), (53.4, True, True), (53.5, True, False), (53.0, False, True), (53.5, False, True)])
def test_in_a_slow_record_a_name_must_lower_the_free_run_clearly(upper: float, slow: bool, stays: bool) -> None:
    """A stop at 53.5 % cuts the free run by a twentieth, though it gains 126 BIC; one at 53 % nearly halves it.

    One at 53.4 % cuts it by a seventh.
    """
    assert pruned_of(STOP, 0.2 * WHITE, {f"{STOP}:upper": upper}, slow=slow) == ((STOP,) if stays else ())


@pytest.mark.parametrize(("curvature", "slow", "stays"), [(0.08, True, True), (0.03, True, False), (0.03, False, True)])
def test_in_a_slow_record_an_effect_off_the_valve_that_leaves_noise_must_lower_an_error_by_a_tenth(
        curvature: float, slow: bool, stays: bool) -> None:
    """A gain that varies moves no slip. At 0.08 the free run falls by 1.22 with it, at 0.03 by 1.03."""
    assert pruned_of(BENT, 0.2 * WHITE, {f"{BENT}:curvature": curvature}, slow=slow) == ((BENT,) if stays else ())


@pytest.mark.parametrize(("memory", "stays"), [(0.97, False), (0.985, True)])
def test_a_rival_that_errs_twice_as_much_prunes_nothing(memory: float, stays: bool) -> None:
    """A step disturbance gave way to a moving command that erred 13 times as much and cost 13 BIC.

    The rival leaves errors of longer memory, which its noise model holds: it costs no BIC.
    """
    spec, moving, where = Spec(effects=(STOP,)), Spec(between="corner", substeps=8), {f"{STOP}:upper": 53.0}
    loop, other = (recorded(np.asarray(lfilter([1.0], [1.0, -root], 0.05 * WHITE)), s, v)
                   for root, s, v in ((0.9, spec, where), (memory, moving, {})))
    root, winner = Entry(Spec(), scored(loop)), Entry(spec, scored(loop, spec, where), key(Spec()), ADD, STOP)
    rival = Entry(moving, scored(other, moving))
    assert rival.scored.done.gain_over(winner.scored.done) > 0.0
    assert prune_effects(search_among(root, winner, rival), winner) is (winner if stays else rival)


@pytest.mark.parametrize(("slow", "noise", "stays"), [(True, 0.8, False), (True, 0.2, True), (False, 0.8, True)])
def test_a_rest_beside_noise_alone_must_show_in_a_slow_record(slow: bool, noise: float, stays: bool) -> None:
    """Under a noise of 0.8 the rest lowers the free run by a twelfth, under one of 0.2 it halves it."""
    assert pruned_of(REST, noise * WHITE, {f"{REST}:restick_speed": 0.1}, slow=slow) == ((REST,) if stays else ())


@pytest.mark.parametrize(("plain", "noise"), [(Spec(), 0.8), (Spec(between="corner", substeps=8), 2.0)])
def test_a_rest_beside_noise_alone_stays_where_the_model_moves_the_command_between_samples(plain: Spec,
                                                                                           noise: float) -> None:
    """At these noises the rest lowers the free run by 7 % under either command, and the other error by 3 to 5 %."""
    rests = pruned_of(REST, noise * WHITE, {f"{REST}:restick_speed": 0.1}, slow=True, plain=plain)
    assert rests == (() if plain.held else (REST,))


def test_an_integrator_is_asked_for_where_a_lag_lags_nearly_as_far() -> None:
    """A lag of one period lags 81 degrees at the period of the loop, so that little tells it from an integrator."""
    periods = Policy().endless_lag
    assert 80.0 < np.degrees(np.arctan(2.0 * np.pi * periods)) < 90.0
    loop = recorded(0.2 * WHITE)
    for share, asked in ((0.9, False), (1.1, True)):
        node = scored(loop, values={"time_constant_s": share * periods * PERIOD_S})
        assert node.acts_as_integrator(Policy()) is asked


def test_a_base_is_fitted_with_every_other_course_of_the_command() -> None:
    moving = Spec(between="corner", substeps=8)
    commands, rests = (Spec(), moving), Spec(effects=(REST,))
    assert other_commands(rests, commands) == [replace(moving, effects=(REST,))]
    assert other_commands(moving, commands) == [Spec()]
    assert other_commands(Spec(effects=(STEP,)), commands) == []


@pytest.mark.parametrize(("name", "memory", "stays"), [
    ("positioner", 0.0, True), ("positioner", 0.99, False), (STOP, 0.99, True)])
def test_an_effect_that_is_asked_last_must_leave_noise(name: str, memory: float, stays: bool) -> None:
    """A positioner stood for a slew limit, at 8 times the noise and 12 times the stickband."""
    values = {"positioner": {"positioner:integral_rate": 0.03}, STOP: {f"{STOP}:upper": 53.0}}[name]
    errors = np.asarray(lfilter([1.0], [1.0, -memory], 0.05 * WHITE))
    assert pruned_of(name, errors, values) == ((name,) if stays else ())
