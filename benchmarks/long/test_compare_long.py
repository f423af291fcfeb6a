"""Compare at length: coloured noise is no fault, whatever the seed."""

from __future__ import annotations

from test_compare import coloured


def test_coloured_noise_is_called_coloured_and_nothing_else() -> None:
    assert coloured(1, 2) == {"residual-coloured"}
