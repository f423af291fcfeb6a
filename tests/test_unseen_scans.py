"""A command that errs at each unseen scan by itself: chances of slips, landings, and the beam over them."""

import math

import naive
import numpy as np
import pytest
from test_paths import events_of, one_lag, wandering

from stictionid.laws import get
from stictionid.laws.contract import friction_table
from stictionid.model.replay import doubts, replay_slips
from stictionid.model.slips import ScanErrors
from stictionid.paths.beam import beam

OWN, ERROR = 0.3**2, 0.25


def errors_of(command, rows=3):
    """Variances of a command of which every third value is a row."""
    return np.where(np.arange(command.size) % rows == 0, 0.0, ERROR**2)


# (a valve that slides on has more paths)
@pytest.mark.parametrize(("rests", "samples"), [(False, 7), (True, 8)])
def test_a_path_has_the_positions_and_the_chance_of_its_slow_twin(rests, samples):
    law, u = get("he" if rests else "chen"), wandering(3, samples, 1.2)
    table, errors = friction_table(np.array([2.0]), np.array([1.0])), errors_of(u)
    found = naive.scan_paths(u, 2.0, 1.0, OWN, errors, ERROR, rests)
    assert sum(math.exp(chance) for *_, chance in found) == pytest.approx(1.0, abs=1e-6)
    likely = [path for path in found if path[2] > -12.0]
    assert len(likely) > 20
    for events, places, chance in likely:
        got = replay_slips(law, u, table, np.zeros(u.size), np.zeros(1), events_of(events, u.size),
                           doubt=doubts(u, ERROR), errors=ScanErrors(errors, OWN))
        np.testing.assert_allclose(got.position[:, 0], places, rtol=0, atol=1e-3)
        assert float(got.forces.log_chance(0.3)[0]) == pytest.approx(chance, abs=5e-3)
        roots = float((got.forces.roots(0.3)**2).sum()) - 2.0 * float(got.forces.turns[0])
        assert roots == pytest.approx(-2.0 * chance, abs=1e-2)


def test_lanes_of_one_valve_move_as_each_does_alone():
    """The second and fourth lanes have the valve of the first; the others differ by J, by S, and by their start."""
    u, law = wandering(3, 40, 1.2), get("chen")
    S, J, share = np.array([2.0, 2.0, 2.0, 2.0, 2.4, 2.0]), np.array([1.0, 1.0, 1.3, 1.0, 1.0, 1.0]), np.zeros(6)
    share[5] = 0.8
    errors, path = ScanErrors(errors_of(u), OWN), events_of([(20, 1)], u.size)

    def replayed(lanes):
        return replay_slips(law, u, friction_table(S[lanes], J[lanes]), np.zeros(u.size), share[lanes], path,
                            doubt=doubts(u, ERROR), errors=errors)

    whole = replayed(np.arange(6))
    chances = whole.forces.log_chance(0.3)
    for lane in range(6):
        alone = replayed(np.array([lane]))
        np.testing.assert_array_equal(whole.position[:, lane], alone.position[:, 0])
        assert chances[lane] == alone.forces.log_chance(0.3)[0]
    assert len(np.unique(chances)) == 4


@pytest.mark.parametrize("rests", [False, True])
@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_the_beam_sums_over_all_paths_and_finds_the_likeliest(rests, jitter):
    gain, decay, u = 15.0, 0.5, wandering(0, 7, 1.2)
    errors, rng = errors_of(u), np.random.default_rng(0)
    every = naive.scan_paths(u, 2.0, 1.0, OWN, errors, ERROR, rests)
    truth = every[int(np.argmax([chance for *_, chance in every]))]
    _, parts = naive.scan_landing(*truth[:2], errors)
    target = gain * naive.lagged(np.array(truth[1]) - truth[1][0] + parts @ rng.standard_normal(u.size), decay)
    target += rng.standard_normal(u.size)
    late = np.where(np.arange(u.size) % 3 == 1, 2.0 * jitter, 0.0)
    weights = np.array([naive.path_likelihood(path, target, gain, decay, jitter=jitter, late=late,
                                              landed=naive.scan_landing(*path[:2], errors)) for path in every])
    parent, at, kind = (np.empty(4000, np.int64) for _ in range(3))
    table, counts = friction_table(np.array([2.0]), np.array([1.0]))[:, 0], np.ones(u.size, bool)
    total, share, node, _ = beam(u, np.ascontiguousarray(table), np.zeros(u.size), float(u[0]), rests, 0.3,
                                 doubts(u, ERROR), 1, 0, *one_lag(decay).over(1), 0.0, gain, target, counts, counts,
                                 np.empty(0), ERROR, OWN, errors, jitter, late, 14, parent, at, kind)
    assert total == pytest.approx(np.logaddexp.reduce(weights), abs=0.03)
    found = []
    while node >= 0:
        found.append((int(at[node]), int(kind[node])))
        node = parent[node]
    sums = {}
    for (events, *_), weight in zip(every, weights, strict=True):
        known = tuple(e[:2] for e in events if e[0] < u.size - 1)
        sums[known] = np.logaddexp(sums.get(known, -np.inf), weight)
    assert sums[tuple(sorted(found))] > max(sums.values()) - 0.3
    assert share == pytest.approx(sums[tuple(sorted(found))] - total, abs=0.3)
