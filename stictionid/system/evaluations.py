"""Count of the samples that candidates were evaluated on in this process, by which searches are limited.

A sample of a command with parts between the samples counts for as many as half of its parts, and a half: the valve sees
every part, the least squares every sample.
"""

from __future__ import annotations

from collections.abc import Callable

_count = [0]
# Questions answered, by their fingerprints, with the samples that each took.
_answers: dict[str, int] = {}
# Called after each count, such as a progress that shows that a long search still runs.
listeners: list[Callable[[], None]] = []


def add(candidates: int, samples: int, parts: int = 1) -> None:
    """Count so many candidates, each on so many samples of so many parts."""
    _count[0] += candidates * samples * (1 + parts) // 2
    for heard in listeners:
        heard()


def note_answer(question: str, samples: int) -> None:
    """Note what a question took when it was answered, now or before; a search counts each of its questions once."""
    _answers[question] = samples


def answers() -> dict[str, int]:
    """The questions answered since this was called last, and the samples that each took."""
    found = dict(_answers)
    _answers.clear()
    return found


def samples_spent() -> int:
    """The samples evaluated since the process began."""
    return _count[0]


def take_back(before: int) -> None:
    """Count as spent what was spent `before`: what is counted elsewhere, or made once for a record."""
    _count[0] = before
