"""Compare at length: coloured noise is no fault, whatever the seed, and four effects are suspected."""

from __future__ import annotations

import pytest
from quick_loops import HELD
from test_compare import setting

from stictionid.comparison import compare
from stictionid.model.closed_loop import simulate
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.verbs.identify import identify


@pytest.mark.parametrize("seeds", [(2,), (1, 2)])
def test_coloured_noise_is_called_coloured_and_nothing_else(seeds: tuple[int, ...]) -> None:
    assert coloured(*seeds) == {"residual-coloured"}


def base_of(effect: str, **values: float) -> tuple[Loop, Study]:
    """A simulated loop with one effect, and the study of its base model, which lacks it."""
    loop = simulate(setting(effects=((effect, values),), setpoint_moves=((0.0, 5.0), (450.0, -6.0))), seed=0).loop
    return loop, identify(loop, options=HELD)


@pytest.mark.parametrize(("effect", "values"), [
    ("valve-characteristic", {"log_rangeability": 3.5}), ("travel-limit", {"upper": 51.5}),
    ("gain-drift", {"drift": -44.4}), ("sinusoidal-disturbance", {"period_s": 30.0, "amplitude": 1.4})])
def test_the_effect_that_is_missing_is_among_the_suspects_shown(effect: str, values: dict[str, float]) -> None:
    suspects = compare(*base_of(effect, **values)).suspects
    assert effect in [s.effect for s in suspects[:3]]
    first = suspects[0]
    assert first.gain_expected and "% of the" in first.speaks_for



def coloured(*seeds: int) -> set[str]:
    """Codes of all findings of clean loops with coloured noise."""
    codes = set()
    for seed in seeds:
        noise = (("coloured-noise", {"root": 0.8, "innovation_sd": 0.05}),)
        loop = simulate(setting(effects=noise, noise_sd=0.0), seed=seed).loop
        found = compare(loop, identify(loop, options=HELD))
        codes |= {f.code for f in found.findings}
        assert found.error.effective_rows < 0.5 * found.error.rows
    return codes
