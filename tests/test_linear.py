"""Process response, products, normal equations and filters against their reference versions."""

from __future__ import annotations

import threading
from dataclasses import replace

import naive
import numpy as np
import pytest

from stictionid.effects import get as get_effect
from stictionid.effects.contract import Context
from stictionid.fit.points.arx_cost import Arx
from stictionid.laws import get
from stictionid.laws.contract import neutral_friction
from stictionid.model.closed_loop import preset, simulate
from stictionid.model.model import Model, Spec
from stictionid.numerics import autoregression, cross_products, fold_solver, gauss_newton, jit, population, varpro
from stictionid.process import intersample, linear
from stictionid.record.loop import Loop


def staircase(samples: int = 40, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 50.0 + np.cumsum(rng.choice([0.0, 0.0, 1.0, -2.0, 3.0], samples))


@pytest.mark.parametrize(("T1", "T2", "dead", "integrating"), [
    (5.0, 0.0, 2.3, False), (3.0, 1.5, 0.0, False), (0.3, 0.0, 1.0, True), (2.0, 0.5, 4.7, True),
    (2.0, 2.0, 1.0, False),
])
def test_response_is_the_exact_one(T1: float, T2: float, dead: float, integrating: bool) -> None:
    position = staircase()
    dynamics = linear.Dynamics(np.array([T1]), np.array([dead]), np.array([T2]), integrating)
    ours = linear.free_run(position[:, None], dynamics, step_s=1.0)[:, 0]
    theirs = naive.response(position, T1, T2, dead, integrating, step=1.0)
    np.testing.assert_allclose(ours, theirs, atol=2e-5 * max(1.0, np.ptp(theirs)))


@pytest.mark.parametrize("integrating", [False, True])
def test_substeps_of_a_held_position_change_nothing(integrating: bool) -> None:
    position = staircase()[:, None].repeat(40, axis=1)
    rng = np.random.default_rng(1)
    dynamics = linear.Dynamics(rng.uniform(0.1, 9, 40), rng.uniform(0, 7, 40), rng.uniform(0, 3, 40), integrating)
    once = linear.free_run(position, dynamics, step_s=2.0)
    split = linear.free_run(position.repeat(5, axis=0), dynamics, step_s=2.0, substeps=5)
    np.testing.assert_allclose(split, once, rtol=1e-9, atol=1e-9)


def test_lanes_do_not_touch_each_other() -> None:
    position = staircase()[:, None] + np.arange(37.0)
    rng = np.random.default_rng(2)
    T, L = rng.uniform(0.5, 9, 37), rng.uniform(0, 20, 37)
    together = linear.free_run(position, linear.Dynamics(T, L, np.zeros(37), False), step_s=1.0)
    for p in (0, 17, 31, 32, 36):
        alone = linear.free_run(position[:, p:p + 1], linear.Dynamics(T[p:p + 1], L[p:p + 1], np.zeros(1), False),
                                 step_s=1.0)
        assert (together[:, p] == alone[:, 0]).all()


@pytest.mark.parametrize("integrating", [False, True])
@pytest.mark.parametrize("lagged", [False, True])
@pytest.mark.parametrize("parts", [1, 3, 8])
def test_one_path_for_all_is_the_same_path_for_each(integrating: bool, lagged: bool, parts: int) -> None:
    path = 50.0 + np.cumsum(np.random.default_rng(4).standard_normal((60 * parts, 1)), axis=0)
    rng = np.random.default_rng(5)
    T, L, T2 = rng.uniform(0.02, 9, 70), rng.uniform(0, 7, 70), rng.uniform(0, 5, 70) * lagged
    if lagged:
        T2[:3] = T[0], T[1] * (1.0 + 1e-5), 0.0
    one, each = (linear.free_run(position, linear.Dynamics(T, L, T2, integrating), step_s=1.0, substeps=parts,
                                  ahead=parts > 1) for position in (path, path.repeat(70, axis=1)))
    np.testing.assert_allclose(one, each, atol=1e-7)


def test_transient_is_an_exponential() -> None:
    out = np.empty((30, 3))
    linear.transient(np.array([0.001, 2.0, 50.0]), out, step_s=1.0)
    np.testing.assert_allclose(out[:, 1], np.exp(-np.arange(30) / 2.0), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(out[:, 2], np.exp(-np.arange(30) / 50.0), rtol=1e-12)
    assert (out[:, 0] == 0).all()


@pytest.mark.parametrize("own", [1, 2, 3, 4, 5])
def test_costs_are_those_of_plain_least_squares(own: int) -> None:
    rng = np.random.default_rng(own)
    rows, lanes = 53, 35
    base = rng.standard_normal((rows + 5, lanes))
    columns, target = rng.standard_normal((rows, 2)), rng.standard_normal(rows)
    weight = (rng.random(rows) > 0.2).astype(float)
    offsets = tuple(range(own, 0, -1))
    shared = varpro.Shared.prepare(target, columns, weight)
    costs, sizes = shared.solve(base, offsets)
    for p in range(lanes):
        cost, size = naive.least_squares([base[o:o + rows, p] for o in offsets], columns, target, weight)
        assert costs[p] == pytest.approx(cost, rel=1e-9)
        np.testing.assert_allclose(sizes[:, p], size, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_candidate_whose_first_size_has_the_wrong_sign_explains_nothing(sign: float) -> None:
    rng = np.random.default_rng(7)
    rows, offsets = 53, (2, 0)
    base, columns, target = (rng.standard_normal(shape) for shape in ((rows + 2, 20), (rows, 2), rows))
    free, bound = (varpro.Shared.prepare(target, columns, np.ones(rows), s) for s in (0.0, sign))
    costs, sizes = bound.solve(base, offsets)
    residuals, seen = bound.residuals(base, offsets), []
    alone, _ = naive.least_squares([], columns, target, np.ones(rows))
    for p, size in enumerate(free.solve(base, offsets)[1].T):
        wrong = sign * size[0] < 0.0
        seen.append(wrong)
        cost = alone if wrong else naive.least_squares([base[o:o + rows, p] for o in offsets], columns, target,
                                                       np.ones(rows))[0]
        assert costs[p] == pytest.approx(cost, rel=1e-9) == pytest.approx(float(residuals[:, p] @ residuals[:, p]))
        np.testing.assert_allclose(sizes[:, p], 0.0 if wrong else size, rtol=1e-9)
    assert 2 < sum(seen) < 18


@pytest.mark.parametrize("own", [1, 3])
def test_a_fold_weighs_its_candidates_by_their_likelihood(own: int) -> None:
    rng = np.random.default_rng(own)
    rows = 80
    true = rng.standard_normal((own, rows, 1))
    candidates = true + 0.05 * rng.standard_normal((own, rows, 9)) * np.linspace(0.0, 1.0, 9)
    shared = np.column_stack([np.ones(rows), rng.standard_normal(rows)])
    target = true[:, :, 0].sum(axis=0) + shared @ [2.0, -1.0] + 0.3 * rng.standard_normal(rows)
    train = (np.arange(rows) < 20) | (np.arange(rows) > 40)
    told = fold_solver.mean_of_fold(candidates, shared, target, train, None)
    # Candidates below a thousandth of the best one's likelihood are left out.
    np.testing.assert_allclose(told, naive.fold_mean(candidates, shared, target, train), atol=2e-4)
    p, sizes, tail = fold_solver.best_of_fold(candidates, shared, target, train, None)
    assert np.abs(told - candidates[:, :, p].T @ sizes - shared @ tail).max() > 5e-3, "one alone answers otherwise"


@pytest.mark.parametrize("columns", [0, 1, 2, 5])
def test_products_are_plain_sums_over_the_rows_that_count(columns: int) -> None:
    rng = np.random.default_rng(columns)
    base, right = rng.standard_normal((90, 37)), rng.standard_normal((60, columns + columns % 2))
    counts = rng.random(60) > 0.15
    offsets = (20, 0, 7)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], counts, [0]])))
    squares, cross = cross_products.products(base, offsets, right, edges[::2].copy(), edges[1::2].copy())
    own = [base[o:o + 60][counts] for o in offsets]
    for i in range(3):
        for j in range(3):
            if columns:
                np.testing.assert_allclose(squares[i, j], (own[i] * own[j]).sum(axis=0), atol=1e-12)
        np.testing.assert_allclose(cross[i], right[counts].T @ own[i], atol=1e-12)


