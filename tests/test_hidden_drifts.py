"""Disturbances that a noise model of long memory holds as well: draws of that noise, gates, and their worth."""

from __future__ import annotations

import numpy as np
import pytest
from real_nodes import recorded, scored
from scipy.signal import lfilter

from stictionid.effects import parse
from stictionid.fit.noise.completion import Refit
from stictionid.fit.noise.draws import draw_residual, noise_imitates
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.record.tree import Gate
from stictionid.selection.entry import ADD, DROP, Entry, rank_entries
from stictionid.selection.gates import LASTS, Edge, judge_edge, outlasts_noise
from stictionid.selection.node import key
from stictionid.selection.policy import Policy
from stictionid.selection.score import Scored
from stictionid.typing import FloatArray

SAMPLES, POLICY, RAMP, STOP = 1200, Policy(), "ramp-disturbance@output", "travel-limit"
SINE, START = "sinusoidal-disturbance", 500.0


def errors(root: float = 0.0, sd: float = 1.0, seed: int = 0) -> FloatArray:
    """Noise (SAMPLES,) of one root; with a root of 1 a walk."""
    return np.asarray(lfilter([1.0], [1.0, -root], sd * np.random.default_rng(seed).standard_normal(SAMPLES)))


def ramp(rate: float = 0.1) -> FloatArray:
    return rate * np.maximum(np.arange(SAMPLES) - START, 0.0)


def with_ramp(residual: FloatArray, start_s: float = START) -> tuple[Scored, Scored]:
    """The node of a record with these errors, and that with a ramp from a given time."""
    loop = recorded(residual)
    return scored(loop), scored(loop, Spec(effects=(RAMP,)), {f"{RAMP}:start_s": start_s})


def with_sine(amplitude: float, process: str, **valve: float) -> tuple[Scored, Scored]:
    """The node of a record with white errors and a sine of 150 s, and that with the sine; both with such a valve."""
    spec = Spec(process=process)
    wave = amplitude * np.sin(2.0 * np.pi * np.arange(SAMPLES) / 150.0)
    loop = recorded(wave + errors(sd=0.2), spec, valve)
    return scored(loop, spec, valve), scored(loop, Spec(process=process, effects=(SINE,)),
                                             {f"{SINE}:period_s": 150.0, **valve})


def test_noise_is_drawn_from_the_innovations_through_the_noise_model() -> None:
    done = scored(recorded(np.asarray(lfilter([1.0], [1.0, -1.2, 0.5], errors())))).done
    assert done.taps.size >= 2
    pool = done.innovation[done.good]
    white = np.random.default_rng(1).choice(pool - pool.mean(), SAMPLES)
    expected = lfilter([1.0], [1.0, *done.taps], white)
    np.testing.assert_allclose(draw_residual(done, np.random.default_rng(1)), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_walk_imitates_a_walk_and_seldom_a_ramp(seed: int) -> None:
    walk, straight = (scored(recorded(e)).done for e in (errors(1.0, seed=seed), ramp() + errors(seed=seed)))
    assert noise_imitates(walk, RAMP, 100, np.random.default_rng(2))
    assert not noise_imitates(straight, RAMP, 100, np.random.default_rng(2))


def test_a_sine_is_told_from_noise_of_long_memory() -> None:
    wave = 20.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / 300.0) + errors()
    assert not noise_imitates(scored(recorded(wave)).done, SINE, 100, np.random.default_rng(0))


def share_left(done: Refit, residual: FloatArray) -> float:
    """Share of the variance of a residual that the best guess of a ramp and a level leave, by least squares."""
    left, residual = [], residual[done.good]
    for start in parse(RAMP)[0].guess(done.model.context_of("output"))[:, 0]:  # type: ignore[misc]
        drift = np.maximum(np.arange(SAMPLES) - start, 0.0)[done.good]
        columns = np.stack([np.ones(drift.size), drift], axis=1)
        rest = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
        left.append(float(np.sum(rest**2)))
    return min(left) / float(np.sum((residual - residual.mean()) ** 2))


def test_a_draw_imitates_a_ramp_where_least_squares_leave_no_more_of_it() -> None:
    done = scored(recorded(errors(1.0))).done
    seen = share_left(done, done.evaluated.residual)
    found = [noise_imitates(done, RAMP, 1, np.random.default_rng(seed)) for seed in range(30)]
    assert found == [share_left(done, draw_residual(done, np.random.default_rng(seed))) <= seen for seed in range(30)]
    assert set(found) == {True, False}


