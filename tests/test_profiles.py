"""Intervals of S and J: the ends of the steps of the cost, another first slip, other dead times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from stictionid.fit.fit import search
from stictionid.fit.intervals.assemble import (
    INTERVAL_THRESHOLD,
    PROCESS_THRESHOLD,
    cloud,
    effective_rows,
    intervals_of,
    outline,
    widen_cloud,
)
from stictionid.fit.intervals.profile import Mover, spread_over
from stictionid.fit.intervals.smooth import smooth_intervals
from stictionid.fit.intervals.thresholds import Plateaus, plateaus, ridges
from stictionid.fit.noise.bias_correction import noise_of, slopes_of
from stictionid.fit.points.moves import descend_model, longest_first, with_start
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.numerics.autoregression import autoregression, filter_residual
from stictionid.record.oscillation import find_range

TRUE = (3.0, 1.5)


@pytest.fixture(scope="module")
def fitted() -> tuple[Model, np.ndarray, np.ndarray]:
    """A scanned loop of 1000 s with noise, its cloud and the cloud's costs."""
    setting = Setting(Plant(1.5, 10.0, 4.0), Controller(0.7, 10.0, scan_s=1.0), *TRUE, duration_s=1000.0,
                      setpoint_moves=((0.0, 3.0),), noise_sd=0.05)
    loop = simulate(setting, seed=3).loop
    found = find_range(loop)
    model = Model(loop, Spec(), s_max=found.s_max, period_s=found.period_median_s)
    points, _ = search(model, np.random.default_rng(0))
    return model, *cloud(model, points[0], np.random.default_rng(0))


def spans(model: Model, cube: np.ndarray, cost: np.ndarray) -> dict[str, tuple[float, float]]:
    """From where to where S and J of possible points go."""
    best = model.evaluate(model.values(cube[[cost.argmin()]])[:, 0])
    limit = cost.min() * np.exp(INTERVAL_THRESHOLD / effective_rows(np.nan_to_num(best.innovation), model.weight))
    values = model.values(cube[cost <= limit])
    return {name: (float(x.min()), float(x.max())) for name, x in zip("SJ", values[:2], strict=True)}


def test_no_valve_that_does_as_well_lies_outside(fitted) -> None:
    model, cube, cost = fitted
    narrow, wide = spans(model, cube, cost), spans(model, *widen_cloud(model, cube, cost)[:2])
    best = model.values(cube[[cost.argmin()]])[:, 0]
    # The rungs end a little inside the last step: here by 2e-6 of S, where the true S lies.
    margins = {"S": 1e-4 * best[0], "J": 1e-3 * best[0]}
    for name, truth in zip("SJ", TRUE, strict=True):
        assert wide[name][0] <= narrow[name][0] and wide[name][1] >= narrow[name][1]
        assert wide[name][0] - margins[name] <= truth <= wide[name][1] + margins[name]
    rows = effective_rows(np.nan_to_num(model.evaluate(best).innovation), model.weight)
    limit = cost.min() * np.exp(INTERVAL_THRESHOLD / rows)
    # Every valve of a dense grid beside the optimum, with the process and the start that go best with it.
    S, J = (np.linspace(2 * low - high, 2 * high - low, 31) for low, high in (wide["S"], wide["J"]))
    grid = best[:, None].repeat(S.size * J.size, axis=1)
    grid[0], grid[1] = S.repeat(J.size), np.tile(J, S.size)
    found = descend_model(model, model.cube(grid), fixed=(0, 1), turns=3)
    alike = model.values(found.points[found.costs <= limit])
    assert alike.shape[1] > 20
    for i, (name, margin) in enumerate(margins.items()):
        assert wide[name][0] - margin <= alike[i].min() and alike[i].max() <= wide[name][1] + margin


def test_the_interval_of_s_leaves_out_a_tenth_of_the_likelihood_but_never_the_answer(fitted) -> None:
    model, cube, cost = fitted
    top = cube[cost.argmin()]
    steps = plateaus(model, top)
    assert steps is not None
    rows = float(model.shared.rows)
    likelihood = np.exp(-0.5 * rows * np.log(steps.cost / steps.cost.min()))
    low, high = steps.interval(rows, 0.9)
    share = np.cumsum(0.5 * (likelihood[1:] + likelihood[:-1]) * np.diff(steps.S))
    ends = np.interp([low, high], steps.S[1:], share / share[-1])
    assert ends.tolist() == pytest.approx([0.05, 0.95], abs=0.03)
    cube, cost, S, _ = widen_cloud(model, cube, cost)
    e = model.evaluate(model.values(cube[[cost.argmin()]])[:, 0])
    for answer in (e, replace(e, values={**e.values, "S": 0.9 * low})):
        given = intervals_of(model, cube, cost, float(cost.min()), answer, S)["S"]
        own = answer.values["S"]
        assert given == pytest.approx((min(S[0], own), max(S[1], own)), rel=1e-9)