@pytest.mark.parametrize("constant", [False, True])
@pytest.mark.parametrize("delays", [(5,), (0, 1, 4, 9)])
def test_arx_costs_of_many_delays_are_those_of_each_by_least_squares(constant: bool, delays: tuple[int, ...]) -> None:
    loop = simulate(preset("foptd")).loop
    model = Model(loop, Spec(), s_max=5.0, period_s=50.0)
    arx = Arx(model, 2, delays, constant=constant)
    values = model.values(np.random.default_rng(0).random((19, 5)) * [0.5, 1.0, 1.0, 1.0, 1.0])  # all of them move
    values[2] = 0.0
    costs, chosen = arx.costs(values)
    for p in range(0, 19, 6):
        each = [naive.arx_cost(loop.output, loop.process_value, values[0, p], values[1, p], 2, d, arx.first,
                               constant=constant) * (loop.samples - arx.first) for d in delays]
        assert costs[p] == pytest.approx(min(each), rel=1e-8)
        assert chosen[p] == delays[int(np.argmin(each))]


def test_gaps_take_the_rows_of_an_arx_model_that_they_touch() -> None:
    loop = simulate(preset("foptd"), seed=1).loop
    used = np.ones(loop.samples, bool)
    used[300:320] = False
    model = Model(replace(loop, used=used), Spec(), s_max=5.0, period_s=50.0)
    arx = Arx(model, 2, (5,))
    values = model.values(np.random.default_rng(0).random((3, 5)))
    v = model.positions(values)
    rows = np.array([k for k in range(arx.first, loop.samples) if used[k - 2:k + 1].all()])
    y = loop.process_value
    for p in range(3):
        design = np.column_stack([y[rows - 1], y[rows - 2], v[rows - 6, p], v[rows - 7, p], np.ones(rows.size)])
        theta, *_ = np.linalg.lstsq(design, y[rows], rcond=None)
        assert arx.costs(values)[0][p] == pytest.approx(np.sum((y[rows] - design @ theta) ** 2), rel=1e-7)


