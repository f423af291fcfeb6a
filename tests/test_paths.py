"""Paths of slips: the kernels beside their slow twins, and valves whose break-away force scatters found again."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import naive
import numpy as np
import pytest
from real_nodes import model_on, recorded, true_values
from scipy.signal import lfilter
from scipy.stats import norm
from scipy.stats import t as student

from stictionid.fit.cross_validation import held_out_of
from stictionid.fit.intervals.along_path import finish_along
from stictionid.fit.noise import completion
from stictionid.fit.noise.completion import complete_quickly, place_slips
from stictionid.fit.with_effect import look_along
from stictionid.laws import get
from stictionid.laws.contract import (
    FD_DRIFT,
    FS_DOWN,
    FS_DRIFT,
    FS_UP,
    LOWER,
    OVERSHOOT,
    RESTICK,
    UPPER,
    friction_table,
)
from stictionid.model import response
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.replay import by_law, doubts, replay_slips
from stictionid.model.segments import bind_model, rebind_model
from stictionid.model.slips import Paths, Slips, paths_from
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, SOFT, Spec
from stictionid.numerics.noise.landing import LandingFilter
from stictionid.numerics.noise.normal import log_between, log_upper, moments_between
from stictionid.paths.beam import beam
from stictionid.paths.command_error import error_range, likely_errors
from stictionid.paths.likelihood import deviance, forces, law_paths, likeliest_slips, log_prior
from stictionid.paths.settle import (
    _with_scatter,
    covariance,
    first_path,
    score_path,
    settle_beside,
    settle_path,
    width_of_forces,
)
from stictionid.process.intersample import CORNER
from stictionid.process.scan import DECIMATED
from stictionid.process.state_space import Held
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range


def wandering(seed, samples=400, step=0.6):
    rng = np.random.default_rng(seed)
    return 50.0 + np.cumsum(step * rng.standard_normal(samples))


CHANGES = {
    "plain": {}, "asymmetric": {FS_UP: 0.8, FS_DOWN: -0.7}, "overshoot": {OVERSHOOT: 0.4},
    "stops": {UPPER: 1.0, LOWER: 1.0}, "drift": {FS_DRIFT: 0.01, FD_DRIFT: 0.004}, "restick": {RESTICK: 0.3},
}


@pytest.mark.parametrize("name", ["chen", "kano", "he", "he-wang"])
@pytest.mark.parametrize("change", CHANGES)
def test_slips_by_the_law_give_the_positions_of_the_law(name, change):
    law = get(name)
    if change == "restick" and name in ("he", "he-wang"):
        pytest.skip("a valve that rests at once has no speed from which it does")
    if change == "drift" and name == "kano":
        pytest.skip("Kano's form remembers the force at which it stopped; a path takes the force at the slip")
    for seed in range(5):
        u = wandering(seed)
        table = law.searched_friction(np.array([4.0]), np.array([1.5]))
        for row, more in CHANGES[change].items():
            table[row] = {UPPER: 51.0, LOWER: 47.0}.get(row, table[row] + more)
        profile, share = np.linspace(0.0, 100.0, u.size), np.array([0.3])
        slips = by_law(law, u, table, profile, share)
        assert slips.count > 1
        along = replay_slips(law, u, table, profile, share, slips).position
        np.testing.assert_array_equal(along, law.positions(u, table, profile=profile, share=share))


def events_of(slips, samples):
    at, kind = (np.array([event[i] for event in slips], dtype=np.int64) for i in (0, 1))
    return Slips(at, kind, samples, samples)


@pytest.mark.parametrize("rests", [False, True])
@pytest.mark.parametrize("error", [0.0, 0.2])
def test_a_replayed_path_has_the_positions_and_the_chance_of_its_slow_twin(rests, error):
    law = get("he" if rests else "chen")
    u = wandering(3, 9, 1.2)
    table = friction_table(np.array([2.0]), np.array([1.0]))
    found = naive.paths(u, 2.0, 1.0, 0.4, error, rests)
    assert len(found) > 20
    for events, places, chance in found:
        if chance < -25.0:
            continue  # (the twin subtracts chances, and has no digits left there)
        got = replay_slips(law, u, table, np.zeros(u.size), np.zeros(1), events_of(events, u.size),
                           doubt=doubts(u, error))
        np.testing.assert_allclose(got.position[:, 0], places, rtol=0, atol=1e-12)
        m, total = got.forces.margins[:, :, 0] / 0.4, float(got.forces.turns[0])
        total += float(np.sum(log_between(m[:-1, 0], np.maximum(m[:-1, 1], m[:-1, 0])) + log_upper(m[:-1, 2])))
        total += float(log_upper(m[-1, [0, 2]]).sum())
        # (the twin subtracts chances, and loses digits where they are small)
        assert total == pytest.approx(chance, abs=1e-3)


@pytest.mark.parametrize("digits", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("parts", [2, 8])
def test_digits_leave_a_rebuilt_command_in_doubt_once_in_a_sample_and_where_it_turns(parts, digits):
    u = wandering(4, 60, 1.2)
    fine = np.interp(np.arange(u.size * parts) / parts, np.arange(u.size), u)
    got, alone = doubts(fine, 0.3, parts, digits), doubts(fine, 0.3)
    np.testing.assert_allclose(got, naive.rebuilt_doubts(fine, 0.3, parts, digits), rtol=1e-9, atol=1e-15)
    if not digits:
        np.testing.assert_array_equal(got, alone)
    if digits == 0.3:
        np.testing.assert_allclose(got[1::parts][:u.size - 1], doubts(u, 0.3)[1:])
        turns = int((np.diff(fine)[1:] * np.diff(fine)[:-1] <= 0.0).sum())
        assert 0 < np.count_nonzero(got) <= u.size + turns
    # A part changes by less than a sample, so errors of every part leave more in doubt.
    assert got.sum() <= alone.sum()


def test_rounding_of_a_command_that_moves_ends_no_slide_between_its_samples():
    # (with the error of the digits in every part of a sample the path leaves as much, and J is 5 % off)
    t = np.arange(8000.0)
    rough = naive.lagged(naive.lagged(8.0 * np.random.default_rng(5).standard_normal(t.size), 0.8), 0.995)
    u = 50.0 + 5.0 * np.sin(2 * np.pi * t / 400.0) + rough
    x = naive.chen(u, 3.6, 2.0)
    y = 50.0 + 1.5 * naive.lagged(x - x[0], math.exp(-1.0 / 20.0))[::5]
    loop = Loop(np.round(u[::5], 1), y + 0.05 * np.random.default_rng(3).standard_normal(y.size), step_s=5.0)
    model = model_on(loop, Spec(between=CORNER, substeps=8))
    values = model.vector({"S": 3.6, "J": 2.0, "initial_residual_force": 0.0, "time_constant_s": 20.0,
                           "dead_time_s": 0.0})
    assert model.evaluate(values).rmse > 0.1
    found = settle_path(model, values, error=likely_errors(model, values)[0])
    assert found.left == pytest.approx(0.05, rel=0.02)
    assert found.values[0] == pytest.approx(3.6, rel=0.005) and found.values[1] == pytest.approx(2.0, rel=0.01)
    assert found.prior < 200.0


def one_lag(decay):
    """A lag that decays by `decay` a command, which arrives at once."""
    return Held(np.array([[[1.0]], [[decay]]]), np.array([[0.0], [1.0 - decay]]), np.array([1.0]), 0.0, 0)


NOISES = [((), 0.0, 0.0), ((-0.6,), 0.0, 0.0), ((), 0.15, 0.0), ((-0.6,), 0.25, 0.3)]


def beam_sums_over_all_paths(rests, taps, lands, jitter, seeds):
    """The beam gives the sum over all paths of short records and the likeliest path, for each seed."""
    gain, decay, error = 15.0, 0.5, 0.15
    for seed in seeds:
        u = wandering(seed, 8, 1.2)
        every = naive.paths(u, 2.0, 1.0, 0.4, error, rests)
        rng = np.random.default_rng(seed)
        chances = np.array([math.exp(chance) for *_, chance in every])
        assert chances.sum() == pytest.approx(1.0)
        truth, target = every[int(rng.choice(len(every), p=chances / chances.sum()))], np.zeros(u.size)
        for k in range(1, u.size):
            target[k] = decay * target[k - 1] + (1.0 - decay) * gain * (truth[1][k - 1] - truth[1][0])
        mean, parts = naive.landing(truth[0], truth[1], 0.4, lands)
        target = target + gain * naive.lagged(mean + parts @ rng.standard_normal(u.size), decay)
        steps = np.diff(truth[1], prepend=truth[1][0])
        for event in (e for e in truth[0] if len(e) > 2):
            pulse = naive.pulse_of(event[0], steps[event[0]], decay, u.size)
            target = target + gain * jitter * rng.standard_normal() * pulse
        target = target + rng.standard_normal(u.size)
        late = np.where(np.arange(u.size) % 3 == 1, 2.0 * jitter, 0.0)
        weights = np.array([naive.path_likelihood(path, target, gain, decay, taps, 0.4, lands, jitter,
                                                  late=late if lands else None) for path in every])
        top = weights.max()
        nodes = 4000
        parent, at, kind = (np.empty(nodes, np.int64) for _ in range(3))
        table = friction_table(np.array([2.0]), np.array([1.0]))[:, 0]
        counts = np.ones(u.size, bool)
        total, share, node, _ = beam(u, np.ascontiguousarray(table), np.zeros(u.size), float(u[0]), rests, 0.4,
                              doubts(u, error), 1, 0, *one_lag(decay).over(1),
                              0.0, gain, target, counts, counts,
                              np.array(taps), lands, max(0.16 - 2.0 * lands**2, 0.0016),
                              np.empty(0), jitter, late, 14, parent, at, kind)
        # The last command moves nothing that was measured: paths that differ there only are one to the beam.
        assert total == pytest.approx(top + math.log(np.exp(weights - top).sum()), abs=0.02)
        found = []
        while node >= 0:
            found.append((int(at[node]), int(kind[node])))
            node = parent[node]
        known = [tuple(e[:2] for e in path[0] if e[0] < u.size - 1) for path in every]
        sums = {}
        for events, weight in zip(known, weights, strict=True):
            sums[events] = np.logaddexp(sums.get(events, -np.inf), weight)
        assert sums[tuple(sorted(found))] > max(sums.values()) - 0.3
        assert share == pytest.approx(sums[tuple(sorted(found))] - total, abs=0.3)


@pytest.mark.parametrize("rests", [False, True])
@pytest.mark.parametrize(("taps", "lands", "jitter"), NOISES)
def test_the_beam_sums_over_all_paths_and_finds_the_likeliest(rests, taps, lands, jitter):
    """One record; two more are in benchmarks/long."""
    beam_sums_over_all_paths(rests, taps, lands, jitter, range(1))


@pytest.mark.parametrize("rests", [False, True])
@pytest.mark.parametrize("lands", [0.0, 0.15])
def test_several_commands_in_a_sample_are_samples_whose_pv_is_missing(rests, lands):
    gain, decay, parts = 15.0, 0.8, 4
    u = wandering(3, 10 * parts, 0.4)
    table = np.ascontiguousarray(friction_table(np.array([2.0]), np.array([1.0]))[:, 0])
    position = replay_slips(get("chen"), u, table[:, None], np.zeros(u.size), np.zeros(1),
                            by_law(get("chen"), u, table[:, None], np.zeros(u.size), np.zeros(1))).position[:, 0]
    fine = gain * naive.lagged(np.concatenate([[0.0], position[:-1] - u[0]]), decay)

    def told(target, each):
        parent, at, kind = (np.empty(4000, np.int64) for _ in range(3))
        seen = np.arange(target.size) % (parts // each) == 0
        total, *_, node, _ = beam(u, table, np.zeros(u.size), float(u[0]), rests, 0.3, np.zeros(u.size), each, 0,
                                  *one_lag(decay).over(each), 0.0, gain, target, seen, seen, np.empty(0), lands, 0.09,
                                  np.empty(0), 0.0, np.zeros(u.size), 200, parent, at, kind)
        events = []
        while node >= 0:
            events.append((int(at[node]), int(kind[node])))
            node = parent[node]
        return total, events

    noisy = fine + 0.5 * np.random.default_rng(4).standard_normal(fine.size)
    (total, events), (other, same) = told(noisy[::parts], parts), told(noisy, 1)
    # (between samples slips with small chances are left out)
    assert len(events) > 1 and events == same and total == pytest.approx(other, abs=0.05)


@pytest.mark.parametrize("late", [0, 3])
def test_the_filter_of_landings_has_the_innovations_of_the_dense_covariance(late):
    decay, n = 0.7, 60
    rng = np.random.default_rng(4)
    good = rng.random(n) > 0.2
    moves = rng.random(n) > 0.7
    carried, drawn = np.where(moves, rng.random(n), 1.0), np.where(moves, rng.random(n), 0.0)
    early = np.where(moves, rng.random(n), 0.0)
    found = LandingFilter(np.array([[[1.0]], [[decay]]]), np.array([[0.0], [1.0 - decay]]), np.array([1.0]), 0.0, late,
                          parts=1, carried=carried, drawn=drawn, early=early, good=good)
    parts = np.zeros((n, n))
    for k in range(n):
        parts[k] = carried[k] * parts[k - 1] if k else 0.0
        parts[k, k] = math.sqrt(drawn[k])
    delayed = [naive.lagged(np.concatenate([np.zeros(late), part[:n - late]]), decay) for part in parts.T]
    columns = np.array([*delayed, *(naive.pulse_of(k + late, math.sqrt(early[k]), decay, n) for k in range(n - late))])
    covariance = np.eye(n) + columns.T @ columns
    np.testing.assert_allclose(found.alone, np.diag(covariance), atol=1e-10)
    factor = np.linalg.cholesky(covariance[np.ix_(good, good)])
    signals = rng.normal(size=(n, 3))
    np.testing.assert_allclose(found.applied(signals)[good], np.linalg.solve(factor, signals[good]), atol=1e-10)
    assert not found.applied(signals)[~good].any()
    assert found.log_scale(good) == pytest.approx(2.0 * np.log(np.diag(factor)).sum())


def test_chances_of_the_normal_distribution_hold_far_out():
    x = np.array([-np.inf, -8.0, 0.0, 3.0, 20.0, 30.0, 60.0])
    np.testing.assert_allclose(log_upper(x), norm.logsf(x), rtol=1e-5, atol=1e-14)
    low = np.array([-np.inf, -9.0, -0.1, 5.0, 31.0, -40.0])
    high = np.array([-7.0, -8.5, 0.2, 5.1, 31.2, -35.0])
    mirrored = low > 0.0
    a, b = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    want = norm.logcdf(b) + np.log1p(-np.exp(norm.logcdf(a) - norm.logcdf(b)))
    np.testing.assert_allclose(log_between(low, high), want, rtol=1e-4)


def scattering(seed=5, scatter=0.15):
    setting = Setting(Plant(2.0, 8.0, 3.0), Controller(0.25, 8.0, scan_s=1.0), S=4.0, J=2.0, noise_sd=0.08,
                      duration_s=1500.0, scatter=scatter)
    loop = simulate(setting, seed=seed).loop
    found = find_range(loop)
    model = bind_model(loop, Spec(), s_max=found.s_max, period_s=found.period_median_s)
    start = model.vector({"S": 4.1, "J": 1.9, "initial_residual_force": 0.0, "time_constant_s": 8.2,
                          "dead_time_s": 3.0})
    return model, start


def test_a_valve_whose_break_away_force_scatters_is_found_with_its_scatter():
    model, start = scattering()
    found = settle_path(model, start)
    assert found.values[0] == pytest.approx(4.0, rel=0.03)
    assert found.values[1] == pytest.approx(2.0, rel=0.05)
    assert found.paths.scatter == pytest.approx(0.15, rel=0.4)
    assert found.along.evaluate(found.values).rmse == pytest.approx(0.08, rel=0.05)
    assert model.evaluate(found.values).rmse > 3.0 * found.along.evaluate(found.values).rmse
    assert found.moved > 0.5


def test_few_strokes_widen_what_their_forces_tell_as_students_distribution_asks(monkeypatch):
    for strokes in (20, 60, 1000):
        wanted = math.sqrt(strokes / (strokes - 2)) * student.ppf(0.95, strokes - 2) / norm.ppf(0.95)
        assert width_of_forces(strokes) == pytest.approx(wanted, rel=0.01)
    found = settle_path(*scattering())
    wide = covariance(found)[0, 0]
    monkeypatch.setattr("stictionid.paths.settle.width_of_forces", lambda strokes: 1.0)
    assert 1.01 < math.sqrt(wide / covariance(found)[0, 0]) <= width_of_forces(found.paths.count) + 1e-9



@pytest.mark.parametrize("seed", [6, 7])
def test_a_stem_lands_with_the_error_of_its_command(seed):
    model, start = scattering(seed=seed, scatter=0.0)
    start[[0, 1, 3, 4]] = 4.0, 2.0, 8.0, 3.0
    starts = start[:, None].repeat(81, axis=1)
    starts[2] = np.linspace(-1.0, 1.0, 81)
    start = starts[:, np.argmin(model.costs_of(starts))].copy()
    error = 0.03
    output = model.loop.output + error * np.random.default_rng(seed).standard_normal(model.loop.samples)
    known = bind_model(replace(model.loop, output=output), Spec(), s_max=model.s_max, period_s=model.period_s)
    found = settle_path(known, start, error=error)
    assert found.values[0] == pytest.approx(4.0, rel=0.01) and found.along.spread > 1.05
    # What the free run leaves hangs together from sample to sample, what the filter of landings leaves hardly does.
    left = found.along.evaluate(found.values)
    counted = left.counted > 0
    free, ahead = (np.corrcoef(x[counted][1:], x[counted][:-1])[0, 1] for x in (left.residual, left.innovation))
    assert free > 0.15 and abs(ahead) < 0.5 * free
    exact = replace(found.paths, landing=None)
    assert found.deviance < deviance(known.along(exact), found.values[:, None])[0] - 50.0


def test_a_path_with_its_landing_is_stored_and_read():
    model, start = scattering(seed=6)
    paths = settle_path(model, start, error=0.05).paths
    assert paths.landing is not None and paths_from(json.loads(json.dumps(paths.description()))) == paths
    with pytest.raises(ValueError, match="lands is out of range"):
        paths_from({**paths.description(), "landing": {"ratio": -1.0, "values": {}}})


def test_a_path_that_a_valve_cannot_take_tells_nothing_of_where_it_landed():
    model, start = scattering(seed=6)
    found = settle_path(model, start, error=0.05)
    assert found.along.landing is not None
    # A stem that slides goes on with its command, and cannot slip once more.
    slips, moves = found.paths.slips[0], np.diff(model.loop.output)
    k = next(int(k) for k in slips.at if moves[k - 1] * moves[k] > 0.0)
    again = replace(slips, at=np.sort(np.append(slips.at, k + 1)), kind=np.insert(
        slips.kind, int(np.searchsorted(slips.at, k)) + 1, int(np.sign(moves[k]))))
    never = replace(found.paths, slips=(again,))
    other = model.along(never)
    assert other.landing is None
    assert np.isfinite(other.evaluate(found.values).residual).all()
    # (its scatter was nan, and went from there into the filter of landings)
    assert np.isfinite(_with_scatter(score_path(model, found.values, never), 0.01, 0.1).paths.scatter)


def test_no_answer_is_less_likely_than_the_path_by_the_law():
    for scatter in (0.0, 0.05):
        model, start = scattering(scatter=scatter)
        by_force = Paths(law_paths(model, start), 0.009)
        assert settle_path(model, start).deviance <= deviance(model.along(by_force), start[:, None])[0]


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_slips_that_all_come_a_sample_early_or_late_are_moved_back_together(seed):
    model, start = scattering(seed)
    # One slip at a time leads nowhere: with seeds 5 and 7 the dead time ends at 2.1 and 3.9 s.
    stuck = settle_path(model, start)
    found = settle_beside(stuck)
    assert found.values[4] == pytest.approx(3.0, abs=0.1)
    assert found.values[0] == pytest.approx(4.0, rel=0.02) and found.left == pytest.approx(0.08, rel=0.03)
    late = abs(stuck.values[4] - 3.0) > 0.5
    assert late == (seed != 6)
    assert found.deviance < stuck.deviance - 100.0 if late else found is stuck


@pytest.mark.parametrize("seed", [4, 5])
def test_the_speed_below_which_a_stem_rests_is_found_though_no_slope_leads_to_it(seed):
    spec, rests = Spec(between=CORNER, substeps=8, effects=("re-sticking",)), "re-sticking:restick_speed"
    model = model_on(recorded(0.05 * np.random.default_rng(seed).standard_normal(1200), spec, {rests: 1e9}), spec)
    fastest = model.space.parameters[-1].high
    stuck = settle_path(model, model.vector({**true_values(), rests: 0.3 * fastest}))
    assert stuck.values[-1] == pytest.approx(0.3 * fastest, rel=0.1) and abs(stuck.values[0] / 3.6 - 1.0) > 0.1
    found = settle_beside(stuck)
    assert found.deviance < stuck.deviance - 100.0
    assert found.values[-1] > 0.9 * fastest and found.values[0] == pytest.approx(3.6, rel=0.01)


def test_a_path_that_no_valve_takes_has_no_likelihood_and_settles_nothing():
    spec = Spec(effects=("re-sticking",))
    model = model_on(recorded(np.zeros(600), spec, {"re-sticking:restick_speed": 1e9}), spec)
    values = model.vector({**true_values(), "re-sticking:restick_speed": 1e9})
    paths = Paths(law_paths(model, values), 0.1)
    first = paths.slips[0].at[0]
    # (a turn of a stem that rests, on which no valve slides on)
    never = replace(paths, slips=(replace(paths.slips[0], at=np.full(3, first), kind=np.array([1, -1, 1])),))
    score = score_path(model, values, never)
    assert score.deviance == np.inf
    assert np.isfinite(settle_path(model, values, begin=never).deviance)


def test_a_stem_that_slips_at_once_does_not_lose_the_record():
    model, values = scattering(scatter=0.0)
    # At its full force the stem of S 4 and J 2 slips to a third of that force, then it moves by the law.
    values[:3] = 4.0, 2.0, 1.0 / 3.0
    slips = law_paths(model, values)[0]
    at_once = replace(slips, at=np.insert(slips.at, 0, 0), kind=np.insert(slips.kind, 0, 1))
    values[2] = 1.0
    truth = Paths((at_once,), 0.1)
    run = model.along(truth).evaluate(values)
    noise = 0.08 * np.random.default_rng(3).standard_normal(model.loop.samples)
    pv = model.loop.process_value - run.residual + noise
    seen = bind_model(replace(model.loop, process_value=pv), Spec(), s_max=model.s_max, period_s=model.period_s)
    before = deviance(seen.along(truth), values[:, None])[0]
    assert truth.count > 5 and np.isfinite(before)
    assert deviance(seen.along(likeliest_slips(seen.along(truth), values)), values[:, None])[0] <= before + 3.0


def test_a_path_of_several_segments_has_one_gain_and_the_heights_of_its_own_strokes():
    model, start = scattering()
    loop = replace(model.loop, starts=(0, 700), begins_s=(0.0, 700.0))
    parts = bind_model(loop, Spec(), s_max=model.s_max, period_s=model.period_s)
    values = parts.vector(model.named(start))
    found = settle_path(parts, values)
    fit = finish_along(found.along, found.values)
    low, high = fit.intervals["gain"]
    assert low < 2.0 < high and high - low < 0.4
    assert found.values[0] == pytest.approx(4.0, rel=0.03)
    one, two = (stroke.position[:, 0] for stroke in found.strokes())
    np.testing.assert_array_equal(np.concatenate([one, two]), found.along.positions(found.values[:, None])[:, 0])


def test_a_path_that_coloured_noise_makes_much_less_likely_is_given_up(monkeypatch):
    white, colour = np.random.default_rng(1).standard_normal(1500), np.zeros(1500)
    for k in range(1, colour.size):
        colour[k] = 0.9 * colour[k - 1] + 0.1 * math.sqrt(1.0 - 0.9**2) * white[k]
    setting = Setting(Plant(1.5, 10.0, 3.0), Controller(0.4, 12.0, scan_s=1.0), S=4.0, J=2.0, duration_s=1500.0,
                      setpoint_moves=((0.0, 3.0), (450.0, -2.0), (900.0, 2.0)))
    model = bind_model(simulate(setting, disturbance=colour).loop, Spec(), s_max=8.0, period_s=60.0)
    values = model.vector({"S": 4.0, "J": 2.0, "initial_residual_force": 1.3 / 3.0, "time_constant_s": 10.0,
                           "dead_time_s": 3.0})
    done = complete_quickly(model, values)
    assert done.taps.size and done.evaluated.rmse > 2.0 * done.noise_error
    searched = []
    monkeypatch.setattr(completion, "settle_with_error", lambda *_, **__: searched.append(1))
    assert place_slips(done, rounds=0) is done and not searched
    # A held command settles it once, from its own values.
    assert place_slips(done, values) is done and not searched


@pytest.mark.parametrize("seed", [5, 10])
def test_a_narrow_band_is_estimated_along_the_path_before_the_path_is_judged(seed):
    """The path was refused, because its innovations were not white beside the noise that wrong slips had made."""
    setting = Setting(Plant(2.0, 8.0, 3.0), Controller(0.25, 8.0, scan_s=1.0), S=4.0, J=2.0, noise_sd=0.02,
                      duration_s=1500.0, scatter=0.02)
    loop = simulate(setting, seed=seed).loop
    wave = lfilter([1.0], [1.0, -1.96 * np.cos(2.0 * np.pi / 9.0), 0.98**2],
                   0.15 * np.random.default_rng(seed).standard_normal(loop.samples))
    model = bind_model(replace(loop, process_value=loop.process_value + wave), Spec(), s_max=8.0, period_s=40.0)
    done = complete_quickly(model, model.vector({"S": 4.0, "J": 2.0, "initial_residual_force": 0.0,
                                                 "time_constant_s": 8.0, "dead_time_s": 3.0}))
    assert done.innovation_sd > 0.2 and not done.white
    placed = place_slips(done)
    assert placed.model.spec.paths is not None and placed.white and placed.gain_over(done) > 500.0
    assert placed.innovation_sd == pytest.approx(0.17, abs=0.005)


def test_a_valve_whose_force_scatters_is_settled_though_its_first_path_is_far_behind():
    # From a process that is wrong the first path is worse by more than a hundred; rounds of path and values mend both.
    model, start = scattering()
    start[3] = 20.0
    done = complete_quickly(model, start)
    first = model.along(first_path(model, start, 0.0).paths)
    assert done.evaluated.rmse > 2.6 * done.noise_error and first.evaluate(start).rmse > 2.0 * 0.08
    placed = place_slips(done)
    assert placed.gain_over(done) > 500.0 and placed.evaluated.rmse < 1.1 * 0.08


def moving(seed, disturbance=None, duration_s=1500.0, **more):
    """The model of a simulated loop whose command moves between samples."""
    setting = Setting(Plant(1.5, 10.0, 3.0), Controller(0.4, 12.0), S=4.0, J=2.0, duration_s=duration_s,
                      setpoint_moves=((0.0, 3.0), (450.0, -2.0), (900.0, 2.0)), **more)
    loop = simulate(setting, seed=seed, disturbance=disturbance).loop
    found = find_range(loop)
    return bind_model(loop, Spec(between=CORNER, substeps=8), s_max=found.s_max, period_s=found.period_median_s)


def best_start(model, values):
    forces = np.linspace(-1.0, 1.0, 81)
    starts = np.stack([model.vector({**values, "initial_residual_force": e}) for e in forces], axis=1)
    return starts[:, np.argmin(model.costs_of(starts))].copy()


def completed(model, **named):
    values = {"S": 4.0, "J": 2.0, "time_constant_s": 10.0, "dead_time_s": 3.0, **named}
    return complete_quickly(model, best_start(model, values))


def gain_of_first_path(done):
    free = rebind_model(done.model, replace(done.model.spec, taps=(), increments=False), done.evaluated.left)
    first = first_path(free, done.values, likely_errors(done.model, done.values)[0])
    along = complete_quickly(free.along(first.paths), first.values)
    return replace(along, prior=first.prior).gain_over(done)


def test_under_a_moving_command_a_path_near_the_noise_is_given_up_before_its_rounds(monkeypatch):
    white, colour = np.random.default_rng(10).standard_normal(3000), np.zeros(3000)
    for k in range(1, colour.size):
        colour[k] = 0.8 * colour[k - 1] + 0.6 * white[k]
    done = completed(moving(10, 0.1 * colour, duration_s=3000.0, noise_sd=0.05))
    assert done.taps.size and done.evaluated.rmse < 2.0 * done.noise_error and gain_of_first_path(done) < -100.0
    monkeypatch.setattr(completion, "settle_with_error", lambda *_, **__: pytest.fail("it was settled"))
    assert place_slips(done) is done


def test_under_a_moving_command_a_path_far_from_the_noise_is_settled_however_it_begins():
    done = completed(moving(6, noise_sd=0.08, scatter=0.15), S=4.6, J=0.8)
    assert done.evaluated.rmse > 2.6 * done.noise_error and gain_of_first_path(done) < -100.0
    placed = place_slips(done)
    assert placed.values[0] == pytest.approx(4.0, rel=0.05) and placed.evaluated.rmse < 1.1 * 0.08


def slow_export(setting, seed, every):
    loop = simulate(setting, seed=seed).loop
    return Loop(output=loop.output[::every], process_value=loop.process_value[::every],
                setpoint=loop.setpoint[::every], step_s=every * loop.step_s)


def at_truth(loop, process, **named):
    found = find_range(loop)
    model = bind_model(loop, Spec(process=process), s_max=found.s_max, period_s=found.period_median_s)
    return model, best_start(model, named)


@pytest.mark.parametrize(("seed", "every"), [(0, 3), (2, 5)])
def test_between_the_samples_of_a_slow_export_slips_come_early_and_the_command_errs(seed, every):
    setting = Setting(Plant(1.2, 15.0, 4.0), Controller(0.9, 25.0, scan_s=1.0), S=4.0, J=2.0, noise_sd=0.04,
                      duration_s=4000.0, setpoint_moves=((0.0, 3.0), (1500.0, -4.0), (2600.0, 3.0)))
    model, start = at_truth(slow_export(setting, seed, every), FIRST_ORDER, S=4.0, J=2.0, time_constant_s=15.0,
                            dead_time_s=4.0)
    within = error_range(model, start)
    found = settle_path(model, start, error=likely_errors(model, start)[0], within=within)
    assert model.evaluate(start).rmse > 7.0 * 0.04
    assert found.left < 1.1 * 0.04
    assert found.values[:2] == pytest.approx([4.0, 2.0], rel=0.06)
    assert within[0] < found.paths.error < within[1]
    # Neither term does without the other.
    for without in (replace(found.paths, jitter=0.0), found.paths.with_error(0.2 * found.paths.error)):
        assert found.deviance < deviance(model.along(without), found.values[:, None])[0] - 50.0


@pytest.mark.parametrize(("scan_s", "spec"), [(1.0, Spec(between=DECIMATED, substeps=5)),
                                              (0.0, Spec(between=CORNER, substeps=8))])
def test_a_setpoint_between_two_rows_moves_the_stem_at_a_time_that_no_row_tells(scan_s, spec, monkeypatch):
    moves = tuple((120.0 * k + 37.0 * k % 11, 4.0 * (-1)**k) for k in range(25))
    setting = Setting(Plant(1.2, 15.0, 4.0), Controller(1.2, 1e9, scan_s=scan_s), S=4.0, J=2.0, noise_sd=0.02,
                      duration_s=3000.0, setpoint_moves=moves)

    def settled():
        loop = slow_export(setting, 1, 5)
        # (without digits the sum of this law would show, however slow it is)
        loop = replace(loop, output=np.round(loop.output, 3))
        found = find_range(loop)
        model = bind_model(loop, spec, s_max=found.s_max, period_s=found.period_median_s)
        start = model.vector({"S": 4.0, "J": 2.0, "initial_residual_force": 0.0, "time_constant_s": 15.0,
                              "dead_time_s": 4.0})
        return settle_path(model, start, error=likely_errors(model, start)[0], within=error_range(model, start))

    known = settled()
    monkeypatch.setattr(response, "late_moves", lambda loop, parts, held: np.zeros(loop.samples * parts))
    assert known.deviance < settled().deviance - 500.0
    assert known.values[0] == pytest.approx(4.0, rel=0.03)


def test_the_gain_of_an_integrator_is_not_lost_with_the_slips_that_a_slow_export_hides():
    setting = Setting(Plant(0.0165, 5.4, 3.8, integrating=True), Controller(2.0, 120.0, scan_s=1.0), S=4.6, J=4.0,
                      noise_sd=0.03, duration_s=4000.0, setpoint_moves=((0.0, 2.0),))
    model, start = at_truth(slow_export(setting, 3, 5), INTEGRATOR, S=4.6, J=4.0, time_constant_s=5.4, dead_time_s=3.8)
    assert model.evaluate(start).gain < 0.2 * 0.0165
    found = settle_path(model, start, error=likely_errors(model, start)[-1], within=error_range(model, start))
    assert found.left < 1.1 * 0.03
    assert found.along.evaluate(found.values).gain == pytest.approx(0.0165, rel=0.1)
    assert found.values[:2] == pytest.approx([4.6, 4.0], rel=0.08)


@pytest.mark.parametrize(("every", "hides"), [(1, False), (2, False), (3, True)])
def test_a_record_that_may_show_every_scan_has_no_error_to_seek(every, hides):
    setting = Setting(Plant(1.2, 15.0, 4.0), Controller(0.9, 25.0, scan_s=1.0), S=4.0, J=2.0, noise_sd=0.04)
    model, start = at_truth(slow_export(setting, 1, every), FIRST_ORDER, S=4.0, J=2.0, time_constant_s=15.0,
                            dead_time_s=4.0)
    errors, within = likely_errors(model, start), error_range(model, start)
    assert (within[1] > 0.0) == hides and (within[0] < errors[0] < within[1] if hides else errors == (0.0,))
    assert (first_path(model, start, errors[0]).paths.jitter > 0.0) == hides


def test_an_error_of_the_command_is_that_of_its_landings():
    model, start = scattering(seed=6)
    paths = settle_path(model, start, error=0.05).paths
    half = paths.with_error(0.025)
    assert half.error == 0.025 and half.landing.ratio == pytest.approx(0.5 * paths.landing.ratio)
    assert replace(paths, landing=None).with_error(0.025).landing is None


def test_copies_of_a_candidate_move_as_it_does():
    law, command = get("chen"), wandering(3)
    friction = friction_table(np.array([3.0, 2.0, 2.5, 2.5, 2.5]), np.array([1.5, 1.0, 1.2, 1.2, 1.2]))
    share, profile = np.array([0.1, 0.2, 0.3, 0.3, 0.3]), np.zeros(command.size)
    slips = by_law(law, command, friction[:, :1], profile, share[:1])
    together = replay_slips(law, command, friction, profile, share, slips)
    for p in range(share.size):
        alone = replay_slips(law, command, friction[:, p:p + 1], profile, share[p:p + 1], slips)
        np.testing.assert_array_equal(together.position[:, p], alone.position[:, 0])
        np.testing.assert_array_equal(together.forces.margins[:, :, p], alone.forces.margins[:, :, 0])
        assert together.forces.turns[p] == alone.forces.turns[0]


def test_slips_are_placed_in_levels_where_misplaced_ones_look_like_a_walk():
    model, start = scattering(seed=7)
    start[:2] = 4.2, 1.9
    done = complete_quickly(rebind_model(model, replace(model.spec, increments=True, taps=SOFT)), start)
    placed = place_slips(done)
    assert done.increments and not placed.increments and placed.model.spec.paths is not None
    assert placed.evaluated.values["S"] == pytest.approx(4.0, rel=0.01)
    assert placed.evaluated.rmse == pytest.approx(0.08, rel=0.05)


def test_moments_of_a_truncated_normal_far_into_its_tails():
    # A path that is foreign to the values of a model asks for forces a thousand scatters away.
    low = np.array([-np.inf, -3.0, 0.5, 20.0, 30.0, -31.0, 1e3, -1e6, 0.3, -1e-9, 2.0, -1e200])
    high = np.array([1.0, -2.9, 0.6, 20.5, 31.0, -30.0, 1e3 + 1.0, -1e6 + 1.0, 0.3, 1e-9, 1.0, 0.0])
    with np.errstate(all="raise"):
        mean, square = moments_between(low, high, 1.0)
    for k in range(8):
        a, b = float(low[k]), float(high[k])
        top = min(max(a, 0.0), b) if a <= 0.0 <= b else (a if a > 0.0 else b)
        x = np.linspace(max(a, top - 12.0, -12.0 + min(top, 0.0)), min(b, top + 12.0), 400_001)
        weight = np.exp(-0.5 * (x - top) * (x + top))
        np.testing.assert_allclose([mean[k], square[k]], [np.sum(weight * x) / np.sum(weight),
                                                          np.sum(weight * x * x) / np.sum(weight)], rtol=2e-3)
    np.testing.assert_allclose(mean[8:], [0.3, 0.0, 2.0, -np.sqrt(2.0 / np.pi)], atol=1e-8)
    assert (square >= mean**2).all()


def test_the_first_block_of_an_integrator_is_held_out_with_the_level_that_it_alone_shows():
    # Errors of landing add up: behind the first of them the start tells little of the level.
    setting = Setting(Plant(0.02, 4.0, 3.0, integrating=True), Controller(1.5, 80.0, scan_s=1.0), S=3.6, J=2.6,
                      noise_sd=0.003, duration_s=1500.0, setpoint_moves=((0.0, 2.0),))
    whole = simulate(setting, seed=8).loop
    loop = replace(whole, output=whole.output + 0.05 * np.random.default_rng(8).standard_normal(whole.samples))
    found = find_range(loop)
    model = bind_model(loop, Spec(process=INTEGRATOR), s_max=found.s_max, period_s=found.period_median_s)
    true = {"S": 3.6, "J": 2.6, "time_constant_s": 4.0, "dead_time_s": 3.0}
    starts = np.stack([model.vector({**true, "initial_residual_force": e}) for e in np.linspace(-1.0, 1.0, 81)], axis=1)
    start = starts[:, np.argmin(model.costs_of(starts))].copy()
    settled = settle_path(model, start, error=0.05)
    assert settled.along.landing is not None
    held = held_out_of(settled.along, settled.values, settled.along.evaluate(settled.values))
    assert held is not None
    assert held.blocks[0] < 1.5 * np.median(held.blocks)


def test_beside_an_end_that_is_not_known_no_moment_is():
    mean, square = moments_between(np.array([-1.0, -1.0]), np.array([1.0, np.nan]), 1.0)
    assert np.isfinite(mean[0]) and np.isfinite(square[0]) and np.isnan(mean[1]) and np.isnan(square[1])


def test_a_look_along_a_path_keeps_the_break_away_force():
    # Along a path PV says nothing of that force: it went to a third, and the slips of the look fitted no valve.
    setting = Setting(Plant(2.0, 8.0, 3.0, second_time_constant_s=2.5), Controller(0.25, 8.0, scan_s=1.0), S=4.0, J=3.5,
                      noise_sd=0.04, duration_s=900.0, setpoint_moves=((0.0, 3.0), (450.0, -2.0)), scatter=0.15)
    loop = simulate(setting, seed=3).loop
    found = find_range(loop)
    model = bind_model(loop, Spec(), s_max=found.s_max, period_s=found.period_median_s)
    settled = settle_path(model, model.vector({"S": 4.0, "J": 3.5, "initial_residual_force": 0.0,
                                               "time_constant_s": 9.0, "dead_time_s": 4.5}))
    without = finish_along(settled.along, settled.values, last=False)
    done = look_along(without, "extra-lag")
    assert done.model.spec.paths is not None
    assert done.gain_over(place_slips(complete_quickly(settled.along, settled.values), rounds=0)) > 100.0
    assert done.values[0] == pytest.approx(4.0, rel=0.05)


def test_the_chances_of_all_paths_add_up_to_one_at_most():
    """A share may belong to other values than those of the path: it never makes a path more than certain."""
    model, start = scattering(seed=8, scatter=0.06)
    found = settle_path(model, start)
    chance = -2.0 * float(log_prior(forces(found.along, found.values[:, None]), found.paths.scatter)[0])
    assert chance > 1.0
    for share, prior in ((0.0, chance), (-0.25 * chance, 0.5 * chance), (-chance, 0.0)):
        shared = score_path(model, found.values, replace(found.paths, share=share))
        assert shared.prior == pytest.approx(prior, abs=1e-9)
        assert shared.deviance - found.deviance == pytest.approx(shared.prior - found.prior, abs=1e-6)
