"""How kernels are compiled: numba, cached beside the source, never fastmath; the cache may be absent.

House rule: a kernel never calls another file's kernel. Numba's cache would keep the old callee after that file
changed (measured), and a loop that takes a compiled function as an argument recompiles in every process.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Candidates are evaluated in blocks of at most this many: enough to hide that each valve waits for its own last step,
# and one row of every state still fits in L1.
LANES = 64
# Candidates are filled up to a multiple of this, so that no loop over them ends in single steps.
FULL = 8
# A table that a kernel goes through again and again begins where a line of the cache does, this many numbers long: the
# widest vector loads are as long, and one that reaches over two lines costs twice (measured: 76 instead of 109 µs for
# 4,000 commands of a law). As many numbers more are asked for, and those before the line are left out.
LINE = 8
# Larger arrays than this are not kept. Unit: numbers; four blocks of a search.
_KEPT = 1 << 22

_own = threading.local()

Compiled = TypeVar("Compiled", bound=Callable[..., Any])


def kernel(function: Compiled) -> Compiled:
    """Compile `function`; numba caches the machine code on disk where some folder can be written.

    `error_model="numpy"` lets a division by zero give inf, which the cost turns into "rejected", instead of
    raising out of a loop over many candidates.
    """
    try:
        compiled: Compiled = njit(cache=True, error_model="numpy")(function)
    except RuntimeError:
        # A read-only install without a home folder has no place for a cache: compile in memory every time.
        compiled = njit(error_model="numpy")(function)
    return compiled


def scratch(name: str, rows: int, lanes: int) -> NDArray[np.float64]:
    """An array (rows, lanes) of undefined numbers that lives until the next call with this name in this thread.

    A search asks for the same few arrays thousands of times, and fresh ones of this size come from the system page by
    page: more time than the arithmetic on them (measured). What is lent must be used up before the lender is called
    again; whoever keeps a result asks for an array of its own.
    """
    size = rows * lanes
    if size > _KEPT:
        return _aligned(size).reshape(rows, lanes)
    kept: NDArray[np.float64] | None = getattr(_own, name, None)
    if kept is None or kept.size < size:
        kept = _aligned(size)
        setattr(_own, name, kept)
    return kept[:size].reshape(rows, lanes)


def output(name: str, rows: int, lanes: int, lent: bool) -> NDArray[np.float64]:
    """A result of a kernel: lent (see `scratch`), or the caller's to keep."""
    return scratch(name, rows, lanes) if lent else _aligned(rows * lanes).reshape(rows, lanes)


def _aligned(size: int) -> NDArray[np.float64]:
    """Undefined numbers (size,) that begin at a line of the cache."""
    room = np.empty(size + LINE)
    first = -(room.ctypes.data // 8) % LINE
    return room[first:first + size]
