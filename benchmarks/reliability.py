"""Reliability of the confidence of verdicts: of the loops said with a confidence, the share that is right.

Run: python benchmarks/reliability.py ROWS.jsonl…
Rows are those of verdicts.py --out, half_real.py and isdb.py: `truth`, `verdict`, `confidence`. Undecided loops have
no confidence to test and are counted beside. Target: in bins of at least 100 loops nowhere more than 5 points below
the confidence said. Exit 1 where a bin misses it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import rows as store

EDGES = (0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
"""Bounds of the bins of confidence."""
FEWEST, MOST_POINTS = 100, 0.05


def table(found: Iterable[dict[str, Any]]) -> list[str]:
    """Print the table of reliability; returns the bins that miss the target."""
    known = [r for r in found if r.get("truth") in ("stiction", "no stiction")]
    said = [r for r in known if r["verdict"] in ("stiction", "no stiction")]
    print(f"\nconfidence    loops    said   right   points over   ({len(known) - len(said)} of {len(known)} undecided)")
    missed = []
    for low, high in pairwise(EDGES):
        part = [r for r in said if low <= r["confidence"] < high or r["confidence"] == high == EDGES[-1]]
        if not part:
            continue
        mean = sum(r["confidence"] for r in part) / len(part)
        right = sum(r["verdict"] == r["truth"] for r in part) / len(part)
        print(f"{low:.2f} to {high:.2f} {len(part):7d} {mean:7.2f} {right:7.2f} {100 * (mean - right):13.1f}")
        if len(part) >= FEWEST and mean - right > MOST_POINTS:
            missed.append(f"said with {mean:.2f}, right in {right:.2f} of {len(part)}")
    return missed


def main() -> int:
    """Print the table of all rows given; the exit code says whether a bin misses the target."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="+")
    given = parser.parse_args()
    missed = table([row for path in given.rows for row in store.read(path)])
    print("targets missed: " + ("none" if not missed else "; ".join(missed)))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
