"""Numba set-up of the kernels (cached beside the source, never fastmath), and the scratch arrays they share.

House rule: a kernel never calls another file's kernel. Numba's cache would keep the old callee after that file
changed (measured). A loop that takes a compiled function as an argument recompiles in every process.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numba import njit
from numpy.typing import NDArray

# Versions of numba whose private parts are known to serve (tested: the first and the last). Any other keeps its own
# cache, which is right everywhere and slower to read.
_KNOWN = (0, 60), (0, 68)

try:
    if not _KNOWN[0] <= tuple(map(int, numba.__version__.split(".")[:2])) <= _KNOWN[1]:
        raise ImportError(f"numba {numba.__version__} was not tried")
    from .machine_code.kept import Kept as _Cache
except ImportError:
    from numba.core.caching import FunctionCache as _Cache  # type: ignore[no-redef]

# Largest number of candidates in one block of a kernel. So many hide the latency of each valve's recursion, and one row
# of every state still fits in L1.
LANES = 64
# The number of candidates is filled up to a multiple of this, so that vector loops have no remainder.
FULL = 8
# Length of a cache line in numbers. Tables that a kernel reads repeatedly begin at a line: the widest vector loads are
# as long, and one that crosses two lines costs twice (measured: 76 instead of 109 µs for 4,000 commands of a law). An
# array is asked for with so many numbers more, and those before the line are left out.
LINE = 8
# Size of the largest scratch array that is kept. Unit: numbers; four blocks of a search.
_KEPT = 1 << 22

_own = threading.local()

Compiled = TypeVar("Compiled", bound=Callable[..., Any])


def kernel(function: Compiled) -> Compiled:
    """Compile `function`; numba caches the machine code on disk where some folder can be written.

    `error_model="numpy"` lets a division by zero give inf, which the cost turns into "rejected", instead of
    raising out of a loop over many candidates.
    """
    compiled: Compiled = njit(error_model="numpy")(function)
    # A read-only install without a home folder has no place for a cache: compile in memory every time.
    with contextlib.suppress(RuntimeError):
        compiled._cache = _Cache(function)  # type: ignore[attr-defined]
        # Numba's extensions only matter to its compiler.
        compiled._compilation_chain_init_hook = lambda: None  # type: ignore[attr-defined]
    return compiled


def scratch(name: str, rows: int, lanes: int) -> NDArray[np.float64]:
    """An array (rows, lanes) of undefined numbers that lives until the next call with this name in this thread.

    A search asks for the same few arrays thousands of times. Fresh ones of this size come from the system page by page,
    which takes more time than the arithmetic on them (measured). The content must be used before the next call with the
    same name. A caller that keeps a result allocates an array of its own.
    """
    size = rows * lanes
    if size > _KEPT:
        return _aligned_array(size).reshape(rows, lanes)
    kept: NDArray[np.float64] | None = getattr(_own, name, None)
    if kept is None or kept.size < size:
        kept = _aligned_array(size)
        setattr(_own, name, kept)
    return kept[:size].reshape(rows, lanes)


def output(name: str, rows: int, lanes: int, lent: bool) -> NDArray[np.float64]:
    """Array for the result of a kernel: scratch where `lent` (see `scratch`), else one that the caller may keep."""
    return scratch(name, rows, lanes) if lent else _aligned_array(rows * lanes).reshape(rows, lanes)


def _aligned_array(size: int) -> NDArray[np.float64]:
    """Undefined numbers (size,) that begin at a cache line."""
    room = np.empty(size + LINE)
    first = -(room.ctypes.data // 8) % LINE
    return room[first:first + size]
