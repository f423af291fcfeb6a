"""Neighbours: is the tag named that drives a loop, and none of twenty that do not?

Run: python benchmarks/neighbours.py [--loops 100] [--first 60000] [--kind tag|none] [--out rows.jsonl]
     python benchmarks/neighbours.py --calibrate

Every loop sticks (benchmarks/loops.py). Without --whole only tags, a sine and a lag are asked for. Kinds: `tag`, one of
20 tags drives PV by a lag and a dead time, by 0.1 to 0.4 of its swing; `none`, none of the 20 does. Unrelated tags are
random walks, PV and OP of other loops that stick, and noise.
Targets: a false source on at most 2 of 100 loops, and the right one named on most. Thresholds were set on seeds below
50000.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import rows as store
from loops import Known, sticky

from stictionid.effects import parse
from stictionid.model.closed_loop import simulate
from stictionid.numerics.spectrum import lagged_gains, whiten_signals
from stictionid.record.study import Study
from stictionid.reports.effect_words import of_model
from stictionid.selection.decide import decide_answer
from stictionid.selection.run import resume_search
from stictionid.typing import FloatArray
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify

SAMPLES, TAGS, EARLY = 800, 20, 400
# Loops that stand for neighbours, and the seed of the first.
POOL, OTHERS = 40, 500_000
TAG, NONE = KINDS = "tag", "none"
MEASURED, SINE = "measured-disturbance", "sinusoidal-disturbance"


def neighbour(rng: np.random.Generator, samples: int) -> tuple[FloatArray, FloatArray]:
    """PV and OP (samples,) of another loop that sticks: a part of one of a fixed pool."""
    pv, op = _other(int(rng.integers(POOL)), 2 * samples)
    first = int(rng.integers(samples // 4, samples))
    return pv[first:first + samples], op[first:first + samples]


@cache
def _other(number: int, samples: int) -> tuple[FloatArray, FloatArray]:
    loop = sticky(OTHERS + number, samples=samples).loop
    return np.array(loop.process_value), np.array(loop.output)


def tags_of(rng: np.random.Generator, samples: int, count: int = TAGS) -> dict[str, FloatArray]:
    """Unrelated tags (samples,) by name: random walks, two of each other loop, white and slow noise."""
    out: dict[str, FloatArray] = {}
    for i in range(count):
        kind = ("PV", "walk", "noise", "walk", "PV")[i % 5]
        if kind == "PV":
            out[f"LIC{i}.PV"], other = neighbour(rng, samples)
            out[f"LIC{i}.OP"] = other
        else:
            white = rng.standard_normal(samples)
            root = float(rng.uniform(0.0, 0.95))
            out[f"TI{i}"] = np.cumsum(white) if kind == "walk" else np.convolve(white, root ** np.arange(60))[:samples]
    return dict(list(out.items())[:count])


def through(signal: FloatArray, lag: float, dead: int) -> FloatArray:
    """A signal (n,) through a first-order lag and a dead time, both in samples."""
    keep, out = float(np.exp(-1.0 / lag)), np.empty_like(signal)
    state = signal[0]
    for k, x in enumerate(signal):
        state = keep * state + (1.0 - keep) * x
        out[k] = state
    return np.concatenate([np.full(dead, out[0]), out[:out.size - dead]])


def made(seed: int, kind: str) -> tuple[Known, str, float]:
    """A loop with its tags, the name of the tag that drives it, and the time in s by which it is ahead."""
    rng, known = np.random.default_rng([seed, 41]), sticky(seed, samples=SAMPLES)
    tags = tags_of(rng, SAMPLES + EARLY)
    source, ahead = "", 0.0
    if kind == TAG:
        source = list(tags)[int(rng.integers(len(tags)))]
        lag, dead = float(np.exp(rng.uniform(np.log(1.0), np.log(20.0)))), int(rng.integers(0, 60))
        moved, ahead = through(tags[source], lag, dead)[EARLY:], lag + dead
        swing = float(np.ptp(known.loop.process_value[SAMPLES // 10:]))
        moved = moved * (swing * float(rng.uniform(0.1, 0.4)) / np.ptp(moved))
        loop = simulate(known.setting, seed=seed, disturbance=moved - moved.mean()).loop
        known = replace(known, loop=replace(loop, position=None))
    loop = replace(known.loop, extras={name: x[EARLY:].round(4) for name, x in tags.items()})
    return replace(known, loop=loop), source, ahead


def quick(known: Known) -> store.Row:
    """Effects that a search names which asks for tags, a sine and a lag only: no rival stops a false name."""
    on = resume_search(known.loop, identify(known.loop, options=Options(base_only=True)), seed=0)
    on.search.only = frozenset({MEASURED, SINE, "extra-lag"})
    winner = decide_answer(on.search, on.search.run()).winner
    done = winner.scored.done
    values = done.model.named(done.values)
    tag = next((name for name in winner.spec.effects if name.startswith(MEASURED)), "")
    said = "; ".join(f"{e.what} {e.scored.done.gain_over(on.search.memo[e.parent].scored.done):.0f} BIC"
                     for e in on.search.memo.values() if e.op == "add" and not e.failed and e.scored.full)
    return {"named": list(winner.spec.effects), "S_told": done.evaluated.values["S"], "statement": said,
            "told_s": values[f"{tag}:dead_time_s"] + values[f"{tag}:lag_s"] if tag else None}


def whole(known: Known) -> store.Row:
    """Effects that `diagnose` names."""
    study = diagnose(known.loop, identify(known.loop), apply=True)
    return {"named": of_model(study), "S_told": study.estimate.S if study.estimate else None,
            "told_s": told_ahead(study),
            "statement": next((c.statement for c in study.candidates if c.effect == MEASURED and c.accepted), "")}


def one(seed: int, kind: str, whole_catalogue: bool = False) -> store.Row:
    """One loop: the effects named, the tag, and its time ahead."""
    known, source, ahead = made(seed, kind)
    start = time.process_time()
    row = (whole if whole_catalogue else quick)(known)
    named = row["named"]
    tag = next((parse(name)[1] for name in named if parse(name)[0].name == MEASURED), "")
    return {"seed": seed, "kind": kind, "source": source, "ahead_s": ahead, "tag": tag, "S": known.S, **row,
            "cpu_s": time.process_time() - start}


def told_ahead(study: Study) -> float | None:
    """Dead time and lag of the tag named, in s."""
    values = {p.name: p.value for step in study.steps for p in step.parameters if (p.effect or "").startswith(MEASURED)}
    return values["dead_time_s"] + values["lag_s"] if values else None


def table(found: list[store.Row]) -> None:
    """Print the shares of each kind."""
    for kind in KINDS:
        rows = [r for r in found if r["kind"] == kind]
        if not rows:
            continue
        tag = sum(r["tag"] == r["source"] for r in rows if kind == TAG)
        false = [r for r in rows if r["tag"] and r["tag"] != r["source"]]
        errors = [abs(r["told_s"] - r["ahead_s"]) for r in rows if kind == TAG and r["tag"] == r["source"]]
        print(f"{kind:6s} {len(rows):4d} loops: " + (f"right tag {tag}, " if kind == TAG else "")
              + f"false tag {len(false)}, median CPU {np.median([r['cpu_s'] for r in rows]):.1f} s"
              + f", mean {np.mean([r['cpu_s'] for r in rows]):.1f} s"
              + (f", median error of the time ahead {np.median(errors):.1f} s" if errors else ""))
        print("       named: " + ", ".join(f"{n} {name}" for name, n in Counter(
            name.partition(":")[0] for r in rows for name in r["named"]).most_common()))
        for r in false:
            print(f"       seed {r['seed']}: {r['tag']}: {r['statement']}")


def calibrate(draws: int = 200) -> None:
    """Print what the best of tags times lags gains on white noise by chance, beside 2 ln M."""
    rng = np.random.default_rng(1)
    print("tags  delays     M  2 ln M   median     90 %     99 %  share beyond 2 ln M")
    for tags, delays in ((1, 30), (1, 120), (5, 120), (20, 120), (80, 120)):
        best = np.empty(draws)
        for i in range(draws):
            white, others = whiten_signals(rng.standard_normal(SAMPLES), rng.standard_normal((SAMPLES, tags)))
            best[i] = max(lagged_gains(white, x, np.zeros(1), delays - 1).max() for x in others.T)
        price = 2.0 * np.log(tags * delays)
        middle, most, last = np.quantile(best, (0.5, 0.9, 0.99))
        print(f"{tags:4d} {delays:7d} {tags * delays:6d} {price:7.1f} {middle:8.1f} {most:8.1f} {last:8.1f} "
              f"{np.mean(best > price):8.2f}")


def main() -> None:
    """Run the loops and print the table, or the calibration."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=100, help="of each kind")
    parser.add_argument("--first", type=int, default=60_000, help="first seed")
    parser.add_argument("--kind", choices=KINDS, action="append")
    parser.add_argument("--whole", action="store_true", help="ask for the whole catalogue, ten times as long")
    parser.add_argument("--calibrate", action="store_true")
    store.options(parser, out="neighbours.jsonl")
    given = parser.parse_args()
    if given.calibrate:
        calibrate()
        return
    tasks = [(f"{kind} {seed}", (seed, kind, given.whole)) for seed in range(given.first, given.first + given.loops)
             for kind in given.kind or KINDS]
    table(store.run(tasks, one, given))


if __name__ == "__main__":
    main()
