"""Disturbances that a noise model of long memory holds as well: draws of that noise, gates, and their worth."""

from __future__ import annotations

from types import MethodType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from stictionid.effects import parse
from stictionid.effects.contract import Context
from stictionid.fit.noise.draws import _share_left, draw_residual, noise_imitates
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.record.tree import Gate
from stictionid.selection import gates
from stictionid.selection.entry import ADD, DROP, Entry
from stictionid.selection.gates import LASTS, Edge, judge_edge, outlasts_noise
from stictionid.selection.node import key
from stictionid.selection.policy import Policy
from stictionid.selection.score import Scored
from stictionid.selection.waiting import rank_entries

SAMPLES, POLICY = 1200, Policy()


def completed(residual: np.ndarray[Any, Any], taps: tuple[float, ...] = (-0.999,), seed: int = 0) -> Any:
    """A completed model with a residual, one sample a second, a noise model, and white innovations of size 1."""
    innovation = np.random.default_rng(seed).standard_normal(SAMPLES)
    context = Context(np.zeros(SAMPLES), residual, None, 1.0, 1, 60.0)
    model = SimpleNamespace(pace=1.0, good=lambda: np.ones(SAMPLES, bool), context_of=lambda option: context)
    return SimpleNamespace(innovation=innovation, good=np.ones(SAMPLES, bool), model=model,
                           white_model=lambda: SimpleNamespace(taps=np.array(taps)),
                           evaluated=SimpleNamespace(residual=residual))


def ramp(rate: float = 0.1) -> np.ndarray[Any, Any]:
    return rate * np.maximum(np.arange(SAMPLES) - 500.0, 0.0)


