"""All fault injections under real commands, in bounded time, with a table of the results.

Run: python tests/faults/run.py [--seconds 300] [--only WORD] [--record [FILE]]

Each fault reports its number of trials and its failures. Faults that this machine cannot make are skipped with the
reason. Exit code 1 when anything failed. Conditions of every trial: no traceback, the contract's exit code, and every
study or report whole or absent, with nothing half-written beside it.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import fault_clock
import fault_files
import fault_numbers
import fault_signals
import fault_surroundings
import hard_results
from fault_bench import Bench, Outcome

FAULTS = {**fault_files.FAULTS, **fault_signals.FAULTS, **fault_surroundings.FAULTS, **fault_clock.FAULTS,
          **fault_numbers.FAULTS}


def inject(bench: Bench, names: list[str], seconds: float) -> list[Outcome]:
    """Every fault named, one after the other, until the time is used up; the rest is reported as not run."""
    end = time.monotonic() + seconds
    outcomes = []
    for name in names:
        if time.monotonic() > end:
            outcomes.append(Outcome(name, 0, [], "not run: the time was used up"))
            continue
        trials, problems, skipped = FAULTS[name](bench)
        outcomes.append(Outcome(name, trials, problems, skipped))
        print(f"{name:46s} {trials:4d} trials  {len(problems):3d} failures"
              + (f"  skipped: {skipped}" if skipped else ""), flush=True)
        for problem in problems:
            print(f"    {problem}", flush=True)
    return outcomes


def main() -> int:
    """Make the files, inject the faults, print the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--seconds", type=float, default=300.0, help="time after which no further fault starts")
    arguments.add_argument("--only", default="", help="faults whose name holds this word")
    arguments.add_argument("--seed", type=int, default=0, help="seed of the random times")
    hard_results.add_record_option(arguments)
    chosen = arguments.parse_args()
    fingerprint, begun = hard_results.code(), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        os.chmod(folder, 0o755)
        bench = Bench(Path(folder), chosen.seed)
        outcomes = inject(bench, [n for n in FAULTS if chosen.only in n], chosen.seconds)
    if chosen.record:
        hard_results.add("faults", fingerprint, {
            "seed": chosen.seed, "seconds": round(time.monotonic() - begun), "kinds": {
                o.name: [o.trials, len(o.problems)] for o in outcomes if not o.skipped},
            "skipped": {o.name: o.skipped for o in outcomes if o.skipped}}, chosen.record)
    failed = sum(len(o.problems) for o in outcomes)
    skipped = sum(bool(o.skipped) for o in outcomes)
    print(f"faults: {len(outcomes)} kinds, {sum(o.trials for o in outcomes)} injected, {failed} failures, "
          f"{skipped} kinds skipped")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
