"""Laws at length: a positioner that integrates is its twin under each law and each command."""

from __future__ import annotations

import pytest
import test_laws


@pytest.mark.parametrize(("law", "moving"), [("chen", True), ("kano", False), ("kano", True), ("stenman", True)])
def test_a_positioner_that_integrates_is_its_twin_under_any_law(law: str, moving: bool) -> None:
    test_laws.test_a_positioner_that_integrates_is_its_twin_under_any_law(law, moving)
