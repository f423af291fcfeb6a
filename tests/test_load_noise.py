"""Loads: noise ahead of the process is told from noise at the output, and steps at random times are found and named."""

from __future__ import annotations

from dataclasses import replace
from math import comb

import naive
import numpy as np
import pytest
from loops_with_effects import NOISE, small
from real_nodes import SAMPLES, holding, model_on, recorded, scored, true_values
from scipy.signal import lfilter

from stictionid.effects import parse
from stictionid.effects.contract import name_at, times_in
from stictionid.errors import UsageError
from stictionid.fit.cross_validation import Held
from stictionid.fit.noise.completion import complete_quickly
from stictionid.fit.noise.load import LOAD, step_response
from stictionid.fit.noise.load_steps import STEPS, find_steps, load_steps_of
from stictionid.model.spec import INTEGRATOR, Spec
from stictionid.numerics.noise.load import ROOTS, WALK, fit_load
from stictionid.selection.doubts import deciding_measurement
from stictionid.selection.gates import Edge, judge_edge
from stictionid.selection.policy import Policy
from stictionid.selection.score import COLOURED, NARROW, OF_LOAD, WALKING, Scored, noise_name, noise_rival

KEEP = np.exp(-1.0 / true_values()["time_constant_s"])
BAND = np.exp(-1.0 / (1.2 * 20.0))
WHITE = np.random.default_rng(11).standard_normal((2, SAMPLES))


def behind_process(load: np.ndarray) -> np.ndarray:
    """A load (n,) behind the lag of the true process, of unit gain, without its dead time."""
    return lfilter([0.0, 1.0 - KEEP], [1.0, -KEEP], load)


def of_load(root: float) -> np.ndarray:
    """Noise ahead of the process (n,) beside white noise at the output of 0.05."""
    return behind_process(0.5 * lfilter([1.0], [1.0, -root], WHITE[0])) + 0.05 * WHITE[1]


@pytest.mark.parametrize(("root", "ratio"), [(0.0, 0.0), (0.9, 0.0), (0.9, 17.78), (0.0, 3.162)])
def test_the_taps_of_a_load_are_those_of_the_best_predictor_of_its_spectrum(root: float, ratio: float) -> None:
    lags, power = 48, np.abs(np.fft.rfft(KEEP ** np.arange(4096))) ** 2
    covariance = naive.load_covariance(KEEP, root, ratio, lags)
    found = fit_load(covariance, 1e6, power, np.ones(1), ROOTS)
    assert found is not None and found.root == pytest.approx(root, abs=0.01)
    assert found.ratio == pytest.approx(ratio, rel=0.1, abs=1e-9)
    assert found.numbers == (root > 0.0) + (ratio > 0.0)
    # A finite predictor leaves at most a thousandth more than the whole past does.
    whole = np.concatenate([[1.0], found.taps])
    toeplitz = np.array([[covariance[abs(i - j)] for j in range(whole.size)] for i in range(whole.size)])
    best = naive.prediction_error(covariance)
    assert best * (1.0 - 1e-9) <= whole @ toeplitz @ whole <= 1.003 * best
    assert found.scale == pytest.approx(np.sqrt(best), rel=0.05)


def test_no_load_noise_is_fitted_to_what_has_no_variance() -> None:
    assert fit_load(np.zeros(5), 100.0, np.ones(9), np.ones(1)) is None
    assert fit_load(np.ones(1), 100.0, np.ones(9), np.ones(1), WALK) is None


@pytest.mark.parametrize(("kind", "name", "rival"), [("load", OF_LOAD, ""), ("walk ahead", OF_LOAD, ""),
                                                     ("output", COLOURED, ""), ("either", COLOURED, OF_LOAD),
                                                     ("walk", WALKING, ""), ("band", NARROW, "")])
def test_noise_has_the_name_of_where_it_enters_or_both_where_nobody_can_tell(kind: str, name: str, rival: str) -> None:
    noise = {"load": of_load(0.9), "walk ahead": behind_process(0.05 * np.cumsum(WHITE[0])) + 0.02 * WHITE[1],
             "output": 0.05 * lfilter([1.0], [1.0, -0.6], WHITE[0]), "walk": 0.05 * np.cumsum(WHITE[0]),
             # A band of little more than a cycle under white noise. No autoregression of 8 taps resonates as it does.
             "band": 0.011 * lfilter([1.0], [1.0, -2.0 * BAND * np.cos(2.0 * np.pi / 20.0), BAND**2], WHITE[0])
             + 0.08 * WHITE[1],
             # Noise at the output with the root of the process is white noise ahead of it.
             "either": 0.05 * lfilter([1.0], [1.0, -KEEP], WHITE[0])}[kind]
    record = recorded(noise)
    found = scored(record, replace(Spec(), increments=kind.startswith("walk")))
    assert (noise_name(found, Policy()), noise_rival(found, Policy(), name)) == (name, rival)
    assert deciding_measurement(name, (rival,) if rival else ()) or not rival


