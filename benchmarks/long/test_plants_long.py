"""Plants at length: the same seed gives the same record."""

from __future__ import annotations

import numpy as np
from plants.design import design
from plants.draw import drawn


def test_same_seed_same_record():
    row, effects = design("one", 1, 3)[0]
    first, again, other = drawn(row, effects, 5), drawn(row, effects, 5), drawn(row, effects, 6)
    for name in ("r", "u", "y", "stem"):
        assert np.array_equal(getattr(first.record, name), getattr(again.record, name))
    assert first.truth == again.truth
    assert not np.array_equal(first.record.y[:100], other.record.y[:100])
