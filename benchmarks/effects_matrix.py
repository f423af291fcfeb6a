"""Effects × plants × noise × seeds: is the hidden effect named, are clean loops left alone, do S and J come back?

Thresholds are set on seeds 0 to 999; figures are reported from 10,000 on. Half of the loops are scan-driven (20
integration steps a scan), a quarter have a command that moves between samples, a quarter a Karnopp valve under a held
command. Noise is a share of the swing of PV.

    python benchmarks/effects_matrix.py --seeds 10000:10002 --effects extra-lag,travel-limit
    python benchmarks/effects_matrix.py --clean 40 --colour 0.8 --seeds 10000:10020
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter, defaultdict
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from loops_with_effects import loop_of, right

from stictionid.diagnose import diagnose
from stictionid.effects import catalogue, parse
from stictionid.errors import StictionidError
from stictionid.identify import identify


def one(task) -> dict:
    """One loop from simulation to diagnosis."""
    seed, effect, noise, colour, samples, apply = task
    setting, loop, kind, sd = loop_of(seed, effect, noise, colour, samples)
    row = {"seed": seed, "effect": effect or "none", "kind": kind, "sd": sd, "S": setting.S, "J": setting.J,
           "colour": colour,
           "setting": dict(setting.effects)}
    t = time.perf_counter()
    try:
        study = identify(loop)
        if not study.steps:
            return row | {"named": "abstained", "found": [], "equivalent": [], "reason": study.verdict.reason}
        row["added"] = [s.added for s in study.steps if s.added]
        row["base"] = study.steps[-1].error.rmse / sd
        after = diagnose(loop, study, apply=apply)
    except StictionidError as error:
        return row | {"named": "refused", "found": [], "equivalent": [], "reason": str(error)}
    # What identify added may have given way to something better.
    found = [s.added for s in after.steps if s.added]
    found += [name for name in after.missing if name not in found]
    plain = [parse(n)[0].name for n in found]
    top = after.candidates[0] if after.candidates else None
    equal = [parse(n)[0].name for n in top.equivalent_to] if top is not None and top.accepted else []
    last = after.steps[-1].error
    runner = [(c.effect, round(c.delta_bic or 0.0)) for c in after.candidates[:4]]
    return row | {"named": plain[0] if plain else "nothing", "found": plain, "equivalent": equal,
                  "time": time.perf_counter() - t, "rmse": last.rmse / sd, "one_step": last.rmse_one_step / sd,
                  "S_error": after.estimate.S / setting.S - 1.0, "J_error": after.estimate.J / setting.J - 1.0,
                  "why": after.adequate_reason, "runner": runner}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="10000:10004", help="first:last+1")
    parser.add_argument("--effects", default="", help="names, comma-separated; all when empty, 'none' for clean loops")
    parser.add_argument("--noise", type=float, default=0.01, help="share of PV's swing")
    parser.add_argument("--colour", type=float, default=0.0, help="root of AR(1) noise; 0 is white")
    parser.add_argument("--samples", type=int, default=1500)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=6.0, help="no new loops after so long")
    parser.add_argument("--apply", action=argparse.BooleanOptionalAction, default=True,
                        help="add what is named and repeat; a Karnopp valve may be named before the hidden effect")
    parser.add_argument("--rows", default="", help="write one JSON line per loop here")
    parser.add_argument("--quiet", action="store_true")
    a = parser.parse_args()
    first, last = (int(x) for x in a.seeds.split(":"))
    names = [None if n == "none" else n for n in a.effects.split(",")] if a.effects else list(catalogue())
    tasks = [(seed, name, a.noise, a.colour, a.samples, a.apply) for seed in range(first, last) for name in names]
    rows, stop = [], time.monotonic() + 60.0 * a.minutes
    out = open(a.rows, "a") if a.rows else None  # noqa: SIM115
    with ProcessPoolExecutor(a.jobs, get_context("fork")) as pool:
        waiting = iter(tasks)
        running = {pool.submit(one, t) for _, t in zip(range(a.jobs), waiting, strict=False)}
        while running:
            done = next(iter(f for f in running if f.done()), None)
            if done is None:
                time.sleep(0.05)
                continue
            running.discard(done)
            row = done.result()
            rows.append(row)
            if not a.quiet and not right(row):
                print(f"miss {row['seed']} {row['kind']} {row['effect']} {row['setting']} -> {row['found']} "
                      f"{row.get('equivalent')} {row.get('runner', row.get('reason'))} base {row.get('base', 0):.2f} "
                      f"S {row.get('S_error', 0):+.3f} J {row.get('J_error', 0):+.3f}", file=sys.stderr, flush=True)
            if out:
                print(json.dumps(row), file=out, flush=True)
            if time.monotonic() < stop and (task := next(waiting, None)):
                running.add(pool.submit(one, task))
    table(rows, len(tasks))


def table(rows: list[dict], asked: int) -> None:
    """Confusion table by effect, rates by kind of loop, and errors of S and J where the right effect was named."""
    print(f"{len(rows)} of {asked} loops")
    named = defaultdict(Counter)
    for r in rows:
        named[r["effect"]][r["named"] + ("" if not r.get("equivalent") else " ~ " + "/".join(r["equivalent"]))] += 1
    print(f"{'hidden':26s} {'right':>7s}  named")
    for effect in sorted(named):
        mine = [r for r in rows if r["effect"] == effect]
        said = ", ".join(f"{n} {k}" for n, k in named[effect].most_common(5))
        print(f"{effect:26s} {sum(map(right, mine)):3d}/{len(mine):<3d}  {said}")
    for kind in dict.fromkeys(r["kind"] for r in rows):
        mine = [r for r in rows if r["kind"] == kind]
        print(f"{kind:26s} {sum(map(right, mine)):3d}/{len(mine):<3d}")
    good = [r for r in rows if right(r) and "S_error" in r]
    if good:
        S, J = (np.abs([r[k] for r in good]) for k in ("S_error", "J_error"))
        print(f"right ones: |S error| median {100 * np.median(S):.2f} %, 90 % below {100 * np.quantile(S, 0.9):.2f} %; "
              f"|J error| median {100 * np.median(J):.2f} %, 90 % below {100 * np.quantile(J, 0.9):.2f} %")
        print(f"seconds a loop, identify and diagnose: median {np.median([r['time'] for r in good]):.1f}")


if __name__ == "__main__":
    main()
