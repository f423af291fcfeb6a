"""Plateaus at length: the end of a fit, and its interval, beside asymmetric stiction."""

from __future__ import annotations

import test_plateau


def test_every_point_of_a_plateau_ends_in_its_middle() -> None:
    test_plateau.test_every_point_of_a_plateau_ends_in_its_middle("asymmetric-stiction")


def test_an_interval_is_as_wide_as_the_curvature_of_the_likelihood_allows() -> None:
    test_plateau.test_an_interval_is_as_wide_as_the_curvature_of_the_likelihood_allows("asymmetric-stiction", 23)
