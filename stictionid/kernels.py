"""How kernels are compiled: numba, cached beside the source, never fastmath; the cache may be absent.

House rule: a kernel never calls another file's kernel. Numba's cache would keep the old callee after that file
changed (measured), and a loop that takes a compiled function as an argument recompiles in every process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

# Fixed-width lanes: candidates are evaluated in blocks of this many, so that one row of every state fits in L1
# and a block of positions (n x 32 x 8 bytes) in L2 for records of about a thousand samples.
LANES = 32


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function`; numba caches the machine code on disk where some folder can be written.

    `error_model="numpy"` lets a division by zero give inf, which the cost turns into "rejected", instead of
    raising out of a loop over many candidates.
    """
    try:
        return njit(cache=True, error_model="numpy")(function)
    except RuntimeError:
        # A read-only install without a home folder has no place for a cache: compile in memory every time.
        return njit(error_model="numpy")(function)