def test_steps_count_as_much_as_their_width_and_their_cost_say() -> None:
    S = np.linspace(0.0, 10.0, 1001)
    rows = 1000.0
    # A step of width 1 about 2, one of width 2 about 7 that loses 2 ln 2: half as likely, so of the same weight.
    cost = np.select([np.abs(S - 2.0) < 0.5, np.abs(S - 7.0) < 1.0], [1.0, np.exp(2.0 * np.log(2.0) / rows)], 2.0)
    steps = Plateaus(S, cost, np.empty((0, 5)), np.empty(0))
    assert steps.interval(rows, 0.9) == pytest.approx((1.6, 7.8), abs=0.02)
    assert steps.interval(rows, 0.5) == pytest.approx((2.0, 7.0), abs=0.02)
    # Where the second is beyond likelihood there is one step, of which a tenth is left out.
    steps = Plateaus(S, np.where(np.abs(S - 7.0) < 1.0, 1.1, cost), np.empty((0, 5)), np.empty(0))
    assert steps.interval(rows, 0.9) == pytest.approx((1.55, 2.45), abs=0.02)


def test_a_step_one_sample_of_dead_time_away_is_found(fitted) -> None:
    model, cube, cost = fitted
    top = cube[cost.argmin()]
    values = model.values(top[None])[:, 0]
    # From a stickband that is one sample early, its process descended to, the steps lead back to the best one.
    wrong = values.copy()
    wrong[0] -= Mover(model, values).pace * model.step_s
    wrong[4] += model.step_s
    near = descend_model(model, with_start(model, model.cube(wrong[:, None])), fixed=(0, 2))
    assert near.costs[0] > 1.05 * cost.min()
    steps = plateaus(model, near.points[0])
    assert steps is not None
    assert steps.costs.min() == pytest.approx(cost.min(), rel=2e-3)
    best = model.values(steps.points[[steps.costs.argmin()]])[:, 0]
    assert best[0] == pytest.approx(values[0], rel=2e-3) and best[4] == pytest.approx(values[4], abs=0.1)


def test_a_given_s_and_a_moving_command_have_no_steps(fitted) -> None:
    model, cube, cost = fitted
    for spec in (replace(model.spec, between="corner", substeps=4), replace(model.spec, fixed={"S": 3.0})):
        other = Model(model.loop, spec, s_max=model.s_max, period_s=model.period_s)
        assert plateaus(other, other.cube(model.values(cube[[cost.argmin()]]))[0]) is None


def test_a_moved_valve_slips_first_at_the_same_sample(fitted) -> None:
    model, cube, cost = fitted
    best = model.values(cube[[cost.argmin()]])
    moved = Mover(model, best[:, 0])(best, 1, best[1] - 0.05 * best[0])[:, 0]

    def first(values: np.ndarray) -> int:
        path = model.positions(values)[:, 0]
        return int(np.argmax(np.abs(path - path[0]) > 1e-9))

    # J moved with S as it is, and with S moving along.
    assert moved.shape[1] == 2 and moved[0].tolist() == pytest.approx([best[0, 0], 0.95 * best[0, 0]])
    assert first(moved[:, :1]) == first(moved[:, 1:]) == first(best)


def test_the_outline_is_a_few_possible_points_over_the_ranges(fitted) -> None:
    model, cube, cost = fitted
    cube, cost, *_ = widen_cloud(model, cube, cost)
    few, all_ = model.values(outline(model, cube, cost)), spans(model, cube, cost)
    assert 3 <= few.shape[1] <= 16
    for i, name in enumerate("SJ"):
        assert all_[name][0] <= few[i].min() and few[i].max() <= all_[name][1]
        assert np.ptp(few[i]) > 0.5 * (all_[name][1] - all_[name][0])
    assert spread_over(np.array([0.0, 0.1, 0.9, 1.0]), np.array([2.0, 1.0, 4.0, 3.0]), 2).tolist() == [1, 3]


