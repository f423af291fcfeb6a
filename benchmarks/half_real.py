"""Half-real loops: the process value of real loops as disturbance of simulated valves, sticking and healthy.

Run: python benchmarks/half_real.py DIR [--free '*_D.*,*_E.*,*_L.*'] [--sticking 100] [--healthy 200] [--seed 1000]
     [--verdict-only] [--out half_real.jsonl] [--minutes 60] [--jobs 1]
The truth of the valve is known, and the disturbance is that of a plant. Of a file that fits `--free` (a loop without
friction) all of PV is used, of any other the quiet stretches: there the output stays within a fifth of its swing. One
row of a record is one second of the simulation. The disturbance is scaled to a share of the swing that friction
makes (0.1 to 1), and for a healthy valve to 1 to 6 %. Verdict and S are those of `identify`, and of
`diagnose --apply` after it, or with --verdict-only of `identify` alone. Rows already in the file of --out are skipped.

Targets after `diagnose --apply`: S within 3 % on 85 % of the sticking, false stiction at most 1 %, undecided at most
15 %. Exit 1 where one is missed.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import reliability
import rows as store
from loops import FEWEST, process, tuned

from stictionid.errors import StictionidError
from stictionid.historian import read_loop
from stictionid.model.closed_loop import Setting, simulate
from stictionid.record.loop import Loop, bridged
from stictionid.record.oscillation import find_range
from stictionid.record.study import Study
from stictionid.typing import FloatArray
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify

SAMPLES, SHORTEST = 1200, 300
QUIET = 0.2
"""Share of the output's swing within which a stretch is quiet."""
CLOSE, MOST_FALSE, MOST_OPEN, LEAST_CLOSE = 0.03, 0.01, 0.15, 0.85
_TRIES = 40


def stretches(loop: Loop, free: bool) -> list[FloatArray]:
    """Process values of the loop (n,), n at least SHORTEST: of its segments, or of their quiet stretches."""
    found = []
    for part in loop.segments:
        y, u = bridged(loop.process_value)[part], bridged(loop.output)[part]
        if free:
            found.append(y)
            continue
        limit, first = QUIET * float(np.ptp(loop.output[loop.driven])), 0
        low = high = float(u[0])
        for k, value in enumerate([*u.tolist(), np.inf]):
            if max(high, value) - min(low, value) > limit:
                found.append(y[first:k])
                first, low, high = k, value, value
            low, high = min(low, value), max(high, value)
    return [y for y in found if y.size >= SHORTEST and np.ptp(y) > 0]


def disturbances(folder: Path, free: list[str]) -> dict[str, list[FloatArray]]:
    """Stretches of real process values by file name; files that can't be read are named on stderr and left out."""
    found = {}
    for file in sorted(p for p in folder.iterdir() if p.is_file()):
        try:
            pieces = stretches(read_loop(file), any(fnmatch(file.name, pattern) for pattern in free))
        except StictionidError as error:
            print(f"left out: {file.name}: {error.message}", file=sys.stderr)
            continue
        if pieces:
            found[file.name] = pieces
    return found


