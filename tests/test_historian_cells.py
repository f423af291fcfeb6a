"""Cells read one by one and as whole columns give the same numbers; texts that only look like units are none."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stictionid.historian.words import cells
from stictionid.historian.words.cells import to_numbers

PIECES = st.sampled_from(
    ["1", "12", "1.5", "1,5", ".", ",", " ", "'", "\u00a0", "−", "-", "+", "e", "E+", "5", "000", "%", "bar", "m3/h",
     '="', '"', "²", "x", "Bad", "°C", "1.234,5", "1,234.5", ""])


@settings(max_examples=300, deadline=None)
@given(st.lists(st.lists(PIECES, max_size=5).map("".join), min_size=1, max_size=6), st.sampled_from(".,"))
def test_few_and_many_cells_are_read_alike(texts, decimal):
    column = pa.array(texts, pa.string())
    few = to_numbers(column, decimal)
    before, cells.FEW_CELLS = cells.FEW_CELLS, -1
    try:
        many = to_numbers(column, decimal)
    finally:
        cells.FEW_CELLS = before
    np.testing.assert_array_equal(few.values, many.values)
    assert few.words == many.words


@pytest.mark.parametrize("few", [2000, -1])
def test_exponents_and_hex_are_not_numbers_with_units(monkeypatch, few):
    monkeypatch.setattr(cells, "FEW_CELLS", few)
    found = to_numbers(pa.array(["1e5", "31e3", "0x10", "7 bar", "5 ea", "Bad", "1e300"]))
    np.testing.assert_array_equal(found.values, [1e5, 31e3, np.nan, 7.0, 5.0, np.nan, np.nan])
    assert found.words == {"0x10": 1, "Bad": 1, "beyond 1e+38": 1}
