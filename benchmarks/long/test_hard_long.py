"""Numbers that break arithmetic at length: files whose bad cells are left out are identified whole."""

from __future__ import annotations

import pytest
import test_hard


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["NaN in PV", "one PV of 1e300"])
def test_a_file_with_a_few_bad_cells_ends_in_a_reason(name: str) -> None:
    test_hard.test_numbers_that_break_arithmetic_end_in_a_reason(name, True)
