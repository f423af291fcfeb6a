"""Valve changes: is a valve that was repaired, or got worse, halfway told, with its time, and no other valve?

Run: python benchmarks/valve_changes.py [--loops 60] [--seed 71000] [--kind none|repaired|worse] [--out rows.jsonl]

Every loop sticks (benchmarks/loops.py, 1200 samples, noise of 0.5 to 5 % of the swing of PV). `none`: nothing changes.
`repaired`: S and J fall to 0.1 to 0.35 of what they were, `worse`: they grow to 2.5 to 4 times, at 0.3 to 0.7 of the
record, both on every fifth seed. Each is identified, and `add stiction-change` says whether the record supports a
change. `diagnose` asks so only where something is missing, `agree` only where windows differ: both say fewer.
Targets: a change on at most 1 of 60 loops of `none`; time within half a period and S after it within 10 %, or 0.1 of S
before, on most others.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import rows as store
from loops import Known, sticky

from stictionid.errors import StictionidError
from stictionid.model.closed_loop import simulate
from stictionid.verbs.add import add
from stictionid.verbs.identify import Options, identify

NONE, REPAIRED, WORSE = KINDS = "none", "repaired", "worse"
CHANGE = "stiction-change"
# Every so many seeds a loop is made with each change, too.
_EACH = 5


def changed(seed: int, kind: str) -> tuple[Known, float, float]:
    """A loop of some kind, the time of its change in s, and the factor on S and J."""
    known, rng = sticky(seed), np.random.default_rng([seed, 48])
    if kind == NONE:
        return known, 0.0, 1.0
    factor = float(rng.uniform(0.1, 0.35) if kind == REPAIRED else rng.uniform(2.5, 4.0))
    at = float(rng.uniform(0.3, 0.7)) * known.setting.duration_s
    values = {"stickband_change": (factor - 1.0) * known.S, "jump_change": (factor - 1.0) * known.J, "time_s": at}
    now = {"S": factor * known.S, "J": factor * known.J}
    loop = simulate(replace(known.setting, **now, effects=((CHANGE, values),)), seed=seed).loop
    return replace(known, loop=replace(loop, position=None)), at, factor


def one(seed: int, kind: str) -> store.Row:
    """One row: the truth of a loop, and the change that `add` finds in it."""
    known, at, factor = changed(seed, kind)
    begin = time.process_time()
    row: store.Row = {"seed": seed, "kind": kind, "S": known.S, "after": factor * known.S, "at": at, "said": None}
    try:
        study = identify(known.loop, options=Options(intervals=kind != NONE))
        row |= {"period": study.range.period_median_s, "base": study.estimate and study.estimate.S}
        study = add(known.loop, study, CHANGE)
    except StictionidError as error:
        return row | {"failed": str(error), "cpu_s": time.process_time() - begin}
    step = next((s for s in study.steps if s.added == CHANGE), None)
    found = {p.name: p for p in study.steps[-1].parameters if p.effect == CHANGE}
    if step is not None and found:
        assert study.estimate is not None
        row |= {"said": step.supported, "told": [study.estimate.S - found["stickband_change"].value, study.estimate.S,
                                                 found["time_s"].value], "interval": found["time_s"].interval,
                "statement": step.findings[0].statement}
    return row | {"cpu_s": time.process_time() - begin}


def right(row: store.Row) -> bool:
    """True where time and S after the change are those of the simulation."""
    _, after, at = row["told"]
    near = 0.1 * max(row["after"], row["S"] if row["after"] < row["S"] else 0.0)
    return abs(at - row["at"]) <= row["period"] / 2 and abs(after - row["after"]) <= near


def table(found: list[store.Row]) -> None:
    """Print the counts of each kind."""
    for kind in KINDS:
        rows = [r for r in found if r["kind"] == kind]
        if not rows:
            continue
        said = [r for r in rows if r["said"]]
        words = f"{len(said)} changes said"
        if kind != NONE and said:
            inside = [r for r in said if r["interval"] and r["interval"][0] <= r["at"] <= r["interval"][1]]
            words += (f", {sum(map(right, said))} with right time and S; its interval holds the time in {len(inside)}; "
                      f"median error {np.median([abs(r['told'][2] - r['at']) for r in said]):.1f} s")
        print(f"{kind:8s} {len(rows):3d} loops: {words}; {sum('failed' in r for r in rows)} abstained; median CPU "
              f"{np.median([r['cpu_s'] for r in rows]):.1f} s")
        for r in rows:
            if (kind == NONE) == bool(r["said"]) or (r["said"] and not right(r)):
                print(f"         seed {r['seed']}: {r.get('failed') or r.get('statement')}")


def main() -> None:
    """Run the loops and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=60, help="seeds")
    parser.add_argument("--kind", choices=KINDS, action="append")
    store.options(parser, out="valve_changes.jsonl")
    parser.set_defaults(seed=71_000)
    given = parser.parse_args()
    table(store.run([(f"{kind} {given.seed + i}", (given.seed + i, kind)) for i in range(given.loops)
                     for kind in given.kind or KINDS if kind == NONE or i % _EACH == 0], one, given))


if __name__ == "__main__":
    main()
