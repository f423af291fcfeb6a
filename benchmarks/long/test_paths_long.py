"""Paths at length: the beam sums over all paths of further short records."""

from __future__ import annotations

import pytest
from test_paths import NOISES, beam_sums_over_all_paths, scattering

from stictionid.paths.any_valve import settle_from_any_valve


@pytest.mark.parametrize("rests", [False, True])
@pytest.mark.parametrize(("taps", "lands", "jitter"), NOISES)
def test_the_beam_sums_over_all_paths_and_finds_the_likeliest(rests: bool, taps: tuple[float, ...], lands: float,
                                                              jitter: float) -> None:
    beam_sums_over_all_paths(rests, taps, lands, jitter, range(1, 3))


def test_a_valve_is_found_from_far_off_with_a_scatter_that_shrinks():
    model, start = scattering(seed=8, scatter=0.06)
    start[:2] = 2.4, 0.4
    found = settle_from_any_valve(model, start, 0.0, (0.0, 0.0))
    assert found is not None
    assert found.values[0] == pytest.approx(4.0, rel=0.02)
    assert found.values[1] == pytest.approx(2.0, rel=0.05)
