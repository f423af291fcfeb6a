"""Disturbances that a noise model of long memory holds as well: draws of that noise, and gates."""

from __future__ import annotations

import numpy as np
import pytest
from real_nodes import recorded, scored
from scipy.signal import lfilter

from stictionid.fit.noise.draws import draw_residual
from stictionid.model.spec import FIRST_ORDER, Spec
from stictionid.selection.gates import Edge, judge_edge
from stictionid.selection.policy import Policy
from stictionid.selection.score import Scored
from stictionid.typing import FloatArray

SAMPLES, POLICY, RAMP = 1200, Policy(), "ramp-disturbance@output"
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


def failed(edge: Edge) -> list[str]:
    gates = judge_edge(edge)
    # A gate that compares one number passes by that number: the free-run error lies below its limit, all else above.
    for g in gates:
        if g.statistic is not None:
            assert g.passed == ((g.statistic <= g.threshold) if g.name == "free-run" else g.statistic >= g.threshold)
    return [g.name for g in gates if not g.passed]


def test_a_ramp_passes_by_its_likelihood_beside_noise_of_long_memory() -> None:
    parent, child = with_ramp(ramp() + errors())
    assert not failed(Edge(RAMP, child, parent, POLICY))
    walk, late = with_ramp(errors(1.0))
    assert "gain" in failed(Edge(RAMP, late, walk, POLICY))


def test_beside_a_valve_that_may_follow_its_command_no_sine_is_named() -> None:
    parent, child = with_sine(1.5, FIRST_ORDER, S=0.02, J=0.01)
    edge = Edge(SINE, child, parent, POLICY, blurred=True)
    assert failed(edge) == ["friction"] and not failed(Edge(SINE, child, parent, POLICY))
    friction = next(g for g in judge_edge(edge) if g.name == "friction")
    assert friction.statistic == child.without_friction and friction.threshold == pytest.approx(1.05 * child.rmse)