def test_a_noise_model_knows_what_the_fit_took_of_the_noise() -> None:
    # Slow slopes take slow noise: over many records the root of the residual is too near to 0, put right it is not.
    root, n = 0.8, 600
    setting = Setting(Plant(1.5, 10.0, 4.0), Controller(0.7, 10.0, scan_s=1.0), *TRUE, duration_s=float(n),
                      setpoint_moves=((0.0, 3.0),))
    quiet = simulate(setting, seed=3).loop
    found = find_range(quiet)
    model = Model(quiet, Spec(taps=(-root,)), s_max=found.s_max, period_s=found.period_median_s)
    true = model.vector({"S": 3.0, "J": 1.5, "initial_residual_force": 0.85, "time_constant_s": 10.0,
                         "dead_time_s": 4.0})
    e = model.evaluate(true)
    X, good = slopes_of(model, e), e.counted > 0
    rng, plain, right = np.random.default_rng(1), [], []
    for _ in range(200):
        noise = lfilter([1.0], [1.0, -root], rng.standard_normal(n + 100))[100:]
        white, rows = filter_residual(noise, good, np.array([1.0, -root]))
        Z = np.stack([filter_residual(x, good, np.array([1.0, -root]))[0] for x in X.T], axis=1)
        left = noise - X @ np.linalg.lstsq(Z[rows], white[rows], rcond=1e-9)[0]
        plain.append(autoregression(left, good, 1)[0])
        right.append(noise_of(model, replace(e, residual=left), np.ones(1), 1)[0])
    error = np.std(right) / np.sqrt(len(right))
    assert np.mean(plain) + root > 0.012
    assert abs(np.mean(right) + root) < 0.005 + error and abs(np.mean(right) + root) < 0.5 * (np.mean(plain) + root)


def test_a_stem_between_two_stops_passes_nothing_on_that_the_noise_model_could_miss() -> None:
    # (differences hide its level, so that no parameter moves what is left; this was an IndexError)
    loop = simulate(Setting(Plant(1.5, 10.0, 2.0), Controller(0.7, 10.0, scan_s=1.0), 4.0, 1.5, duration_s=1000.0,
                            noise_sd=0.1), seed=3).loop
    spec = Spec(effects=("travel-limit", "extra-lag"), friction_free=True, increments=True)
    model = Model(loop, spec, s_max=8.0, period_s=40.0)
    stuck = model.evaluate(model.vector({"S": 0.0, "J": 0.0, "initial_residual_force": 0.0, "time_constant_s": 0.06,
                                         "dead_time_s": 0.0, "extra-lag:second_time_constant_s": 0.5,
                                         "travel-limit:lower": 51.9, "travel-limit:upper": 49.6}))
    polynomial = np.array([1.0, -1.0])
    signal, good = filter_residual(stuck.residual, stuck.counted > 0, polynomial, loop.starts)
    alone = autoregression(signal, good, 4, loop.starts, long=True)
    assert alone.size
    np.testing.assert_array_equal(noise_of(model, stuck, polynomial, 4), alone)


def test_s_moves_along_with_an_effect_that_has_a_share_in_the_thresholds() -> None:
    # With an overshoot the valve waits at a threshold of S - (K - 1) J: S alone is held to a hundredth of a per cent.
    setting = Setting(Plant(1.5, 10.0, 2.0), Controller(0.7, 10.0, scan_s=1.0), 4.0, 1.5, duration_s=1000.0,
                      setpoint_moves=((0.0, 3.0),), noise_sd=0.03, effects=(("slip-overshoot", {"overshoot": 1.7}),))
    loop = simulate(setting, seed=3).loop
    found = find_range(loop)
    model = Model(loop, Spec(effects=("slip-overshoot",)), s_max=found.s_max, period_s=found.period_median_s)
    true = {"S": 4.0, "J": 1.5, "initial_residual_force": 0.0, "time_constant_s": 10.0, "dead_time_s": 2.0,
            "slip-overshoot:overshoot": 1.7}
    top = descend_model(model, with_start(model, model.cube(model.vector(true)[:, None])), fixed=(0, 2)).points[0]
    # Off the truth by what the thresholds do not see, and everything else following.
    along = ridges(model, top)
    S, best = model.values(along)[0], float(model.costs(top[None])[0])
    lost = model.shared.rows * np.log(model.costs(along) / best)
    alone = plateaus(model, top)
    assert alone is not None
    low, high = alone.interval(float(model.shared.rows), 0.9)
    possible = S[lost < INTERVAL_THRESHOLD]
    assert np.ptp(possible) > 3.0 * (high - low) and possible.min() < 4.0 < possible.max()
    # Without such an effect S is the threshold itself.
    plain = Model(loop, Spec(), s_max=found.s_max, period_s=found.period_median_s)
    assert not len(ridges(plain, plain.cube(plain.vector(true)[:, None])[0]))


def test_plateaus_that_are_possible_count_with_both_ends() -> None:
    S = np.array([1.0, 1.099, 1.1, 1.9, 2.0, 2.01, 2.02, 3.0])
    cost = np.exp(np.array([9.0, 9.0, 0.0, 0.0, 9.0, 1.0, 9.0, 9.0]) / 100.0)
    found = Plateaus(S, cost, np.empty((0, 5)), np.empty(0))
    low, high = found.interval(100.0, 0.9)
    # A share of the likelihood leaves out the ends of a wide plateau and a narrow one that is nearly as good.
    assert 1.1 < low < high < 1.99
    assert found.possible_span(100.0, 3.8) == (1.1, 2.01) and found.possible_span(100.0, 0.5) == (1.1, 1.9)


