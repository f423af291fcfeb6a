"""Oscillations at length: records of uneven turns that no model explains."""

from __future__ import annotations

import numpy as np
import pytest

from stictionid.record.loop import Loop
from stictionid.record.oscillation import BY_TURNS, find_range
from stictionid.verbs.identify import identify


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