def drawn(pieces: list[FloatArray], seed: int, sticks: bool) -> tuple[Loop, Setting, float]:
    """A simulated loop under a real disturbance, its setting, and the disturbance's swing as a share of y's."""
    rng = np.random.default_rng([seed, 41, int(sticks)])
    for attempt in range(_TRIES):
        piece = pieces[int(rng.integers(len(pieces)))]
        first = int(rng.integers(max(piece.size - SAMPLES, 0) + 1))
        real = piece[first:first + SAMPLES]
        real = (real - real.mean()) / np.ptp(real)
        plant, effects, _ = process(rng)
        S = float(np.exp(rng.uniform(np.log(0.5), np.log(8.0)))) if sticks else 0.0
        moves = ((0.0, float(rng.uniform(-5, 5))),)
        if rng.random() < 0.5:
            times = np.sort(rng.uniform(0, real.size, 12))
            level = np.clip(np.cumsum(rng.uniform(-4, 4, times.size)), -8, 8)
            moves = tuple(zip(times.tolist(), np.diff(level, prepend=0.0).tolist(), strict=True))
        setting = Setting(plant, tuned(plant, rng, float(rng.integers(0, 2))), S, S * float(rng.uniform(0.1, 1.2)),
                          duration_s=float(real.size), setpoint_moves=moves, effects=effects)
        size = float(rng.uniform(1.0, 6.0))
        if sticks:
            alone = simulate(replace(setting, setpoint_moves=moves[:1]), seed=seed).loop.process_value
            size = float(np.ptp(alone[alone.size // 10:]) * np.exp(rng.uniform(np.log(0.1), np.log(1.0))))
        loop = simulate(setting, seed=seed * _TRIES + attempt, disturbance=size * real).loop
        enough = len(moves) > 1 or len(find_range(loop).cycles) >= FEWEST
        if enough and np.ptp(loop.output) > 0.1 and np.mean((loop.output <= 0) | (loop.output >= 100)) <= 0.02:
            return replace(loop, position=None), setting, size / float(np.ptp(loop.process_value))
    raise RuntimeError(f"seed {seed} gives no loop")


def said(study: Study, S: float) -> store.Row:
    """Verdict, confidence and S of a study; the relative error of S where the valve sticks."""
    e = study.estimate
    return {"verdict": study.verdict.stiction, "confidence": study.verdict.confidence, "reason": study.verdict.reason,
            "S": None if e is None else e.S, "S_interval": None if e is None else e.S_interval,
            "S_error": None if e is None or not S else e.S / S - 1.0,
            "effects": [s.added for s in study.steps if s.added], "adequate": study.adequate}


def one(file: str, pieces: list[FloatArray], seed: int, sticks: bool, verdict_only: bool = False) -> store.Row:
    """Row of one half-real loop: truth, and what is said before and after `diagnose --apply`."""
    row: store.Row = {"file": file, "seed": seed, "truth": "stiction" if sticks else "no stiction"}
    try:
        loop, setting, share = drawn(pieces, seed, sticks)
    except RuntimeError as error:
        return row | {"out": str(error)}
    start = time.process_time()
    before = identify(loop)
    middle = time.process_time()
    after = before if verdict_only or before.estimate is None else diagnose(loop, before, apply=True)
    return row | {"S_true": setting.S, "J_true": setting.J, "share": share, "before": said(before, setting.S),
                  **said(after, setting.S), "identify_s": middle - start, "diagnose_s": time.process_time() - middle}


def table(found: list[store.Row]) -> list[str]:
    """Print what is said before and after `diagnose --apply`; returns the targets missed after it."""
    found = [r for r in found if "out" not in r]
    sticky, healthy = ([r for r in found if r["truth"] == t] for t in ("stiction", "no stiction"))
    print(f"\n{'':26s}      before   after apply")
    missed = []

    def line(words: str, part: list[store.Row], hit, limit: float | None = None, least: bool = False) -> None:
        shares = [sum(hit(r) for r in given) / max(len(part), 1) for given in ([r["before"] for r in part], part)]
        print(f"{words:26s} {100 * shares[0]:9.1f} % {100 * shares[1]:9.1f} %   of {len(part)}")
        if limit is not None and part and (shares[1] < limit if least else shares[1] > limit):
            missed.append(f"{words}: {100 * shares[1]:.1f} %")

    line("sticking: S within 3 %", sticky, lambda r: r["S_error"] is not None and abs(r["S_error"]) <= CLOSE,
         LEAST_CLOSE, True)
    line("sticking: said stiction", sticky, lambda r: r["verdict"] == "stiction")
    line("sticking: said none", sticky, lambda r: r["verdict"] == "no stiction")
    line("sticking: undecided", sticky, lambda r: r["verdict"] == "undecided", MOST_OPEN)
    line("healthy: false stiction", healthy, lambda r: r["verdict"] == "stiction", MOST_FALSE)
    line("healthy: undecided", healthy, lambda r: r["verdict"] == "undecided", MOST_OPEN)
    for words, name in (("before", "before"), ("after", "")):
        errors = [abs((r[name] if name else r)["S_error"]) for r in sticky
                  if (r[name] if name else r)["S_error"] is not None]
        if errors:
            print(f"median error of S {words}: {100 * float(np.median(errors)):.2f} %, the worst of ten "
                  f"{100 * float(np.quantile(errors, 0.9)):.1f} %")
    return missed + reliability.table(found)


def main() -> int:
    """Run the loops that are not done yet and print the table; the exit code says whether a target was missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--free", default="*_D.*,*_E.*,*_L.*", help="names of loops without friction; '*' for all")
    parser.add_argument("--sticking", type=int, default=100)
    parser.add_argument("--healthy", type=int, default=200)
    parser.add_argument("--verdict-only", action="store_true", help="no diagnose --apply after identify")
    store.options(parser, out="half_real.jsonl")
    given = parser.parse_args()
    real = disturbances(given.folder, given.free.split(","))
    if not real:
        print(f"{given.folder} has no stretch of {SHORTEST} samples of a real PV; name loops with --free",
              file=sys.stderr)
        return 2
    files = list(real)
    wanted = sorted(((k + 0.5) / n, k, sticks) for n, sticks in ((given.sticking, True), (given.healthy, False))
                    for k in range(n))
    tasks = []
    for _, k, sticks in wanted:
        file, seed = files[k % len(files)], given.seed + k
        word = f"{'sticks' if sticks else 'healthy'}{' by identify' if given.verdict_only else ''}"
        tasks.append((f"{file} {seed} {word}", (file, real[file], seed, sticks, given.verdict_only)))
    keys = {key for key, _ in tasks}
    missed = table([r for r in store.run(tasks, one, given) if r["key"] in keys])
    print("targets missed: " + ("none" if not missed else "; ".join(missed)))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
