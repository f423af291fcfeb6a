"""Machine code at length: the kernels that whole sample loops ask for."""

from __future__ import annotations

import subprocess
import sys

import pytest
from test_machine_code import ROOT

from stictionid.numerics.machine_code.needed import NEEDED


@pytest.mark.parametrize("rows", [None, 200])
def test_identify_asks_for_the_kernels_of_the_list(rows: int | None) -> None:
    """A part of each sample loop asks for the same kernels as the whole."""
    assert asked(rows) == set(NEEDED), "run benchmarks/kernels.py"


def asked(rows: int | None) -> set[str]:
    """Kernels that a process asks for which identifies so many first samples of each sample loop, or all."""
    code = f"import sys; sys.path.insert(0, 'benchmarks'); import kernels; print('\\n'.join(kernels.used({rows})[0]))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines())
