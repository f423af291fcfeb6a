"""Machine code at length: the kernels that whole sample loops ask for."""

from __future__ import annotations

from test_machine_code import asked

from stictionid.numerics.machine_code.needed import NEEDED


def test_identify_asks_for_the_kernels_of_the_list() -> None:
    assert asked(None) == set(NEEDED), "run benchmarks/kernels.py"
