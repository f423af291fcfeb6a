"""Lock on an empty kernel cache: one worker compiles, the others wait instead of compiling the same.

The first worker of a machine holds a lock in the cache's folder during its first loop. A mark then says that the cache
is filled for this program, and later workers do not touch the lock. Where no folder can be written there is no cache to
share, and no lock either.
"""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...system.files import locked

# Levels of which this process has done a loop.
turns_taken: set[str] = set()


@contextmanager
def first_turn(level: str) -> Iterator[bool]:
    """Context of a worker's first loop; gives True to the worker that fills the cache."""
    folder = None if level in turns_taken else cache_folder()
    turns_taken.add(level)
    if folder is None:
        yield False
        return
    mark = folder / f".stictionid-warm-{_fingerprint(level)}"
    lock = None if mark.exists() else locked(folder / ".stictionid-warm.lock")
    if lock is not None and mark.exists():  # another worker has filled the cache meanwhile
        os.close(lock)
        lock = None
    if lock is None:
        yield False
        return
    try:
        yield True
        mark.touch()
    finally:
        os.close(lock)


def cold() -> bool:
    """True where a first loop compiles the kernels: their folder holds no machine code."""
    folder = cache_folder()
    return folder is not None and not any(folder.glob("*.nbc"))


def cache_folder() -> Path | None:
    """The folder of numba's machine code for the kernels; None where it has none."""
    from ...numerics.cross_products import products_kernel

    path = getattr(getattr(products_kernel, "stats", None), "cache_path", None)
    if not path:
        return None
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return Path(path) if os.access(path, os.W_OK) else None


def _fingerprint(level: str) -> str:
    """A fingerprint that changes with the machine code: source files, numba, Python, kind of processor."""
    import numba

    package = Path(__file__).resolve().parents[2]
    newest = max(p.stat().st_mtime_ns for p in package.rglob("*.py"))
    said = f"{level} {newest} {numba.__version__} {platform.python_version()} {platform.processor()} {package}"
    return hashlib.sha256(said.encode()).hexdigest()[:16]
