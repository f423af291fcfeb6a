"""The turn of one process among several that would compile the same kernel: a lock on a file beside its machine code.

A process that ends gives its turn back. Where files can't be locked, every process has its turn at once.
"""

from __future__ import annotations

import os

from ...system.files import locked


class Turn:
    """The lock of one kernel, not held at first."""

    def __init__(self) -> None:
        self._handle: int | None = None

    def take(self, beside: str) -> None:
        """Wait for the turn at the kernel whose files are named after `beside`."""
        self.give()
        self._handle = locked(f"{beside}.lock")

    def taken(self, beside: str) -> bool:
        """True where another process has the turn now."""
        try:
            handle = locked(f"{beside}.lock", wait=False)
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