def test_fewer_numbers_complete_a_model_under_a_load_and_none_are_asked_where_pv_is_missing() -> None:
    noise = of_load(0.9)
    found = scored(recorded(noise))
    model, values = found.done.model, found.done.values
    load = complete_quickly(model, values, noise=LOAD)
    assert load.noise_numbers == 2 and load.gain_over(found.done) > 20.0 and Scored(load, True).white
    gaps = scored(recorded(np.where(np.random.default_rng(3).random(SAMPLES) < 0.2, np.nan, noise)))
    assert gaps.ahead is None
    plain = complete_quickly(gaps.done.model, gaps.done.values, noise=LOAD)
    np.testing.assert_array_equal(plain.taps, gaps.done.taps)


def test_slips_of_an_integrator_pass_for_no_load() -> None:
    drift = np.cumsum(0.002 * WHITE[0]) + 0.1 * WHITE[1]
    found = scored(recorded(drift, Spec(process=INTEGRATOR, increments=True)),
                   Spec(process=INTEGRATOR, increments=True))
    assert noise_name(found, Policy()) != OF_LOAD


def test_steps_are_found_where_they_are_and_none_in_noise() -> None:
    model = model_on(recorded(np.zeros(SAMPLES)), Spec())
    response = step_response(model, model.vector(true_values()), SAMPLES)
    moved, none = np.diff(response, prepend=0.0), np.empty(0, np.int64)
    counts, level = np.ones(SAMPLES), [WHITE[0]]
    e, truth = 0.02 * WHITE[1], [200, 640, 660, 1100]
    for k, size in zip(truth, (1.0, -1.5, 0.8, 2.0), strict=True):
        e = e + size * np.concatenate([np.zeros(k), moved[:SAMPLES - k]])
    np.testing.assert_allclose(find_steps(e, moved, counts, level, none), truth, atol=1)
    # A time that is a little off gives way to the right one.
    np.testing.assert_allclose(find_steps(e, moved, counts, level, np.array([205, 900])), truth, atol=1)
    assert find_steps(0.02 * WHITE[1], moved, counts, level, none).size == 0
    assert find_steps(np.zeros(SAMPLES), moved, counts, level, none).size == 0


def test_load_steps_are_read_from_the_innovations_of_a_model_without_them() -> None:
    steps = np.zeros(SAMPLES)
    steps[[250, 700, 720, 1200]] = 1.5, -2.0, 1.0, 2.5
    found = scored(recorded(behind_process(np.cumsum(steps)) + 0.03 * WHITE[1]), Spec(increments=True))
    name = load_steps_of(found.done)
    dead = true_values()["dead_time_s"]
    # A load that steps enters ahead of the dead time, too.
    np.testing.assert_allclose(times_in(name), np.array([250, 700, 720, 1200]) - dead, atol=1.0)
    assert load_steps_of(scored(recorded(0.03 * WHITE[1])).done) == ""
    assert load_steps_of(scored(recorded(of_load(0.9))).done) == ""


def test_load_steps_pay_for_the_choice_of_their_times_and_need_no_block_that_foretells_them() -> None:
    steps = np.zeros(SAMPLES)
    steps[[250, 700, 1200]] = 1.5, -2.0, 2.5
    record = recorded(behind_process(np.cumsum(steps)) + 0.03 * WHITE[1])
    parent, held = scored(record), Held(*(np.full(5, size) for size in (1.0, 100.0, 1.0, 100.0)))
    names = {size: load_steps_of(parent.done) if size else name_at(STEPS, np.array([300.0, 900.0])) for size in (0, 1)}
    gates = {size: judge_edge(Edge(name, holding(scored(record, Spec(effects=(name,))), held),
                                   holding(parent, held), Policy())) for size, name in names.items()}
    assert all(gate.passed for gate in gates[1])
    assert next(gate.name for gate in gates[0] if not gate.passed) == "gain"
    count = len(times_in(names[1]))
    assert gates[1][0].threshold == pytest.approx(20.0 + 2.0 * np.log(float(comb(SAMPLES, count))))


def test_the_name_of_load_steps_holds_their_times_and_refuses_what_is_none() -> None:
    name = name_at(STEPS, np.array([120.0, 431.5]))
    assert name == "random-load-steps:120+431.5"
    effect, _ = parse(name)
    context = model_on(small()[1], Spec()).context
    assert effect.columns is not None and effect.picked_from is not None and effect.enters_ahead("120+431.5")
    first, second = effect.columns(np.empty((0, 2)), context)
    assert first.shape == (context.process_value.size, 2) and first[119, 0] == 0.0 == second[430, 1]
    assert first[120, 0] == 1.0 and second[431, 0] == pytest.approx(0.5) and second[432, 1] == 1.0
    assert effect.picked_from(context) == 900 * 899 // 2
    for wrong in ("soon", "inf", "+".join(map(str, range(101)))):
        with pytest.raises(UsageError, match="names no times in seconds") as refusal:
            parse(f"random-load-steps:{wrong}")
        assert "write for example" in refusal.value.hint


def test_a_load_that_steps_in_a_simulation_is_one_that_the_model_has() -> None:
    setting, loop = small("random-load-steps")
    still = simulate_without(setting)
    assert np.ptp(loop.process_value - still.process_value) > 5.0 * NOISE


def simulate_without(setting):
    """The same loop with a load that rests."""
    from stictionid.model.closed_loop import simulate
    return simulate(replace(setting, effects=()), seed=21).loop
