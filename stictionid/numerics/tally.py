"""Count of the samples that candidates were evaluated on in this process, by which searches are limited.

A sample of a command with parts between the samples counts for as many as half of its parts, and a half: the valve sees
every part, the least squares every sample.
"""

from __future__ import annotations

from collections.abc import Callable

_count = [0]
# Called after each count, such as a progress that shows that a long search still runs.
listeners: list[Callable[[], None]] = []


def add(candidates: int, samples: int, parts: int = 1) -> None:
    """Count so many candidates, each on so many samples of so many parts."""
    _count[0] += candidates * samples * (1 + parts) // 2
    for heard in listeners:
        heard()


def charge(samples: int) -> None:
    """Count what a remembered answer took when it was found: no limit may depend on what this process remembers."""
    _count[0] += samples


def spent() -> int:
    """The samples evaluated since the process began."""
    return _count[0]


def take_back(before: int) -> None:
    """Count as spent what was spent `before`: a search that is made once for a record has limits of its own."""
    _count[0] = before
