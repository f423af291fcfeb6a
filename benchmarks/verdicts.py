"""Verdicts and intervals on simulated loops whose truth is known (benchmarks/loops.py), by cause of the movement.

Run: python benchmarks/verdicts.py [--loops 100] [--first 10000] [--samples 1200] [--verdict-only] [--load]
     [--out verdicts.jsonl] [--minutes 60] [--jobs 2]

Half of the loops stick: --loops 600 gives intervals of 300. Target of the verdict: right or undecided in 98 %,
undecided in at most 15 % of either half. Target of the intervals: 90 % intervals of S, J, gain, time constants and dead
time hold the truth in 85 to 95 % of the sticking loops. Target of the time: identify takes at most 3 times the point
estimate alone (`identify --base-only`; CPU time of one process, sticking loops). The time beyond its bare searches is
printed, too. Thresholds were set on seeds below 1000. Every second sticking loop with a scanning controller has AR(1)
noise of root 0.8, the others white noise. Rows already in the file of --out are skipped; reliability.py reads them.
With --load every loop sticks, under a load that wanders.
--verdict-only leaves the point estimate alone out, and --samples gives shorter records: a quarter of the time.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

import reliability
import rows as store
from loops import CAUSES, Known, clean, sticky, wandering

from stictionid.fit import context as runs
from stictionid.record.study import Estimate
from stictionid.verbs.identify import Options, identify

COLOUR = 0.8
# Upper ends of the classes of noise, as shares of the swing of y.
NOISES = (0.01, 0.02, 0.05)
# What identify may take, in times of the point estimate alone, and where the searches of that begin.
SLOWEST = 3.0
SEARCHES = ((runs, "search"),)
NUMBERS = ("S", "J", "gain", "time constants", "dead time")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Results of one loop: verdict, whether each interval holds the truth, relative errors, CPU seconds.

    `holds` has one entry for each time constant; none for these and the dead time where the model has another order
    than the process, and its numbers are not those of the process.
    """

    cause: str
    verdict: str
    reason: str
    cpu_s: float
    base_s: float
    searching_s: float
    confidence: float
    groups: tuple[str, ...] = ()
    holds: dict[str, tuple[bool, ...]] = field(default_factory=dict)
    error_S: float = 0.0
    error_J: float = 0.0


@contextmanager
def searches() -> Iterator[list[float]]:
    """CPU seconds of every search (for a structure, or restarts) that begins in here, one in another counted once."""
    spent: list[float] = []
    inside: list[bool] = []

    def timed(function: Callable) -> Callable:
        def call(*given, **named):
            start, outermost = time.process_time(), not inside
            inside.append(True)
            try:
                return function(*given, **named)
            finally:
                inside.pop()
                if outermost:
                    spent.append(time.process_time() - start)
        return call

    before = [getattr(module, name) for module, name in SEARCHES]
    for (module, name), function in zip(SEARCHES, before, strict=True):
        setattr(module, name, timed(function))
    try:
        yield spent
    finally:
        for (module, name), function in zip(SEARCHES, before, strict=True):
            setattr(module, name, function)


def held(e: Estimate, known: Known) -> dict[str, tuple[bool, ...]]:
    """Mask of the numbers whose interval holds the truth, by name."""
    plant = known.setting.plant
    lags = sorted((t for t in (plant.time_constant_s, plant.second_time_constant_s) if t > 0), reverse=True)
    numbers = {"S": [(e.S_interval, known.S)], "J": [(e.J_interval, known.J)], "gain": [(e.gain_interval, plant.gain)]}
    if len(e.time_constants_s) == len(lags) and not e.integrating:
        numbers |= {"time constants": list(zip(e.time_constants_intervals, lags, strict=True)),
                    "dead time": [(e.dead_time_interval, plant.dead_time_s)]}
    return {name: tuple(span is not None and span[0] <= truth <= span[1] for span, truth in pairs)
            for name, pairs in numbers.items()}


def one(seed: int, sticks: bool, samples: int, verdict_only: bool, load: bool) -> Outcome:
    """One loop, by seed and whether its valve sticks."""
    colour = COLOUR if seed % 2 and not load else 0.0
    known = (wandering(seed, samples=samples) if load else sticky(seed, colour=colour, samples=samples) if sticks else
             clean(seed, CAUSES[seed % len(CAUSES)], samples=samples))
    start = time.process_time()
    study = identify(known.loop)
    cpu_s, start = time.process_time() - start, time.process_time()
    with searches() as spent:
        if sticks and not verdict_only:
            identify(known.loop, options=Options(base_only=True))
    said = (known.cause, study.verdict.stiction, study.verdict.reason, cpu_s, time.process_time() - start, sum(spent),
            study.verdict.confidence)
    e = study.estimate
    if e is None or not sticks or e.S_interval is None or e.J_interval is None:
        return Outcome(*said)
    scan = "scanned" if known.setting.controller.scan_s else "continuous"
    least = max((x for x in NOISES if x < known.noise_share), default=0.005)
    most = min(x for x in NOISES if x >= known.noise_share)
    return Outcome(*said, (f"{'load' if load else 'AR(1)' if colour else 'white'}, {scan}",
                           f"noise {100 * least:g} to {100 * most:g} % of the swing"),
                   held(e, known), abs(e.S / known.S - 1.0), abs(e.J - known.J) / known.S)


