"""Compare at length: coloured noise is no fault, whatever the seed, and three more effects are suspected."""

from __future__ import annotations

import pytest
import test_compare
from test_compare import coloured


def test_coloured_noise_is_called_coloured_and_nothing_else() -> None:
    assert coloured(1, 2) == {"residual-coloured"}


@pytest.mark.parametrize(("effect", "values"), [("travel-limit", {"upper": 51.5}),
                                                ("gain-drift", {"drift": -44.4}),
                                                ("sinusoidal-disturbance", {"period_s": 30.0, "amplitude": 1.4})])
def test_the_effect_that_is_missing_is_among_the_suspects_shown(effect: str, values: dict[str, float]) -> None:
    test_compare.test_the_effect_that_is_missing_is_among_the_suspects_shown(effect, values)
