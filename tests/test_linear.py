"""Process response, products, normal equations and filters against their slow obvious twins."""

from __future__ import annotations

import naive
import numpy as np
import pytest

from stictionid import between, process, regression
from stictionid.laws import get
from stictionid.laws.contract import neutral_friction


def staircase(samples: int = 40, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 50.0 + np.cumsum(rng.choice([0.0, 0.0, 1.0, -2.0, 3.0], samples))


@pytest.mark.parametrize(("T1", "T2", "dead", "integrating"), [
    (5.0, 0.0, 2.3, False), (3.0, 1.5, 0.0, False), (0.3, 0.0, 1.0, True), (2.0, 0.5, 4.7, True),
    (2.0, 2.0, 1.0, False),
])
def test_response_is_the_exact_one(T1: float, T2: float, dead: float, integrating: bool) -> None:
    position = staircase()
    dynamics = process.Dynamics(np.array([T1]), np.array([dead]), np.array([T2]), integrating)
    ours = process.free_run(position[:, None], dynamics, step_s=1.0)[:, 0]
    theirs = naive.response(position, T1, T2, dead, integrating, step=1.0)
    np.testing.assert_allclose(ours, theirs, atol=2e-5 * max(1.0, np.ptp(theirs)))


@pytest.mark.parametrize("integrating", [False, True])
def test_substeps_of_a_held_position_change_nothing(integrating: bool) -> None:
    position = staircase()[:, None].repeat(40, axis=1)
    rng = np.random.default_rng(1)
    dynamics = process.Dynamics(rng.uniform(0.1, 9, 40), rng.uniform(0, 7, 40), rng.uniform(0, 3, 40), integrating)
    once = process.free_run(position, dynamics, step_s=2.0)
    split = process.free_run(position.repeat(5, axis=0), dynamics, step_s=2.0, substeps=5)
    np.testing.assert_allclose(split, once, rtol=1e-9, atol=1e-9)


def test_lanes_do_not_touch_each_other() -> None:
    position = staircase()[:, None] + np.arange(37.0)
    rng = np.random.default_rng(2)
    T, L = rng.uniform(0.5, 9, 37), rng.uniform(0, 20, 37)
    together = process.free_run(position, process.Dynamics(T, L, np.zeros(37), False), step_s=1.0)
    for p in (0, 17, 31, 32, 36):
        alone = process.free_run(position[:, p:p + 1], process.Dynamics(T[p:p + 1], L[p:p + 1], np.zeros(1), False),
                                 step_s=1.0)
        assert (together[:, p] == alone[:, 0]).all()


def test_transient_is_an_exponential() -> None:
    out = np.empty((30, 3))
    process.transient(np.array([0.001, 2.0, 50.0]), out, step_s=1.0)
    np.testing.assert_allclose(out[:, 1], np.exp(-np.arange(30) / 2.0), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(out[:, 2], np.exp(-np.arange(30) / 50.0), rtol=1e-12)
    assert (out[:, 0] == 0).all()


@pytest.mark.parametrize("own", [1, 2, 3])
def test_costs_are_those_of_plain_least_squares(own: int) -> None:
    rng = np.random.default_rng(own)
    rows, lanes = 53, 35
    base = rng.standard_normal((rows + 4, lanes))
    columns, target = rng.standard_normal((rows, 2)), rng.standard_normal(rows)
    weight = (rng.random(rows) > 0.2).astype(float)
    offsets = tuple(range(own, 0, -1))
    shared = regression.Shared.prepare(target, columns, weight)
    costs, sizes = shared.solve(base, offsets)
    for p in range(lanes):
        cost, size = naive.least_squares([base[o:o + rows, p] for o in offsets], columns, target, weight)
        assert costs[p] == pytest.approx(cost, rel=1e-9)
        np.testing.assert_allclose(sizes[:, p], size, rtol=1e-7, atol=1e-9)


def test_a_valve_that_never_moves_is_rejected_and_a_dead_transient_is_not() -> None:
    rng = np.random.default_rng(0)
    rows = 60
    target = rng.standard_normal(rows)
    base = np.zeros((2 * rows, 2))
    base[:rows, 0] = rng.standard_normal(rows)
    base[:rows, 1] = 3.0
    shared = regression.Shared.prepare(target, np.ones((rows, 1)), np.ones(rows))
    costs = shared.costs(base, (0, rows))
    assert np.isfinite(costs[0]) and np.isinf(costs[1])


def test_whitening_is_the_written_filter() -> None:
    rng = np.random.default_rng(0)
    x, taps = rng.standard_normal((40, 3)), np.array([-0.7, 0.2])
    np.testing.assert_allclose(regression.whiten(x, taps), naive.filtered(x, taps), rtol=1e-12)
    stacked = np.concatenate([x, 2 * x])
    regression.whiten_stack(stacked, 40, taps)
    once = naive.filtered(x, taps)
    np.testing.assert_allclose(stacked, np.concatenate([once, 2 * once]), rtol=1e-12)


def test_rebuilt_command_meets_the_samples_and_finds_the_corner() -> None:
    t = np.arange(60.0)
    command = np.where(t < 30.4, 0.1 * t, 0.1 * 30.4 - 0.3 * (t - 30.4))
    fine = between.rebuild(command, 10, "corner")
    np.testing.assert_allclose(fine[::10], command, atol=1e-12)
    assert fine.max() == pytest.approx(3.04, abs=1e-9)
    assert (between.rebuild(command, 4, "hold") == np.repeat(command, 4)).all()


def test_interval_means_place_the_break_away_inside_the_part() -> None:
    command = 50.0 + 0.3 * np.arange(40.0)
    table = neutral_friction([2.0], [1.0])
    position = get("chen").positions(command, table)
    means = between.interval_means(command, table, np.zeros(command.size), position)[:, 0]
    expected = naive.interval_means(command, 1.5, position[:, 0])
    np.testing.assert_allclose(means, expected, atol=1e-12)
    # Fine enough, the mean is what a thousand times finer grid gives.
    fine = 50.0 + 0.3 * np.arange(0, 39, 0.001)
    slow = get("chen").positions(fine, table)[:, 0]
    exact = np.concatenate([[50.0], slow[1:].reshape(-1, 1000)[:38].mean(axis=1)]) if slow.size % 1000 == 1 else None
    if exact is not None:
        np.testing.assert_allclose(means[:exact.size], exact, atol=2e-3)
