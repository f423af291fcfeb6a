"""Verdicts and intervals on simulated loops whose truth is known (benchmarks/loops.py), by cause of the movement.

Run: python benchmarks/verdicts.py [--loops 100] [--first 10000] [--jobs 2]
Targets of the verdict: right or undecided in 98 %, undecided in at most 15 % of either half. Of the intervals: 90 %
intervals of S and J hold the truth in 85 to 95 % of the sticking loops. Thresholds were set on seeds below 1000. Every
second sticking loop with a scanning controller has AR(1) noise of root 0.8, the others white noise.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

from loops import CAUSES, clean, sticky

from stictionid.identify import identify

COLOUR = 0.8


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the tool said of one loop: verdict, whether each interval holds the truth, relative errors."""

    cause: str
    verdict: str
    reason: str
    group: str = ""
    holds_S: bool | None = None
    holds_J: bool | None = None
    error_S: float = 0.0
    error_J: float = 0.0


def one(task: tuple[int, bool]) -> Outcome:
    """One loop, by seed and whether its valve sticks."""
    seed, sticks = task
    colour = COLOUR if seed % 2 else 0.0
    known = sticky(seed, colour=colour) if sticks else clean(seed, CAUSES[seed % len(CAUSES)])
    study = identify(known.loop)
    e = study.estimate
    scan = "scanned" if known.setting.controller.scan_s else "continuous"
    if e is None or not sticks or e.S_interval is None or e.J_interval is None:
        return Outcome(known.cause, study.verdict.stiction, study.verdict.reason)
    group = f"{'AR(1)' if colour else 'white'}, {scan}"
    return Outcome(known.cause, study.verdict.stiction, study.verdict.reason, group,
                   e.S_interval[0] <= known.S <= e.S_interval[1], e.J_interval[0] <= known.J <= e.J_interval[1],
                   abs(e.S / known.S - 1.0), abs(e.J - known.J) / known.S)


def verdict_table(outcomes: Iterable[Outcome]) -> list[str]:
    """Print the table of verdicts; returns the targets missed."""
    counts = Counter((o.cause, o.verdict) for o in outcomes)
    causes = ("stiction", *CAUSES)
    words = ("stiction", "no stiction", "undecided")
    print("\ncause        " + "".join(f"{w:>14s}" for w in words))
    for cause in causes:
        print(f"{cause:13s}" + "".join(f"{counts[cause, w]:14d}" for w in words))
    missed = []
    wrong = sum(counts[c, "stiction"] for c in CAUSES) + counts["stiction", "no stiction"]
    total = sum(counts.values())
    print(f"wrong: {wrong} of {total} ({100 * wrong / total:.1f} %)")
    if wrong > 0.02 * total:
        missed.append(f"{wrong} of {total} wrong")
    for name, group in (("sticking", ("stiction",)), ("others", CAUSES)):
        n = sum(counts[c, w] for c in group for w in words)
        open_ = sum(counts[c, "undecided"] for c in group)
        print(f"undecided among the {name}: {open_} of {n} ({100 * open_ / max(n, 1):.1f} %)")
        if open_ > 0.15 * n:
            missed.append(f"{open_} of {n} {name} undecided")
    return missed


def coverage_table(outcomes: Iterable[Outcome]) -> list[str]:
    """Print how often the intervals hold the truth; returns the targets missed."""
    rows = [o for o in outcomes if o.holds_S is not None]
    print("\n90 % intervals that hold the truth     loops      S      J   median e_S   median |J-J0|/S")
    missed = []
    for group in (*sorted({o.group for o in rows}), "all"):
        part = [o for o in rows if group in ("all", o.group)]
        S = sum(bool(o.holds_S) for o in part) / len(part)
        J = sum(bool(o.holds_J) for o in part) / len(part)
        middle = len(part) // 2
        e_S, e_J = sorted(o.error_S for o in part)[middle], sorted(o.error_J for o in part)[middle]
        print(f"{group:36s} {len(part):7d} {100 * S:5.0f}% {100 * J:5.0f}% {100 * e_S:11.2f}% {100 * e_J:16.2f}%")
        if group == "all":
            missed += [f"intervals of {name} hold the truth in {100 * x:.0f} %" for name, x in (("S", S), ("J", J))
                       if not 0.85 <= x <= 0.95]
    return missed


def main() -> int:
    """Run the loops and print both tables; the exit code says whether a target was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=100, help="half of them stick")
    parser.add_argument("--first", type=int, default=10_000, help="first seed")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    tasks = [(given.first + i, sticks) for i in range(given.loops // 2) for sticks in (True, False)]
    with ProcessPoolExecutor(given.jobs) as pool:
        outcomes = list(pool.map(one, tasks))
    for (seed, _), o in zip(tasks, outcomes, strict=True):
        right = "stiction" if o.cause == "stiction" else "no stiction"
        if o.verdict != right:
            print(f"seed {seed} {o.cause}: {o.verdict}: {o.reason[:150]}")
    missed = verdict_table(outcomes) + coverage_table(outcomes)
    print("\ntargets missed: " + ("none" if not missed else "; ".join(missed)))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