@pytest.mark.parametrize("piece", [90, 50_000])
def test_the_irreducible_noise_is_what_a_free_model_leaves(piece: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(autoregression, "PIECE", piece)
    rng = np.random.default_rng(5)
    y, v, good, delay = rng.standard_normal(500), staircase(500), rng.random(500) > 0.01, 3
    rows = np.array([k for k in range(24, 500) if good[k - 20:k + 1].all()])
    design = np.stack([y[rows - lag] for lag in range(1, 21)] + [v[rows - delay - lag] for lag in range(1, 21)]
                      + [np.ones(rows.size)], axis=1)
    theta, *_ = np.linalg.lstsq(design, y[rows], rcond=None)
    left = np.sqrt(np.sum((y[rows] - design @ theta) ** 2) / (rows.size - 41))
    assert autoregression.irreducible_error(y, v, good, delay) == pytest.approx(left, rel=1e-9)


@pytest.mark.parametrize(("d", "narrow", "last", "rounds"), [(1, 1.0, 0.97, 12), (3, 1.0, 0.97, 20),
                                                              (4, 1e-5, 0.6, 75)])
def test_a_polish_is_the_written_one(d: int, narrow: float, last: float, rounds: int) -> None:
    """Points are drawn along the axes of the population, so that their distance in its metric is that of the draws.

    The population moves as the plain twin says; where most of its points are rejected, its step shrinks. Distances of
    points at the edge of the range are smaller. In the last case one axis of the valley is 1e-5 of others.
    """
    lam, seen = 12, list[np.ndarray]()
    sizes, spread = np.geomspace(1.0, narrow, d), np.linspace(0.2, 0.1, d)
    turned = np.linalg.qr(np.random.default_rng(d).standard_normal((d, d)))[0]

    def cost(points: np.ndarray) -> np.ndarray:
        seen.append(points.copy())
        found = np.sum(((points - 0.4) @ turned / sizes) ** 2, axis=1)
        found[(points > 0.93).any(axis=1)] = np.inf
        return found

    starts = np.array([np.full(d, 0.5), np.full(d, 0.05), np.full(d, last)])
    population.refine(cost, starts, np.random.default_rng(3), spread=spread, population=lam, rounds=rounds)
    rng, (w, constants) = np.random.default_rng(3), naive.hansen(lam, d)
    states = [(s / spread, 1.0, np.eye(d), np.zeros(d), np.zeros(d)) for s in starts]
    checked = edges = shrunk = 0
    for turn, points in enumerate(seen[1:]):
        assert points.shape == (len(starts) * lam, d) and (points >= 0.0).all() and (points <= 1.0 + 1e-15).all()
        draws = rng.standard_normal((len(starts), lam, d))
        costs = np.sum(((points - 0.4) @ turned / sizes) ** 2, axis=1)
        costs[(points > 0.93).any(axis=1)] = np.inf
        for k, (mean, sigma, cov, path_s, path_c) in enumerate(states):
            mine = slice(k * lam, (k + 1) * lam)
            steps = (points[mine] / spread - mean) / sigma
            inside = ((points[mine] > 1e-9) & (points[mine] < 1.0 - 1e-9)).all(axis=1)
            length = np.einsum("mi,ij,mj->m", steps, np.linalg.inv(cov), steps)
            np.testing.assert_allclose(length[inside], np.sum(draws[k] ** 2, axis=1)[inside], rtol=1e-5)
            checked, edges = checked + inside.sum(), edges + (~inside).sum()
            best = np.argsort(costs[mine], kind="stable")[:lam // 2]
            if np.isfinite(costs[mine][best]).all():
                states[k] = naive.adapted(mean, sigma, cov, path_s, path_c, steps[best], w, constants, turn,
                                          1.0 / spread)
            else:
                states[k], shrunk = (mean, 0.7 * sigma, cov, path_s, path_c), shrunk + 1
    assert len(seen) == rounds + 1 and checked > lam * rounds and edges
    assert shrunk


def test_products_of_slopes_are_those_of_the_slopes() -> None:
    def residuals(points: np.ndarray) -> np.ndarray:
        r = np.stack([np.sin(points @ [1.0, 2.0, 3.0] + k) for k in range(20)])
        r[3, 0] = np.inf
        return r

    points, free = np.array([[0.2, 0.5, 0.0], [1.0, 0.4, 0.3]]), np.array([0, 2])
    step = np.full((2, 2), 1e-3)
    slopes, now = gauss_newton.slopes_at(residuals, points, free, step)
    normals, gradients = gauss_newton.normals_at(residuals, points, free, step)
    for g in range(2):
        np.testing.assert_allclose(normals[g], slopes[g].T @ slopes[g], rtol=1e-10)
        np.testing.assert_allclose(gradients[g], slopes[g].T @ now[g], rtol=1e-10)
    moves = gauss_newton.damped_moves(normals, gradients)
    each = [gauss_newton.damped_moves(n, g) for n, g in zip(normals, gradients, strict=True)]
    np.testing.assert_allclose(moves, each, rtol=1e-9)
    longest = np.linalg.solve(normals[0] + 1e-6 * np.diag(np.diag(normals[0])), -gradients[0])
    np.testing.assert_allclose(moves[0, 0], longest, rtol=1e-9)


def test_a_slope_beside_a_step_is_that_of_its_own_side() -> None:
    grid = np.linspace(0.0, 1.0, 50)[:, None]

    def residuals(points: np.ndarray) -> np.ndarray:
        x, z = points.T
        return np.sin(grid + 2.0 * x + 3.0 * z) + 0.5 * (x > 0.4) + 0.7 * (z < 0.2) * grid

    # x is just below a step, z just above one; in the last point x is at its bound.
    points, step = np.array([[0.3999, 0.5], [0.7, 0.2001], [0.6, 0.6], [1.0, 0.6]]), np.full((4, 2), 1e-3)
    slopes, now = gauss_newton.slopes_at(residuals, points, np.array([0, 1]), step)
    for point, slope, r in zip(points, slopes, now, strict=True):
        exact = np.cos(grid + 2.0 * point[0] + 3.0 * point[1]) * np.array([2.0, 3.0])
        np.testing.assert_allclose(slope, exact, atol=6e-3)
        np.testing.assert_array_equal(r, residuals(point[None])[:, 0])


def test_costs_do_not_depend_on_who_is_evaluated_together() -> None:
    model = Model(simulate(preset("foptd")).loop, Spec(), s_max=5.0, period_s=50.0)
    cube = np.random.default_rng(2).random((75, 5))
    together, residuals = model.costs(cube), model.residuals(cube)
    assert together.tolist() == [float(model.costs(cube[p:p + 1])[0]) for p in range(75)]
    np.testing.assert_array_equal(residuals[:, 70:], model.residuals(cube[70:]))


def test_what_is_lent_lives_until_the_next_call_and_the_rest_is_kept() -> None:
    first = jit.scratch("test", 3, 4)
    first[:] = 1.0
    again = jit.scratch("test", 2, 2)
    again[:] = 2.0
    assert first[0, 0] == 2.0
    assert jit.scratch("other", 3, 4).base is not first.base
    seen = []
    thread = threading.Thread(target=lambda: seen.append(jit.scratch("test", 3, 4)))
    thread.start()
    thread.join()
    assert not np.shares_memory(seen[0], first)
    model = Model(simulate(preset("foptd")).loop, Spec(), s_max=5.0, period_s=50.0)
    values = model.values(np.random.default_rng(0).random((40, 5)))
    kept = model.positions(values)
    before = kept.copy()
    model.costs_of(values[:, ::-1])
    np.testing.assert_array_equal(kept, before)


def test_a_valve_that_never_moves_is_rejected_and_a_dead_transient_is_not() -> None:
    rng = np.random.default_rng(0)
    rows = 60
    target = rng.standard_normal(rows)
    base = np.zeros((2 * rows, 2))
    base[:rows, 0] = rng.standard_normal(rows)
    base[:rows, 1] = 3.0
    shared = varpro.Shared.prepare(target, np.ones((rows, 1)), np.ones(rows))
    costs = shared.costs(base, (0, rows))
    assert np.isfinite(costs[0]) and np.isinf(costs[1])


def test_whitening_is_the_written_filter() -> None:
    rng = np.random.default_rng(0)
    x, taps = rng.standard_normal((40, 3)), np.array([-0.7, 0.2])
    np.testing.assert_allclose(varpro.whiten(x, taps), naive.filtered(x, taps), rtol=1e-12)
    stacked = np.concatenate([x, 2 * x])
    varpro.whiten_stack(stacked, 40, taps)
    once = naive.filtered(x, taps)
    np.testing.assert_allclose(stacked, np.concatenate([once, 2 * once]), rtol=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_softened_differences_are_the_written_filter(share: float) -> None:
    # A recursion does the work of so many taps; the rows before the first one count as 0 in each stretch.
    x = np.random.default_rng(0).standard_normal((60, 9)).cumsum(axis=0)
    taps = np.convolve([1.0, -share], 0.8 ** np.arange(15))[1:]
    stacked = np.concatenate([x, 2 * x])
    varpro.whiten_stack(stacked, 60, taps)
    once = naive.filtered(x, taps)
    np.testing.assert_allclose(stacked, np.concatenate([once, 2 * once]), rtol=1e-10, atol=1e-11)
    # Another last tap is no such filter.
    other = np.append(taps[:-1], taps[-1] + 0.1)
    again = x.copy()
    varpro.whiten_stack(again, 60, other)
    np.testing.assert_allclose(again, naive.filtered(x, other), rtol=1e-10, atol=1e-11)



def test_rebuilt_command_meets_the_samples_and_finds_the_corner() -> None:
    t = np.arange(60.0)
    command = np.where(t < 30.4, 0.1 * t, 0.1 * 30.4 - 0.3 * (t - 30.4))
    fine = intersample.rebuild(command, 10, "corner")
    np.testing.assert_allclose(fine[::10], command, atol=1e-12)
    assert fine.max() == pytest.approx(3.04, abs=1e-9)
    assert (intersample.rebuild(command, 4, "hold") == np.repeat(command, 4)).all()


@pytest.mark.parametrize("parts", [2, 3, 4, 7])
def test_a_rebuilt_command_turns_at_its_extreme_value_on_any_grid(parts: int) -> None:
    """A valve reverses there: the point next to the corner has the value that lies between two points."""
    t, corner = np.arange(60.0), 30.4
    since = t - corner
    for before, after, bend in ((0.1, -0.3, 0.002), (-0.2, 0.25, -0.003), (np.sqrt(0.02), -0.1, 0.0)):
        command = 50.0 + np.where(since < 0.0, before * since + bend * since**2, after * since - bend * since**2)
        fine = intersample.rebuild(command, parts, "corner")
        extreme = fine.argmax() if before > 0.0 else fine.argmin()
        assert fine[extreme] == pytest.approx(50.0, abs=1e-9)
        assert extreme == 30 * parts + round(0.4 * parts)
        np.testing.assert_allclose(np.delete(fine[::parts], 30), np.delete(command, 30), atol=1e-12)
        # (at scans it holds between the points, and reaches no peak there)
        scans = intersample.rebuild(command, parts, "corner", peaks=False)
        assert np.ptp(scans - fine) == pytest.approx(abs(scans[extreme] - 50.0)) and (np.abs(scans - 50.0).min() > 1e-3)
    # A corner at which the command goes on, only slower, changes no point of the grid.
    command = np.where(since < 0.0, np.sqrt(0.1), 0.1) * since
    exact = np.arange(60.0 * parts) / parts - corner
    np.testing.assert_allclose(intersample.rebuild(command, parts, "corner")[:-parts],
                               (np.where(exact < 0.0, np.sqrt(0.1), 0.1) * exact)[:-parts], atol=1e-12)


@pytest.mark.parametrize("parts", [2, 4, 8])
def test_few_parts_of_a_sample_do_for_a_command_that_moves(parts: int) -> None:
    """The true model left 0.053, 0.021 and 0.010 % where the valve reversed at points of the grid."""
    setting = replace(preset("foptd"), fine_step_s=0.002, duration_s=300.0)
    model = Model(simulate(setting).loop, Spec(between="corner", substeps=parts), s_max=10.0, period_s=60.0)
    exact = model.vector({"S": 5.0, "J": 3.0, "initial_residual_force": 0.125, "time_constant_s": 5.0,
                          "dead_time_s": 5.0})
    assert model.evaluate(exact).rmse < 0.0025


def test_a_setpoint_move_kicks_the_rebuilt_command_and_is_no_corner() -> None:
    """A PI controller's output jumps by its gain where the setpoint moves: the valve turns there, between samples."""
    t = np.arange(0.0, 60.0, 0.1)
    setpoint = np.where(t < 20.0, 50.0, np.where(t < 41.0, 53.0, 48.0))
    smooth = 50.0 + 2.0 * np.sin(2.0 * np.pi * t / 35.0) + 0.02 * np.cumsum(setpoint - 50.0) * 0.1
    command = smooth + 0.15 * setpoint
    fine = intersample.rebuild(command[::10], 10, "corner", setpoint[::10])
    np.testing.assert_allclose(fine[::10], command[::10], atol=1e-12)
    before, after = (np.abs(x[20:-20] - command[20:-20]).max()
                     for x in (intersample.rebuild(command[::10], 10, "corner"), fine))
    # What is left is the last tenth before the kick, at which the output already is where the kick begins.
    assert after < 0.1 * 0.4 < 0.3 < before
    # A setpoint that always moves comes from another controller and kicks nothing.
    ramp = 50.0 + 0.1 * t
    plain = intersample.rebuild(command[::10], 10, "corner")
    assert (intersample.rebuild(command[::10], 10, "corner", ramp[::10]) == plain).all()


# (with S = 2 and J = 1 the command's peak is f_s itself, a tie)
@pytest.mark.parametrize(("S", "J"), [(5.0, 3.0), (4.6, 3.0), (2.1, 1.0), (1.9, 1.0), (0.0, 0.0)])
def test_a_valve_moves_by_a_kick_at_its_instant(S: float, J: float) -> None:
    """It breaks away in the kick, just before it, or slides: a tank keeps what the stem is early by for good."""
    within = 1000
    t = np.arange(0.0, 40.0, 1.0 / within)
    setpoint = np.where(t < 20.0, 50.0, 46.0)
    command = 50.0 + np.where(t < 15.0, 0.1 * t, 1.5 - 0.75 * (t - 15.0)) + 0.15 * (setpoint - 50.0)
    fine = get("chen").positions(command, neutral_friction([S], [J]))[:, 0]
    loop = Loop(output=command[::within], process_value=t[::within], setpoint=setpoint[::within], step_s=1.0)
    model = Model(loop, Spec(process="integrator", between="corner", substeps=5, friction_free=not S), s_max=9.0,
                  period_s=40.0)
    valve = {"S": S, "J": J, "initial_residual_force": 0.0, "time_constant_s": 1.0, "dead_time_s": 1.0}
    stem = model.positions(model.vector(valve)[:, None])[:, 0]
    beside = range(95, 115)
    exact = np.array([fine[(j - 1) * within // 5:j * within // 5].mean() for j in beside])
    assert abs(float(np.sum(stem[beside] - exact))) / 5.0 < 0.01
    assert np.ptp(exact) > 1.0


def test_a_kick_between_samples_comes_when_the_slope_tells() -> None:
    """The integral part works from the kick on, so that a kick which came early stands higher at its sample."""
    t = np.arange(0.0, 200.0, 0.1)
    setpoint = np.where(t < 20.3, 50.0, np.where(t < 61.0, 53.0, np.where(t < 120.5, 48.0, 51.0)))
    error = setpoint - (50.0 + 2.0 * np.sin(2.0 * np.pi * t / 70.0))
    command = 50.0 + 0.5 * error + 0.02 * np.cumsum(error)
    jumps, late = intersample.kicks(command[::10], setpoint[::10])
    at = np.flatnonzero(jumps)
    np.testing.assert_array_equal(at, [21, 61, 121])
    np.testing.assert_allclose(jumps[at], 0.52 * np.array([3.0, -5.0, 3.0]), rtol=0.02)
    np.testing.assert_allclose(late[at], [0.3, 1.0, 0.5], atol=0.05)
    assert (late[np.setdiff1d(np.arange(200), at)] == 1.0).all()
    rows, share = intersample.kick_rows(command[::10], 10, setpoint[::10])
    np.testing.assert_allclose((rows - 1 + share) / 10.0, [20.3, 61.0, 120.5], atol=0.05)
    # What is left is the part of the kick, of which the share tells.
    fine = intersample.rebuild(command[::10], 10, "corner", setpoint[::10])
    beside = np.setdiff1d(np.arange(20, t.size - 20), np.concatenate([rows - 1, rows]))
    before, after = (np.abs(x - command)[beside].max()
                     for x in (intersample.rebuild(command[::10], 10, "corner"), fine))
    assert after < 0.05 < 0.9 < before
    # Without an integral part nothing tells, and a kick comes at its sample.
    late = intersample.kicks((0.5 * error)[::10], setpoint[::10])[1]
    assert (late == 1.0).all()


def test_behind_a_kick_the_rebuilt_command_does_not_go_its_old_pace() -> None:
    """A valve that slides in the kick would stick again at that pace: the corner came with the kick, at its sample."""
    t = np.arange(0.0, 60.0, 0.1)
    after = np.maximum(t - 20.0, 0.0)
    setpoint = np.where(after > 0.0, 46.4, 50.0)
    setpoint[200] = 46.4
    # The pace is 0.06 % / s before the kick and 0.2 to 0.3 behind it, where it soon grows no more.
    bend = 0.02 * np.clip(after, 0.0, 1.0) ** 2 + 0.04 * np.maximum(after - 1.0, 0.0)
    command = 50.0 - 0.06 * t - 0.2 * after - bend + 0.5 * (setpoint - 50.0)
    fine = intersample.rebuild(command[::10], 10, "corner", setpoint[::10])
    np.testing.assert_allclose(np.diff(fine[200:220]), np.diff(command[200:220]), atol=0.003)


def test_interval_means_place_the_break_away_inside_the_part() -> None:
    command = 50.0 + 0.3 * np.arange(40.0)
    table = neutral_friction([2.0], [1.0])
    position = get("chen").positions(command, table)
    expected = naive.interval_means(command, 1.5, position[:, 0])
    intersample.interval_means(command, table, np.zeros(command.size), position)
    means = position[:, 0]
    np.testing.assert_allclose(means, expected, atol=1e-12)
    # Fine enough, the mean is what a thousand times finer grid gives.
    fine = 50.0 + 0.3 * np.arange(0, 39, 0.001)
    slow = get("chen").positions(fine, table)[:, 0]
    exact = np.concatenate([[50.0], slow[1:].reshape(-1, 1000)[:38].mean(axis=1)]) if slow.size % 1000 == 1 else None
    if exact is not None:
        np.testing.assert_allclose(means[:exact.size], exact, atol=2e-3)


def test_a_stroke_begins_and_meets_its_place_within_a_part_of_a_sample() -> None:
    """A stem that never catches up keeps what a part is wrong by: taken for steps, that added up in an integrator."""
    parts, within = 200, 500
    t = np.arange(parts * within + 1) / within
    # A place that slips up at 10.3, slides on, turns back to and fro past a stem that is slower, and rests in the end.
    place = np.where(t < 10.3, 0.0, 3.0 + 0.2 * (t - 10.3))
    place = np.where(t < 30.0, place, 3.0 + 0.2 * 19.7 - 1.1 * (t - 30.0))
    place = np.where(t < 40.0, place, place[40 * within] + 1.3 * np.abs((t - 40.0 + 7.6) % 15.2 - 7.6))
    place = np.where(t < 150.0, place, np.where(t < 170.7, place[150 * within], -8.0))
    fast = np.concatenate([place[:1], place[1:].reshape(parts, within).mean(axis=1)])
    rates = np.array([[0.15, 0.4, 0.9, 2.0, 1e9]])
    context = Context(fast, fast, None, 1.0, 50.0, 5.0, {}, None, None, None, False)
    effect = get_effect("slew-limit")
    stem = effect.transformed(np.repeat(fast[:, None], rates.size, axis=1), rates, context)
    fine = np.repeat(place[:, None], rates.size, axis=1)
    exact = np.empty_like(fine)
    effect.run(fine, fine, rates, 1.0 / within, fine[:1].copy(), exact)
    exact = np.concatenate([exact[:1], exact[1:].reshape(parts, within, -1).mean(axis=1)])
    np.testing.assert_allclose(stem[:, -1], fast, atol=1e-6)  # as fast as any place: the effect is not there
    steps = np.empty_like(stem)
    effect.run(np.repeat(fast[:, None], rates.size, axis=1), stem, rates, 1.0, np.zeros((1, rates.size)), steps)
    error, before = (np.abs(np.cumsum(x - exact, axis=0))[:, :-1].max(axis=0) for x in (stem, steps))
    assert (error < 0.01 * before).all()


def test_a_start_up_transient_long_gone_does_not_make_a_cost_of_nothing() -> None:
    """Where rows don't count the transient is still 1; 1e-16 of rounding there outweighed what it is where they do."""
    n, first = 1000, 21
    good = np.arange(n) >= first
    rng = np.random.default_rng(3)
    target = rng.normal(size=n)
    shared = varpro.Shared.prepare(target, np.stack([np.ones(n), np.arange(n) / n], axis=1), good)
    assert not shared.basis[~good].any()
    base = np.empty((2 * n, 1))
    base[:n, 0] = 1000.0 + np.cumsum(rng.normal(size=n))
    linear.transient(np.array([0.637]), base[n:], step_s=1.0)
    base[n + first, 0] = 4e-15
    base[n + first + 1:, 0] = 0.0
    # It fits the first row, and nothing else.
    design = np.stack([base[:n, 0], np.ones(n), np.arange(n) / n], axis=1)[good][1:]
    expected = np.linalg.lstsq(design, target[good][1:], rcond=None)[1][0]
    assert shared.costs(base, (0, n))[0] == pytest.approx(expected, rel=1e-6)
