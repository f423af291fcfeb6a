"""One thread of BLAS while a verb works, unless the environment asks for another number.

The matrices of a loop are small, so that several threads mostly wait for each other. The command line sets the
environment before numpy loads; a notebook has loaded numpy long before, so its libraries are limited while they run.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable

from .messages import P, R

# Variables by which a user asks for a number of threads.
ASKED = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "OMP_NUM_THREADS")


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """The function with BLAS limited to one thread while it runs; the number before is put back."""
    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        if any(name in os.environ for name in ASKED):
            return function(*args, **kwargs)
        # numba calls the BLAS of scipy, which must be loaded to be limited.
        import scipy.linalg.cython_blas  # noqa: F401
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)
    return wrapped
