"""Choice of the segments of a record that are identified together, each long enough for an estimate.

A stretch that does not count (manual, frozen, saturated) for a period or longer is a gap, too: the valve may be known
there, but what moved the process is not, and it seldom ends at the level at which it began. A shorter one is run
through with the recorded output. Where only the process value is missing the loop ran on and the output says how: such
a stretch is run through up to MOST_MISSED_PERIODS.

Segments are never joined to one run: a model restarts in each with an unknown valve force, level and start-up
(model/segments.py). A segment shorter than two periods mostly shows its own unknown start. Each further segment adds a
number to the search. Source: docs/details.md, section 6.1; docs/traps.md, export trap 12.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .loop import Finding, Loop
from .oscillation import find_range

# Largest number of segments that are identified together, and least number of periods in each.
MOST, FEWEST_PERIODS = 4, 2.0
# The longest stretch without a process value that is run through. Unit: periods.
MOST_MISSED_PERIODS = 5.0
# A run of samples that do not count is no gap if it is shorter, whatever the period. Unit: samples.
_FEWEST_MASKED = 10
_ALONE = ("severity, causes, the fit to a measured position and methods other than auto look at the longest of them "
          "alone")


def chosen(loop: Loop, *, restarts: bool = True) -> tuple[Loop, tuple[Finding, ...]]:
    """The segments to identify, as one loop, and findings about the others.

    Up to MOST segments of at least FEWEST_PERIODS periods are chosen, longest first, and kept in the order of time.
    Without `restarts`, or where fewer than two are long enough, the longest alone.
    """
    whole = len(loop.starts) == 1
    if whole and not (restarts and max(_masked(loop, loop.segments[0])[1], default=0) >= _FEWEST_MASKED):
        return loop, ()
    longest = loop.longest_segment()
    if not restarts:
        return longest, (_longest(loop, longest, "this method does not restart its model"),)
    period_s = find_range(loop).period_median_s
    if period_s is None:
        return longest, () if whole else (_longest(loop, longest, "no period is known by which to choose others"),)
    parts = _stretches(loop, period_s)
    driven = loop.driven
    sized = [(int(driven[p].sum()), p) for p in parts]
    enough = [(used, p) for used, p in sized if used * loop.step_s >= FEWEST_PERIODS * period_s]
    if len(enough) < 2 and whole:
        return loop, ()
    if len(enough) < 2:
        return longest, (_longest(loop, longest, f"the others are shorter than {FEWEST_PERIODS:g} periods of "
                                                 f"{period_s:.4g} s"),)
    kept = sorted((p for _, p in sorted(enough, key=lambda e: -e[0])[:MOST]), key=lambda p: p.start)
    piece = loop.pick(kept)
    share = piece.samples / loop.samples
    rest = len(parts) - len(kept)
    left = f"; {rest} more {'is' if rest == 1 else 'are'} left out (at most {MOST} are used, each of " \
           f"{FEWEST_PERIODS:g} periods or more)" if rest else ""
    return piece, (Finding(
        "segments-restarted", "info",
        f"{len(kept)} of {len(parts)} segments are used together, {piece.samples} of {loop.samples} samples "
        f"({100 * share:.0f} %), the model restarted in each with its own valve force, level and start-up{left}; "
        f"{_ALONE}",
        {"segments": len(parts), "used": len(kept), "rows": [[p.start, p.stop - p.start] for p in kept],
         "samples": piece.samples, "of": loop.samples}, (), "docs/details.md, section 6.1"),)


def _masked(loop: Loop, part: slice) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First samples and lengths (k,) of the runs inside a segment, not at its ends, that do not count."""
    edges = np.flatnonzero(np.diff(loop.used[part].astype(np.int8)))
    if loop.used[part.start] == 0:
        edges = edges[1:]
    edges = edges[:edges.size // 2 * 2].reshape(-1, 2) + 1 + part.start
    return edges[:, 0], edges[:, 1] - edges[:, 0]


def _stretches(loop: Loop, period_s: float) -> list[slice]:
    """The segments of a record, cut where samples do not count for a period or longer."""
    found = []
    for part in loop.segments:
        firsts, lengths = _masked(loop, part)
        missed = np.array([loop.driven[a:a + n].all() for a, n in zip(firsts.tolist(), lengths.tolist(), strict=True)],
                          bool)
        least = np.where(missed, MOST_MISSED_PERIODS, 1.0) * period_s
        long = lengths * loop.step_s >= np.maximum(least, _FEWEST_MASKED * loop.step_s)
        begins = [part.start, *(firsts + lengths)[long].tolist()]
        found += [slice(a, b) for a, b in zip(begins, [*firsts[long].tolist(), part.stop], strict=True)]
    return found


def _longest(loop: Loop, piece: Loop, why: str) -> Finding:
    return Finding("longest-segment", "info",
                   f"the record has {len(loop.starts)} stretches; the longest, {piece.samples} of {loop.samples} "
                   f"samples, is used: {why}", {"segments": len(loop.starts)})


def fitted_segments(loop: Loop, description: Mapping[str, Any]) -> tuple[Loop, tuple[slice, ...]]:
    """Segments of a record that a described model was fitted to, as one loop, and their positions in the record.

    DataError where the record does not have them.
    """
    rows = description.get("segments")
    if not rows:
        return loop.longest_segment(), (loop.longest,)
    try:
        pieces = tuple(slice(int(first), int(first) + int(count)) for first, count in rows)
    except (TypeError, ValueError):
        raise DataError(f"the study is damaged: its model's segments are {rows!r:.60}",
                        "run stictionid identify again") from None
    missing = [p for p in pieces if not any(whole.start <= p.start < p.stop <= whole.stop for whole in loop.segments)]
    if missing:
        raise DataError(f"the study's model was fitted to samples {missing[0].start} to {missing[0].stop - 1} as one "
                        f"segment, which the record does not have", "run stictionid identify again")
    return loop.pick(pieces), pieces