def test_only_a_disturbance_that_takes_half_of_more_than_noise_may_last() -> None:
    parent, child = with_ramp(ramp() + errors())
    assert outlasts_noise(RAMP, child, parent, POLICY)
    assert not outlasts_noise(STOP, child, parent, POLICY)
    late = with_ramp(ramp() + errors(), start_s=1100.0)
    assert late[1].rmse > late[0].rmse / 2 and not outlasts_noise(RAMP, late[1], late[0], POLICY)
    walk, quiet = with_ramp(errors(1.0)), scored(recorded(errors(sd=0.1)))
    assert not outlasts_noise(RAMP, quiet, walk[0], POLICY)  # (a draw of the walk looks like a ramp)
    alone = scored(recorded(errors()))
    assert alone.noise_alone and not outlasts_noise(RAMP, quiet, alone, POLICY)


# Numbers of a search that asks for more than any of these disturbances gains.
MORE = Policy(margin=1e4)


def failed(edge: Edge) -> list[str]:
    gates = judge_edge(edge)
    # A gate that compares one number passes by that number: the free-run error lies below its limit, all else above.
    for g in gates:
        if g.statistic is not None and g.name != LASTS and LASTS not in [x.name for x in gates]:
            assert g.passed == ((g.statistic <= g.threshold) if g.name == "free-run" else g.statistic >= g.threshold)
    return [g.name for g in gates if not g.passed]


def test_a_drift_that_lasts_passes_the_gates_of_the_one_step_error_alone() -> None:
    parent, child = with_ramp(ramp() + errors())
    assert not failed(Edge(RAMP, child, parent, POLICY))
    assert LASTS not in [g.name for g in judge_edge(Edge(RAMP, child, parent, POLICY))]
    assert not failed(Edge(RAMP, child, parent, MORE))
    assert LASTS in [g.name for g in judge_edge(Edge(RAMP, child, parent, MORE))]
    # Nor does a valve that might as well follow its command show a sine, however long it outlasts_noise.
    parent, child = with_sine(1.5, FIRST_ORDER, S=0.02, J=0.01)
    assert outlasts_noise(SINE, child, parent, MORE)
    assert failed(Edge(SINE, child, parent, MORE, blurred=True)) == ["gain", "friction"]
    friction = next(g for g in judge_edge(Edge(SINE, child, parent, MORE, blurred=True)) if g.name == "friction")
    assert friction.statistic == child.without_friction and friction.threshold == pytest.approx(1.05 * child.rmse)


@pytest.mark.parametrize(("process", "blurred", "amplitude", "named"), [
    (INTEGRATOR, True, 8.0, True),  # (a slip lost for half a cycle shifts y by 2.2, and the sine by more)
    (INTEGRATOR, True, 1.5, False), (INTEGRATOR, False, 1.5, True), (FIRST_ORDER, True, 1.5, True)])
def test_under_unseen_scans_a_disturbance_of_an_integrator_must_explain_more_than_a_slip(
        process: str, blurred: bool, amplitude: float, named: bool) -> None:
    parent, child = with_sine(amplitude, process)
    assert failed(Edge(SINE, child, parent, MORE, blurred=blurred)) == ([] if named else ["gain"])


def test_a_drift_that_lasts_ranks_its_margin_above_its_parent_and_so_do_its_children() -> None:
    """A child without it, found when it was left out, gets no credit."""
    said = (Gate(LASTS, True, "it lasts"),)
    loop = recorded(ramp(0.02) + errors(1.0, 0.2))
    spec, drift, both, other = (Spec(effects=names) for names in ((), (RAMP,), (RAMP, STOP), (STOP,)))
    late = {f"{RAMP}:start_s": 1100.0}
    root = Entry(spec, scored(loop))
    named = Entry(drift, scored(loop, drift, late), key(spec), ADD, RAMP, gates=said)
    more = Entry(both, scored(loop, both, late), key(drift), ADD, STOP)
    less = Entry(other, scored(loop, other), key(both), DROP, RAMP)
    gain = named.scored.done.gain_over(root.scored.done)
    assert gain < 0.0
    memo = {key(e.spec): e for e in (root, named, more, less)}
    assert [e.credit(memo, POLICY) for e in (root, named, more, less)] == pytest.approx(
        [0.0, POLICY.margin - gain, POLICY.margin - gain, 0.0])
    assert rank_entries(memo, POLICY) == [named, more, root, less]
