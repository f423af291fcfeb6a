"""The table of docs/robustness.md: inputs fuzzed, processes killed, faults injected, and what was lost.

Run: python benchmarks/hard.py
Only adds up docs/hard_results.json, which the tools in tests/fuzz and tests/faults write with --record; `--code` adds
how much of it ran on the code as it stands. To make everything anew:

    python tests/fuzz/run.py --executions 1000000 --minutes 600 --record
    python tests/faults/kills.py --record
    python tests/faults/run.py --seconds 1800 --record
    python tests/faults/soak.py --record
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "faults"))

import hard_results

Row = tuple[str, str, str, str]


def _of(runs: Iterable[dict[str, Any]], what: str) -> list[dict[str, Any]]:
    return [run for run in runs if run["what"] == what]


def fuzz_rows(runs: list[dict[str, Any]]) -> list[Row]:
    """One row for all fuzzing: executions, what came out, inputs that failed and are kept."""
    total = [0, 0, 0]
    doors: set[str] = set()
    for run in _of(runs, "fuzz"):
        doors |= {name for name, counts in run["doors"].items() if sum(counts)}
        for counts in run["doors"].values():
            total = [a + b for a, b in zip(total, counts, strict=True)]
    if not sum(total):
        return []
    kept = sorted({name for run in _of(runs, "fuzz") for name in run["failing"]})
    there = [n for n in kept if (hard_results.ROOT / "tests" / "fuzz" / "corpus" / n).exists()]
    failed = f"{total[2]:,} executions of {len(kept)} causes, mended since" if total[2] else "0"
    return [("inputs fuzzed", f"{sum(total):,} at {len(doors)} doors ({total[0]:,} read, {total[1]:,} refused)", failed,
             f"nothing; {len(there)} inputs kept as tests" if kept else "nothing")]


def fault_rows(runs: list[dict[str, Any]]) -> list[Row]:
    """One row per kind of fault, from the newest run in which it was injected."""
    newest: dict[str, list[int]] = {}
    for run in _of(runs, "faults"):
        newest |= run["kinds"]
    return [(f"fault: {name}", f"{trials} injected", str(failures), "nothing" if not failures else "see the run")
            for name, (trials, failures) in newest.items()]


def in_one(rows: list[Row]) -> list[Row]:
    """The rows of all kinds of faults as one."""
    if not rows:
        return []
    injected, failed = (sum(int(row[i].split()[0]) for row in rows) for i in (1, 2))
    return [(f"faults of {len(rows)} kinds", f"{injected} injected", str(failed),
             "nothing" if not failed else "see --kinds")]


def kill_rows(runs: list[dict[str, Any]]) -> list[Row]:
    """One row for all kills of batches."""
    mine = _of(runs, "kills")
    if not mine:
        return []
    parents, workers, everybody, rounds = (
        sum(run[key] for run in mine) for key in ("parents", "workers", "all", "rounds"))
    standing = sum(run["failures"] for run in mine if "mended" not in run)
    mended = [run["mended"] for run in mine if "mended" in run]
    failures = str(standing) + "".join(f"; mended since: {what}" for what in mended)
    return [("`kill -9` of `batch --resume`", f"{parents + workers + everybody} at random times ({parents} parents, "
             f"{workers} workers, {everybody} all at once)", failures,
             "see the run" if standing else f"nothing: {rounds} of {rounds} final summaries equal byte for byte")]


def soak_rows(runs: list[dict[str, Any]]) -> list[Row]:
    """One row for the longest soak."""
    mine = _of(runs, "soak")
    if not mine:
        return []
    longest = max(mine, key=lambda run: run["identifications"])
    outcomes = ", ".join(f"{count:,} {name}" for name, count in sorted(longest["outcomes"].items()))
    return [("soak, one process", f"{longest['identifications']:,} identifications ({outcomes})",
             str(len(longest["problems"])), f"memory {longest['memory_mb'][0]} to {longest['memory_mb'][1]} MB "
             f"({100 * longest['growth']:+.1f} %), {longest['handles'][0]} to {longest['handles'][1]} open files")]


def table(runs: list[dict[str, Any]], *, kinds: bool = False) -> str:
    """The table as markdown; with `kinds` a row for each kind of fault."""
    faults = fault_rows(runs)
    rows = [*fuzz_rows(runs), *kill_rows(runs), *soak_rows(runs), *(faults if kinds else in_one(faults))]
    lines = [("what", "how much", "failures", "lost"), ("---",) * 4, *rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in lines)


def on_this_code(runs: list[dict[str, Any]]) -> str:
    """The part of the fuzzing that ran on exactly the present code, and the number of earlier code states."""
    now = hard_results.code()
    here = sum(sum(map(sum, run["doors"].values())) for run in _of(runs, "fuzz") if run["code"] == now)
    states = {run["code"] for run in _of(runs, "fuzz")}
    before = len(states - {now})
    return f"code {now}: {here:,} of the executions ran on exactly this code, the others on {before} states before it"


def main() -> int:
    """Print the table; exit 1 when a fault or a kill lost something in its newest run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--code", action="store_true", help="say how much ran on the code as it stands")
    parser.add_argument("--kinds", action="store_true", help="a row for each kind of fault")
    chosen = parser.parse_args()
    runs = hard_results.runs()
    print(table(runs, kinds=chosen.kinds))
    if chosen.code:
        print(on_this_code(runs))
    rows = [*kill_rows(runs), *soak_rows(runs), *fault_rows(runs)]
    return int(any(row[3].startswith("see") or not row[2].startswith("0") for row in rows))


if __name__ == "__main__":
    sys.exit(main())
