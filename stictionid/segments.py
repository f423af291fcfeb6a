"""Which segments of a record are identified together: what lies between its gaps, each long enough to say something.

Segments are never glued: a model restarts in each with an unknown valve force, level and start-up (restarts.py). A
segment shorter than two periods mostly shows its own unknown start, and each further one adds a number to the search.
Source: METHODS.md section 4 (trap 1, the unknown start); HISTORIAN.md item 3.12 (gaps).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .errors import DataError
from .loop import Finding, Loop
from .oscillation import find_range

# Most segments that are identified together, and the least periods that each must hold.
MOST, FEWEST_PERIODS = 4, 2.0
_ALONE = ("severity, causes, the fit to a measured position and methods other than auto look at the longest of them "
          "alone")


def chosen(loop: Loop, *, restarts: bool = True) -> tuple[Loop, tuple[Finding, ...]]:
    """The segments that are identified, as one loop, and what must be said of the others.

    Up to MOST of at least FEWEST_PERIODS periods, longest first, in the order of time; without `restarts`, or where
    only one is long enough, the longest alone.
    """
    if len(loop.starts) == 1:
        return loop, ()
    longest = loop.longest_segment()
    if not restarts:
        return longest, (_longest(loop, longest, "this method does not restart its model"),)
    period_s = find_range(loop).period_median_s
    if period_s is None:
        return longest, (_longest(loop, longest, "no period is known by which to choose others"),)
    sized = [(int(loop.used[p].sum()), p) for p in loop.segments]
    enough = [(used, p) for used, p in sized if used * loop.step_s >= FEWEST_PERIODS * period_s]
    if len(enough) < 2:
        return longest, (_longest(loop, longest, f"the others are shorter than {FEWEST_PERIODS:g} periods of "
                                                 f"{period_s:.4g} s"),)
    kept = sorted((p for _, p in sorted(enough, key=lambda e: -e[0])[:MOST]), key=lambda p: p.start)
    piece = loop.pick(kept)
    share = piece.samples / loop.samples
    rest = len(loop.starts) - len(kept)
    left = f"; {rest} more {'is' if rest == 1 else 'are'} left out ({MOST} of {FEWEST_PERIODS:g} periods or more are " \
           "the most)" if rest else ""
    return piece, (Finding(
        "segments-restarted", "info",
        f"{len(kept)} of {len(loop.starts)} segments are used together, {piece.samples} of {loop.samples} samples "
        f"({100 * share:.0f} %), the model restarted in each with its own valve force, level and start-up{left}; "
        f"{_ALONE}",
        {"segments": len(loop.starts), "used": len(kept), "rows": [[p.start, p.stop - p.start] for p in kept],
         "samples": piece.samples, "of": loop.samples}, (), "METHODS.md section 4, trap 1"),)


def _longest(loop: Loop, piece: Loop, why: str) -> Finding:
    return Finding("longest-segment", "info",
                   f"the record has {len(loop.starts)} stretches; the longest, {piece.samples} of {loop.samples} "
                   f"samples, is used: {why}", {"segments": len(loop.starts)})


def described(loop: Loop, description: Mapping[str, Any]) -> tuple[Loop, tuple[slice, ...]]:
    """The segments of a record that a described model was fitted to, as one loop, and where they are in the record.

    DataError where the record does not have them.
    """
    rows = description.get("segments")
    if not rows:
        return loop.longest_segment(), (loop.longest,)
    pieces = tuple(slice(int(first), int(first) + int(count)) for first, count in rows)
    missing = [p for p in pieces if p not in loop.segments]
    if missing:
        raise DataError(f"the study's model was fitted to samples {missing[0].start} to {missing[0].stop - 1} as one "
                        f"segment, which the record does not have", "run stictionid identify again")
    return loop.pick(pieces), pieces
