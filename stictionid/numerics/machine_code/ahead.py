"""Compilation of the kernels that `identify` needs by several processes, where they are on no disk yet.

The first kernel that is absent starts helpers, one for each further core. They compile the list of `needed.py`, while
the command compiles what it asks for. A helper ends with its list, or with the process that started it.

Run by a helper: python -m stictionid.numerics.machine_code.ahead SHARE SHARES PARENT
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .needed import NEEDED, PLAIN

# More helpers would each compile little beside their own start.
_MOST_HELPERS = 4
# Set in the environment of a helper, which starts none of its own; a user may set it to have none at all.
ALONE = "STICTIONID_COMPILE_ALONE"
_started: list[subprocess.Popen[bytes]] = []
_asked = [False]
# Called where a kernel is on no disk yet and is compiled now: True for those that a plain record needs. A progress says
# so.
listeners: list[Callable[[bool], None]] = []


def begin(function: Callable[..., Any], signature: Any) -> None:
    """Tell the listeners that a kernel is absent; start helpers, once a process, where it is one of the list."""
    name = name_of(function, signature)
    for heard in tuple(listeners):
        heard(name in NEEDED[:PLAIN])
    if name not in NEEDED or _asked[0] or ALONE in os.environ or not sys.executable:
        return
    _asked[0] = True
    helpers = min(_cores() - 1, _MOST_HELPERS)
    package = Path(__file__).resolve().parents[2]
    paths = [str(package.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    env = {**os.environ, ALONE: "1", "PYTHONPATH": os.pathsep.join(paths)}
    for share in range(helpers):
        words = [sys.executable, "-P", "-m", __name__, str(share), str(helpers), str(os.getpid())]
        with contextlib.suppress(OSError):
            _started.append(subprocess.Popen(words, env=env, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                             stderr=subprocess.DEVNULL))
    atexit.register(_end)


def _end() -> None:
    for helper in _started:
        with contextlib.suppress(OSError):
            helper.terminate()
    for helper in _started:
        helper.wait()


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def name_of(function: Callable[..., Any], signature: Any) -> str:
    """A line of the list: module and name of a kernel, and its arguments; "" where the list can't hold them."""
    try:
        words = [_word(argument) for argument in signature]
    except (AttributeError, TypeError, ValueError, NotImplementedError):
        return ""
    return " ".join([f"{function.__module__}.{function.__qualname__}", *words])


def _word(argument: Any) -> str:
    """A numba type: the letter of its dtype, and of an array its dimensions, its layout, and r where it is read-only.
    """
    from numba.core.types import Array
    from numba.np.numpy_support import as_dtype

    if isinstance(argument, Array):
        return f"{as_dtype(argument.dtype).char}{argument.ndim}{argument.layout}{'' if argument.mutable else 'r'}"
    return as_dtype(argument).char


def type_of(word: str) -> Any:
    """The numba type of a word of the list."""
    from numba.core.types import Array
    from numba.np.numpy_support import from_dtype

    kind = from_dtype(np.dtype(word[0]))
    if len(word) == 1:
        return kind
    layout: Any = word[2]
    return Array(kind, int(word[1]), layout, readonly=word.endswith("r"))


def kernels(lines: tuple[str, ...] = NEEDED) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Kernels of the list with their signatures; what is no longer in the package is left out."""
    for line in lines:
        name, *words = line.split()
        module, _, function = name.rpartition(".")
        with contextlib.suppress(ImportError, AttributeError):
            yield getattr(importlib.import_module(module), function), tuple(map(type_of, words))


def compile_share(share: int, shares: int, alive: Callable[[], bool]) -> int:
    """Compile every so manieth kernel of the list that is not on disk; the number of those compiled."""
    done = 0
    for kernel, signature in kernels(NEEDED[share::shares]):
        if not alive():
            break
        cache: Any = getattr(kernel, "_cache", None)
        if hasattr(cache, "holds") and not cache.holds(signature, kernel.targetctx):
            kernel.compile(signature)
            done += 1
    return done


if __name__ == "__main__":
    compile_share(int(sys.argv[1]), int(sys.argv[2]), lambda: os.getppid() == int(sys.argv[3]))