def test_the_process_numbers_reach_as_far_as_their_profiles_allow(fitted) -> None:
    model, cube, cost = fitted
    best = model.evaluate(model.values(cube[[cost.argmin()]])[:, 0])
    found = intervals_of(model, cube, cost, float(cost.min()), best)
    rows = effective_rows(np.nan_to_num(best.innovation), model.weight)
    limit = cost.min() * np.exp(PROCESS_THRESHOLD / rows)
    truth = {"gain": 1.5, "time_constant_s": 10.0, "dead_time_s": 4.0}
    for name, at in (("time_constant_s", 3), ("dead_time_s", 4)):
        low, high = found[name]
        assert low <= truth[name] <= high
        # Everything else follows a number held a little inside its interval, and a little outside of it.
        middle, half = best.values[name], 0.5 * (high - low)
        for side in (-1.0, 1.0):
            for share, possible in ((0.7, True), (1.4, False)):
                values = np.array(list(best.values.values()))[:, None]
                values[at] = middle + side * share * half
                ends = descend_model(model, model.cube(values), fixed=(0, *model.forces, at))
                assert (ends.costs[0] <= limit) == possible, (name, side, share)
    low, high = found["gain"]
    assert low <= truth["gain"] <= high
    for side in (-1.0, 1.0):
        for share, possible in ((0.7, True), (1.4, False)):
            given = Model(model.loop, Spec(fixed={"gain": best.gain + side * share * 0.5 * (high - low)}),
                          s_max=model.s_max, period_s=model.period_s)
            ends = descend_model(given, given.cube(np.array(list(best.values.values()))[:, None]),
                                 fixed=(0, *model.forces))
            assert (ends.costs[0] <= limit) == possible, (side, share)


def test_a_number_that_is_given_and_a_valve_that_barely_moves_have_no_interval_of_their_own(fitted) -> None:
    model, cube, cost = fitted
    given = Model(model.loop, Spec(fixed={"gain": 1.5, "time_constant_s": 10.0}), s_max=model.s_max,
                  period_s=model.period_s)
    point = given.cube(model.values(cube[[cost.argmin()]]))
    own = smooth_intervals(given, point, given.costs(point), 2.0 * float(given.costs(point)[0]))
    assert set(own) == {"dead_time_s"}
    # The widest stickband and slip jump, and no residual force at the start: no command of this record reaches f_s.
    still = model.cube(model.values(point))
    still[:, :3] = 1.0, 1.0, 0.5
    assert np.ptp(model.positions(model.values(still))) == 0.0
    assert smooth_intervals(model, still, np.ones(1), 2.0) == {}


def test_the_longer_time_constant_comes_first_and_the_model_is_the_same(fitted) -> None:
    model, cube, cost = fitted
    two = Model(model.loop, Spec(effects=("extra-lag",)), s_max=model.s_max, period_s=model.period_s)
    values = np.array([*model.values(cube[[cost.argmin()]])[:, 0], 2.0])
    values[3], swapped = 7.0, values.copy()
    swapped[[3, 5]] = 2.0, 7.0
    both = two.cube(np.stack([values, swapped], axis=1))
    ordered = two.values(longest_first(two, both))
    assert ordered[:, 1] == pytest.approx(ordered[:, 0], rel=1e-9)
    assert ordered[[3, 5], 0] == pytest.approx([7.0, 2.0], rel=1e-9)
    assert two.costs(both)[0] == pytest.approx(two.costs(both)[1], rel=1e-6)
    assert longest_first(model, cube) is cube


def test_ends_that_the_slopes_put_elsewhere_are_where_the_cost_allows_them(fitted) -> None:
    model, cube, cost = fitted
    # Few rows: so much is possible that y no longer follows the numbers on straight lines.
    limit = 3.0 * float(cost.min())
    kept = cost <= limit
    rough = smooth_intervals(model, cube[kept], cost[kept], limit, rough=True)
    found = smooth_intervals(model, cube[kept], cost[kept], limit)
    best = model.values(cube[[cost.argmin()]])
    assert found["time_constant_s"] != pytest.approx(rough["time_constant_s"], rel=1e-4)
    for end in found["time_constant_s"]:
        # A tenth inside and a half outside, everything else descended to.
        for share, possible in ((0.9, True), (1.5, False)):
            values = best.copy()
            values[3] = best[3] + share * (end - best[3])
            ends = descend_model(model, model.cube(values), fixed=(0, *model.forces, 3))
            assert (ends.costs[0] <= limit) == possible, (end, share)
