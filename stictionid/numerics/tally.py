"""Count of the samples that candidates were evaluated on in this process, by which searches are limited."""

from __future__ import annotations

_count = [0]


def add(candidates: int, samples: int) -> None:
    """Count so many candidates, each on so many samples."""
    _count[0] += candidates * samples


def spent() -> int:
    """The samples evaluated since the process began."""
    return _count[0]
