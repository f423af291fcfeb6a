"""Effects × plants × noise × seeds: hidden effects named, clean loops without an effect, errors of S and J.

Thresholds are set on seeds 0 to 999; figures are reported from 10,000 on. There are six plants (first and second order,
an integrator, a tank). Half of the loops are scan-driven (20 integration steps a scan), a quarter have a command that
moves between samples, a quarter a Karnopp valve under a held command. 24 seeds give every effect all of them. Noise is
a share of the swing of PV. An effect that the record cannot show is counted and left out (told from the truth: see
`loops_with_effects.shown`). So is one under which the loop runs away.

    python benchmarks/effects_matrix.py --seeds 10000:10024
    python benchmarks/effects_matrix.py --effects none --seeds 10000:10200
    python benchmarks/effects_matrix.py --effects none --colour 0.8 --seeds 10000:10200
    python benchmarks/effects_matrix.py --effects pairs --seeds 10000:10048
    python benchmarks/effects_matrix.py --table rows.jsonl
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter, defaultdict
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from loops_with_effects import EQUIVALENT, FIRST, MISSED, VISIBLE, loop_of, names_of, right, runs_away, shown, verdict

from stictionid.effects import catalogue, get, parse
from stictionid.effects.contract import DIAGNOSE
from stictionid.errors import StictionidError
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify

# What is counted and left out: an effect that the record can't show, one under which the loop runs away, and one that
# the law of the loop's valve can't have.
INVISIBLE, RUNAWAY, NO_LOOP = "invisible", "runaway", "no loop"
LEFT_OUT = (INVISIBLE, RUNAWAY, NO_LOOP)


def one(task) -> dict:
    """One loop from simulation to diagnosis."""
    seed, effect, noise, colour, samples, apply = task
    try:
        setting, loop, (kind, bed), sd = loop_of(seed, effect, noise, colour, samples)
    except StictionidError as error:
        return {"seed": seed, "effect": effect or "none", "named": NO_LOOP, "reason": str(error)}
    row = {"seed": seed, "effect": effect or "none", "kind": kind, "bed": bed, "sd": sd, "S": setting.S, "J": setting.J,
           "colour": colour, "setting": dict(setting.effects),
           "shown": min((shown(setting, loop, name, sd) for name in names_of(effect)), default=np.inf)}
    if row["shown"] < VISIBLE:
        return row | {"named": INVISIBLE, "found": [], "equivalent": []}
    if effect and runs_away(loop, sd, noise):
        return row | {"named": RUNAWAY, "found": [], "equivalent": []}
    t = time.process_time()
    try:
        study = identify(loop)
        if not study.steps:
            return row | {"named": "abstained", "found": [], "equivalent": [], "reason": study.verdict.reason}
        row["added"] = [s.added for s in study.steps if s.added]
        row["base"] = study.steps[-1].error.rmse / sd
        after = diagnose(loop, study, apply=apply)
    except StictionidError as error:
        return row | {"named": "refused", "found": [], "equivalent": [], "reason": str(error)}
    # What identify added may have given way to something better, and what came first to what explains it.
    kept = {parse(n)[0].name for n in after.steps[-1].effects}
    found = [s.added for s in after.steps if s.added in kept]
    found += [name for name in after.missing if name not in found]
    plain = [parse(n)[0].name for n in found]
    top = after.candidates[0] if after.candidates else None
    equal = [parse(n)[0].name for n in top.equivalent_to] if top is not None and top.accepted else []
    last = after.steps[-1].error
    runner = [(c.effect, round(c.delta_bic or 0.0)) for c in after.candidates[:4]]
    return row | {"named": " + ".join(plain) or "nothing", "found": plain, "equivalent": equal,
                  "time": time.process_time() - t, "rmse": last.rmse / sd, "one_step": last.rmse_one_step / sd,
                  "S_error": after.estimate.S / setting.S - 1.0, "J_error": after.estimate.J / setting.J - 1.0,
                  "why": after.adequate_reason, "runner": runner}


def pairs() -> list[str]:
    """All pairs of effects that `diagnose` asks for and can tell: no two noise models, no two known to look alike."""
    return [f"{a}+{b}" for a, b in combinations((n for n, e in catalogue().items() if e.asked == DIAGNOSE), 2)
            if not (get(a).noise and get(b).noise) and b not in get(a).confused_with and a not in get(b).confused_with
            and not (get(a).profile and get(b).profile)]


def hidden(wanted: str, seed: int) -> list[str | None]:
    """Effects hidden in the loops of one seed: names, "none", or "pairs" (one pair a seed, drawn from all).

    By itself those that `diagnose` asks for: the others look like one of these in u and y.
    """
    out: list[str | None] = []
    for name in wanted.split(",") if wanted else (n for n, e in catalogue().items() if e.asked == DIAGNOSE):
        if name == "pairs":
            known = pairs()
            out.append(known[int(np.random.default_rng([seed, 5]).integers(len(known)))])
        else:
            out.append(None if name == "none" else name)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="10000:10004", help="first:last+1, or first:last+1:step")
    parser.add_argument("--effects", default="",
                        help="names, comma-separated (a+b hides two), 'none' for clean loops, 'pairs'; when empty all "
                             "that diagnose asks for")
    parser.add_argument("--noise", type=float, default=0.01, help="share of PV's swing")
    parser.add_argument("--colour", type=float, default=0.0, help="root of AR(1) noise; 0 is white")
    parser.add_argument("--samples", type=int, default=1500)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=6.0, help="no new loops after so long")
    parser.add_argument("--apply", action=argparse.BooleanOptionalAction, default=True,
                        help="add what is named and repeat; a Karnopp valve may be named before the hidden effect")
    parser.add_argument("--rows", default="", help="write one JSON line per loop here")
    parser.add_argument("--table", default="", help="only print the table of the rows in this file")
    parser.add_argument("--quiet", action="store_true")
    a = parser.parse_args()
    if a.table:
        rows = [json.loads(line) for line in Path(a.table).read_text().splitlines()]
        table(rows, len(rows))
        return
    tasks = [(seed, name, a.noise, a.colour, a.samples, a.apply) for seed in range(*map(int, a.seeds.split(":")))
             for name in hidden(a.effects, seed)]
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
            if not a.quiet and row["named"] not in LEFT_OUT and not right(row):
                print(f"miss {row['seed']} {row['kind']} {row['bed']} {row['effect']} {row['setting']} -> "
                      f"{row['found']} {row.get('equivalent')} {row.get('runner', row.get('reason'))} "
                      f"shown {row['shown']:.2f} base {row.get('base', 0):.2f} end {row.get('rmse', 0):.2f} "
                      f"S {row.get('S_error', 0):+.3f} J {row.get('J_error', 0):+.3f}", file=sys.stderr, flush=True)
            if out:
                print(json.dumps(row), file=out, flush=True)
            if time.monotonic() < stop and (task := next(waiting, None)):
                running.add(pool.submit(one, task))
    table(rows, len(tasks))


def table(rows: list[dict], asked: int) -> None:
    """Effect by effect what was named, rates by kind of loop, and the errors where the right effect was named."""
    print(f"{len(rows)} of {asked} loops")
    for why, said in ((INVISIBLE, f"the effect shows less than {VISIBLE:g} of the noise"),
                      (RUNAWAY, "the loop runs away"),
                      (NO_LOOP, "the valve's law can't have the effect")):
        out = Counter(r["effect"] for r in rows if r["named"] == why)
        print(f"left out, {said}: {out.total()}" + "".join(f", {k} {n}" for k, n in out.most_common()))
    rows = [r for r in rows if r["named"] not in LEFT_OUT]
    by = defaultdict(list)
    for r in rows:
        by[r["effect"]].append(r)
    print(f"{'hidden':26s} {'loops':>5s} {'first':>5s} {'equal':>5s} {'missed':>6s}  named instead")
    for effect in sorted(by):
        how = Counter(verdict(r) for r in by[effect])
        instead = Counter(r["named"] for r in by[effect] if not right(r))
        print(f"{effect:26s} {len(by[effect]):5d} {how[FIRST]:5d} {how[EQUIVALENT]:5d} {how[MISSED]:6d}  "
              + ", ".join(f"{n} {k}" for k, n in instead.most_common()))
    print(f"{'all':26s} {rate(rows)}")
    for key in ("kind", "bed"):
        for value in dict.fromkeys(r[key] for r in rows):
            print(f"{value:26s} {rate([r for r in rows if r[key] == value])}")
    good = [r for r in rows if right(r) and "S_error" in r]
    if good:
        S, J = (np.abs([r[k] for r in good]) for k in ("S_error", "J_error"))
        print(f"right ones: |S error| median {100 * np.median(S):.2f} %, 90 % below {100 * np.quantile(S, 0.9):.2f} %; "
              f"|J error| median {100 * np.median(J):.2f} %, 90 % below {100 * np.quantile(J, 0.9):.2f} %")
        # Where noise is what is hidden, the free run can't reach the innovations, nor a Karnopp valve a sliding one.
        plain = [r["rmse"] for r in good if r["kind"] != "karnopp"
                 and not any(get(n).noise for n in (*r["found"], *names_of(r["effect"])))]
        if plain:
            print(f"free-run error / noise after adding, {len(plain)} without noise model or Karnopp valve: median "
                  f"{np.median(plain):.3f}, 90 % below {np.quantile(plain, 0.9):.3f}, largest {max(plain):.3f}")
        print(f"CPU seconds a loop, identify and diagnose: median {np.median([r['time'] for r in good]):.1f}, "
              f"90 % below {np.quantile([r['time'] for r in good], 0.9):.1f}")


def rate(rows: list[dict]) -> str:
    """Loops in which the right thing was said, of all."""
    hits = sum(map(right, rows))
    return f"{hits:4d}/{len(rows):<4d} {100.0 * hits / max(len(rows), 1):5.1f} %"


if __name__ == "__main__":
    main()