def test_noise_is_drawn_from_the_innovations_through_the_noise_model() -> None:
    done = completed(np.zeros(SAMPLES), (-1.2, 0.5))
    pool = done.innovation - done.innovation.mean()
    white = np.random.default_rng(1).choice(pool, SAMPLES)
    expected = lfilter([1.0], [1.0, -1.2, 0.5], white)
    np.testing.assert_allclose(draw_residual(done, np.random.default_rng(1)), expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_walk_imitates_a_walk_and_seldom_a_ramp(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walk = rng.standard_normal(SAMPLES).cumsum()
    straight = ramp() + rng.standard_normal(SAMPLES)
    assert noise_imitates(completed(walk), "ramp-disturbance@output", 100, np.random.default_rng(2))
    assert not noise_imitates(completed(straight), "ramp-disturbance@output", 100, np.random.default_rng(2))


def test_a_sine_is_told_from_noise_of_long_memory() -> None:
    rng = np.random.default_rng(0)
    wave = 20.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / 300.0) + rng.standard_normal(SAMPLES)
    assert not noise_imitates(completed(wave), "sinusoidal-disturbance", 100, rng)


def test_the_share_left_is_that_of_least_squares_with_the_best_guess() -> None:
    residual = ramp() + np.random.default_rng(0).standard_normal(SAMPLES).cumsum()
    done, name = completed(residual), "ramp-disturbance@output"
    left = []
    for start in parse(name)[0].guess(done.model.context_of("output"))[:, 0]:  # type: ignore[misc]
        columns = np.stack([np.ones(SAMPLES), np.maximum(np.arange(SAMPLES) - start, 0.0)], axis=1)
        rest = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
        left.append(float(np.sum(rest**2)))
    share = min(left) / float(np.sum((residual - residual.mean()) ** 2))
    assert _share_left(done, name, residual, {}) == pytest.approx(share, rel=1e-6)


def scored(residual: np.ndarray[Any, Any], rmse: float, *, bic: float = 0.0, noise_alone: bool = False) -> Any:
    done = completed(residual)
    done.bic = bic
    done.gain_over = lambda other: other.bic - done.bic
    made = SimpleNamespace(done=done, rmse=rmse, noise_alone=noise_alone, full=True, held=None, _imitations={})
    made.imitates = MethodType(Scored.imitates, made)
    return made


@pytest.mark.parametrize(("name", "rmse", "noise_alone", "expected"), [
    ("ramp-disturbance@output", 1.0, False, True),
    ("ramp-disturbance@output", 20.0, False, False),  # (it takes less than half of the free run)
    ("ramp-disturbance@output", 1.0, True, False),  # (there is noise alone without it)
    ("travel-limit", 1.0, False, False)])
def test_only_a_disturbance_that_takes_half_of_more_than_noise_may_last(name: str, rmse: float, noise_alone: bool,
                                                                        expected: bool) -> None:
    straight = ramp() + np.random.default_rng(0).standard_normal(SAMPLES)
    parent = scored(straight, 24.0, noise_alone=noise_alone)
    assert outlasts_noise(name, scored(straight, rmse), parent, POLICY) is expected
    walk = np.random.default_rng(0).standard_normal(SAMPLES).cumsum()
    assert not outlasts_noise(name, scored(walk, rmse), scored(walk, 24.0), POLICY)


@pytest.mark.parametrize(("failing", "named"), [
    (("gain",), True), (("gain", "held-out"), True), (("gain", "kick"), False), ((), True)])
def test_a_drift_that_lasts_passes_the_gates_of_the_one_step_error_alone(
        failing: tuple[str, ...], named: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gates, "GATES", tuple((name, lambda edge, why=name * (name in failing): why)
                                              for name, _ in gates.GATES))
    straight = ramp() + np.random.default_rng(0).standard_normal(SAMPLES)
    edge: Any = Edge("ramp-disturbance@output", scored(straight, 1.0), scored(straight, 24.0), POLICY)
    found = judge_edge(edge)
    assert all(g.passed for g in found) is named
    assert any(g.name == LASTS for g in found) is (named and bool(failing))


@pytest.mark.parametrize(("process", "blurred", "gain", "named"), [
    (INTEGRATOR, True, 0.01, True),  # (a slip lost for half a cycle shifts y by 1.5, and the ramp by more)
    (INTEGRATOR, True, 1.0, False),  # (it shifts y by 150)
    (INTEGRATOR, False, 1.0, True), (FIRST_ORDER, True, 1.0, True)])
def test_under_unseen_scans_a_drift_of_an_integrator_must_explain_more_than_a_slip(
        process: str, blurred: bool, gain: float, named: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gates, "GATES", (("gain", lambda edge: "it gains too little"),))
    straight = ramp() + np.random.default_rng(0).standard_normal(SAMPLES)
    child = scored(straight, 1.0)
    child.done.model.spec, child.done.model.period_s = Spec(process=process), 60.0
    child.done.evaluated.gain, child.done.evaluated.values = gain, {"S": 5.0}
    edge: Any = Edge("ramp-disturbance@output", child, scored(straight, 24.0), POLICY, blurred=blurred)
    assert all(g.passed for g in judge_edge(edge)) is named


def test_a_drift_that_lasts_ranks_its_margin_above_its_parent_and_so_do_its_children() -> None:
    """A child without it, found when it was left out, gets no credit."""
    straight, said = ramp(), (Gate(LASTS, True, "it lasts"),)
    spec = Spec()
    drift = Spec(effects=("ramp-disturbance@output",))
    both = Spec(effects=("ramp-disturbance@output", "travel-limit"))
    other = Spec(effects=("travel-limit",))
    root = Entry(spec, scored(straight, 24.0, bic=0.0))
    named = Entry(drift, scored(straight, 1.0, bic=27.0), key(spec), ADD, drift.effects[0], gates=said)
    more = Entry(both, scored(straight, 1.0, bic=5.0), key(drift), ADD, "travel-limit")
    less = Entry(other, scored(straight, 23.0, bic=1.0), key(both), DROP, drift.effects[0])
    memo = {key(e.spec): e for e in (root, named, more, less)}
    assert [e.credit(memo, POLICY) for e in (root, named, more, less)] == [0.0, POLICY.margin + 27.0,
                                                                            POLICY.margin + 27.0, 0.0]
    assert rank_entries(memo, POLICY) == [more, named, root, less]
