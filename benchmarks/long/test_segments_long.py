"""Records with gaps at length: three segments against the longest of them on six loops."""

from __future__ import annotations

import pytest
from test_segments import together_and_alone


@pytest.mark.parametrize("name", ["foptd", "itptd"])
def test_segments_together_tell_more_than_the_longest_alone(name: str) -> None:
    together_and_alone(name, range(3))
