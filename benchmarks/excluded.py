"""The S that "no stiction" excludes, on loops whose valve sticks by little: how often is the truth below it.

Run: python benchmarks/excluded.py [--loops 60] [--seed 80000] [--minutes 20] [--jobs 1] [--out FILE]
Each loop moves for another reason than its valve, whose S is 0.02 to 2 %. Counted are the loops that get the verdict
"no stiction". The bound is one of 95 %: at least that share must lie below it. Exit 1 where fewer do, beyond chance.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import rows as store
from loops import CAUSES, clean

LEVEL, LEAST, MOST = 0.95, 0.02, 2.0


def one(seed: int) -> store.Row:
    """One loop identified."""
    from stictionid.verbs.identify import identify

    cause = CAUSES[seed % len(CAUSES)]
    S = float(np.exp(np.random.default_rng([seed, 57]).uniform(np.log(LEAST), np.log(MOST))))
    try:
        loop = clean(seed, cause, S=S).loop
    except RuntimeError as error:
        return {"seed": seed, "out": str(error)}
    said = identify(loop).verdict
    return {"seed": seed, "cause": cause, "S": S, "swing": float(np.ptp(loop.output)), "verdict": said.stiction,
            "above": said.evidence.S_excluded_above}


def table(found: list[store.Row]) -> int:
    """Print the table; 1 where fewer bounds hold than their level, beyond three standard errors."""
    known = [r for r in found if "out" not in r]
    denied = [r for r in known if r["verdict"] == "no stiction" and r["above"] is not None]
    held = sum(r["S"] <= r["above"] for r in denied)
    wide = float(np.median([r["above"] / r["swing"] for r in denied])) if denied else float("nan")
    print(f"loops {len(known)}, no stiction {len(denied)}, S below the bound {held}, "
          f"median bound {100 * wide:.1f} % of OP's swing")
    for verdict in ("stiction", "undecided"):
        part = [r["S"] / r["swing"] for r in known if r["verdict"] == verdict]
        size = f", S of {100 * float(np.median(part)):.1f} % of OP's swing" if part else ""
        print(f"{verdict}: {len(part)}{size}")
    short = LEVEL * len(denied) - 3.0 * float(np.sqrt(len(denied) * LEVEL * (1.0 - LEVEL)))
    return int(held < short)


def main() -> int:
    """Run the loops that are not in the file yet and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    store.options(parser, out="excluded.jsonl")
    parser.add_argument("--loops", type=int, default=60)
    given = parser.parse_args()
    return table(store.run([(str(s), (s,)) for s in range(given.seed, given.seed + given.loops)], one, given))


if __name__ == "__main__":
    sys.exit(main())
