"""The turn of one process among several that would compile the same kernel: a lock on a file beside its machine code.

A process that ends gives its turn back. Where files can't be locked, every process has its turn at once.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


class Turn:
    """The lock of one kernel, not held at first."""

    def __init__(self) -> None:
        self._handle: int | None = None

    def take(self, beside: str) -> None:
        """Wait for the turn at the kernel whose files are named after `beside`."""
        self.give()
        self._handle = _locked(beside, wait=True)

    def taken(self, beside: str) -> bool:
        """True where another process has the turn now."""
        try:
            handle = _locked(beside, wait=False)
        except BlockingIOError:
            return True
        if handle is not None:
            os.close(handle)
        return False

    def give(self) -> None:
        """Let the next process have the turn."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


def _locked(beside: str, wait: bool) -> int | None:
    """An open file that is locked, None where there is no such lock; BlockingIOError where another has it."""
    try:
        import fcntl

        Path(beside).parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(f"{beside}.lock", os.O_RDWR | os.O_CREAT, 0o666)
    except (ImportError, OSError):
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        os.close(handle)
        raise
    except OSError:
        with contextlib.suppress(OSError):
            os.close(handle)
        return None
    return handle