def row(seed: int, sticks: bool, samples: int, verdict_only: bool, load: bool) -> store.Row:
    """Row of one loop; without an outcome where its seed gives no loop."""
    truth = "stiction" if sticks else "no stiction"
    try:
        outcome = one(seed, sticks, samples, verdict_only, load)
    except RuntimeError as error:
        return {"truth": truth, "verdict": "undecided", "confidence": 0.0, "out": str(error)}
    return asdict(outcome) | {"truth": truth, "seed": seed}


def outcome_of(found: store.Row) -> Outcome:
    """The outcome that a row holds."""
    known = {name: found[name] for name in Outcome.__dataclass_fields__}
    return Outcome(**known | {"groups": tuple(known["groups"])})


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
    rows = [o for o in outcomes if o.holds]
    print("\n90 % intervals that hold the truth  loops      S      J   gain  time constants  dead time   median e_S"
          "   median |J-J0|/S")
    missed = []
    for group in (*sorted({g for o in rows for g in o.groups}), "all"):
        part = [o for o in rows if group == "all" or group in o.groups]
        hits = {name: [hit for o in part for hit in o.holds.get(name, ())] for name in NUMBERS}
        share = {name: sum(mine) / max(len(mine), 1) for name, mine in hits.items()}
        middle = len(part) // 2
        e_S, e_J = sorted(o.error_S for o in part)[middle], sorted(o.error_J for o in part)[middle]
        S, J, gain, lags, dead = (f"{100 * x:.0f}%" for x in share.values())
        print(f"{group:33s} {len(part):7d} {S:>6s} {J:>6s} {gain:>6s} {lags:>15s} {dead:>10s} {100 * e_S:11.2f}% "
              f"{100 * e_J:16.2f}%")
        if group == "all":
            missed += [f"intervals of {name} hold the truth in {100 * x:.0f} %" for name, x in share.items()
                       if not 0.85 <= x <= 0.95]
    other = sum("time constants" not in o.holds for o in rows)
    print(f"time constants and dead time: of the {len(rows) - other} loops whose model has the order of the process")
    return missed


def time_table(outcomes: Iterable[Outcome]) -> list[str]:
    """Print what identify takes beside the point estimate on sticking loops; returns the target missed."""
    rows = [o for o in outcomes if o.holds]
    print("\nCPU time of sticking loops          loops   identify   --base-only   times   searches of that   times")
    for group in (*sorted({o.groups[0] for o in rows}), "all"):
        part = [o for o in rows if group in ("all", o.groups[0])]
        whole, base, bare = (sum(getattr(o, name) for o in part) for name in ("cpu_s", "base_s", "searching_s"))
        print(f"{group:33s} {len(part):7d} {1e3 * whole / len(part):7.0f} ms {1e3 * base / len(part):10.0f} ms "
              f"{whole / base:7.2f} {1e3 * bare / len(part):15.0f} ms {whole / bare:7.2f}")
    return [f"identify takes {whole / base:.2f} times identify --base-only"] if whole > SLOWEST * base else []


def main() -> int:
    """Run the loops and print all tables; the exit code says whether a target was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=100, help="half of them stick")
    parser.add_argument("--first", type=int, default=10_000, help="first seed")
    parser.add_argument("--samples", type=int, default=1200)
    parser.add_argument("--verdict-only", action="store_true", help="no second run for the time of the point estimate")
    parser.add_argument("--load", action="store_true", help="only sticking loops, under a load that wanders")
    store.options(parser, out="verdicts.jsonl")
    given = parser.parse_args()
    kinds = (True,) if given.load else (True, False)
    tasks = [(f"{seed} {'loaded' if given.load else 'sticks' if sticks else 'clean'} {given.samples}",
              (seed, sticks, given.samples, given.verdict_only, given.load))
             for seed in range(given.first, given.first + given.loops // len(kinds)) for sticks in kinds]
    keys = {key for key, _ in tasks}
    rows = [r for r in store.run(tasks, row, given) if r["key"] in keys and "out" not in r]
    outcomes = [outcome_of(r) for r in rows]
    for r, o in zip(rows, outcomes, strict=True):
        if o.verdict != r["truth"]:
            print(f"seed {r['seed']} {o.cause}: {o.verdict}: {o.reason[:150]}")
    missed = verdict_table(outcomes) + coverage_table(outcomes)
    missed += [] if given.verdict_only else time_table(outcomes)
    missed += reliability.table(rows)
    print("\ntargets missed: " + ("none" if not missed else "; ".join(missed)))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
