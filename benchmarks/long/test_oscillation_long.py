"""Oscillations at length: records of uneven turns that no model explains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_oscillation import _wandering

from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.record.oscillation import BY_TURNS, FEWEST_TURNS, find_range
from stictionid.verbs.identify import Options, identify


@pytest.mark.parametrize("seed", [2, 13])
def test_a_record_of_uneven_turns_that_no_model_explains_is_not_judged(seed: int) -> None:
    """Output and process value wander apart from each other: nothing is said of the valve."""
    rng = np.random.default_rng(seed)
    u, y = (np.cumsum(np.convolve(x, np.hanning(30) / 15.0, "valid"))[:900] for x in rng.standard_normal((2, 2000)))
    loop = Loop(output=50.0 + 20.0 * u / np.ptp(u), process_value=y + 0.01 * rng.standard_normal(y.size))
    assert find_range(loop).reference == BY_TURNS
    study = identify(loop)
    assert study.estimate is None and study.verdict.stiction == "undecided"
    reason = study.verdict.reason
    assert ("uneven distances" in reason and "times the noise" in reason) or "explains nothing" in reason \
        or "does not answer the output" in reason



def test_a_wandering_mean_gives_an_answer_that_is_not_sure() -> None:
    study = identify(_wandering(5, 3.0), options=Options(intervals=False))
    assert study.verdict.stiction == "stiction" and study.verdict.confidence <= 0.6
    assert "turning points" in study.verdict.reason
    assert abs(study.estimate.S - 3.0) <= 0.1


@pytest.mark.parametrize("seed", [8, 22])
def test_uneven_turns_without_a_setpoint_give_an_answer_that_is_not_sure(seed: int) -> None:
    """Setpoint moves at random times, not exported: no two cycles are alike."""
    rng = np.random.default_rng([seed, 78])
    at, size = np.sort(rng.uniform(0, 1235, 14)), rng.choice([-1.0, 1.0], 14) * rng.uniform(3.0, 8.0, 14)
    setting = Setting(Plant(1.2, 20.0, 8.0), Controller(0.7, 20.0, scan_s=1.0), 2.0, 1.0, duration_s=1235.0,
                      noise_sd=0.05, setpoint_moves=tuple(zip(at.tolist(), size.tolist(), strict=True)))
    loop = replace(simulate(setting, seed=1).loop, setpoint=None, position=None)
    study = identify(loop, options=Options(intervals=False))
    assert study.range.reference == BY_TURNS and not study.range.oscillating
    assert "uneven distances" in study.range.reason and FEWEST_TURNS <= study.range.reversals <= 12
    assert study.estimate is not None and study.verdict.confidence <= 0.6
    assert study.verdict.stiction == "stiction" and abs(study.estimate.S / 2.0 - 1.0) <= 0.02
