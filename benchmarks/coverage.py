"""Coverage of the 90 % intervals of `identify` on simulated loops whose valve sticks, by family of plants.

Run: python benchmarks/coverage.py [--seeds 60000:60030] [--family steady] [--level 0.9] [--minutes 20] [--jobs 1]
     [--out FILE] [--no-intervals]
A line counts how often the intervals hold S, J, gain, lags and dead time, and gives their median width as a share of
the truth. Lags and dead time count where the model has the order of the process. An interval in pieces holds what one
of its pieces holds. *Open* are answers that call J unknown, *alike* those that list a model which explains the record
as well. Loops without an answer are counted as silent; beyond 15 % of a family they count as missed.

Targets at 90 %: S and J of all families together in 87 to 95 %, and each family of 100 loops or more inside the 99 %
band of a binomial number around 90 %. With --level the thresholds behind the intervals are those of another level.
CPU time is that of `identify`, and of `diagnose --apply` after it in the family with hidden effects. With
--no-intervals it is the time without them, and there is nothing to cover.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import numpy as np
import rows as store
from loops import noisy, process, sticky, tuned, wandering
from loops_with_effects import loop_of
from rounding import in_steps
from scipy.stats import binom, chi2

from stictionid.fit.intervals.assemble import INTERVAL_THRESHOLD as SMOOTH
from stictionid.fit.intervals.assemble import PROCESS_THRESHOLD as PROCESS
from stictionid.model.closed_loop import Setting, simulate
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.study import Estimate

NUMBERS = ("S", "J", "gain", "lags", "dead time")
LEVEL, LEAST, MOST = 0.9, 0.87, 0.95
# Loops from which on a family is judged by itself, the level of its band, and the share that may stay without answer.
JUDGED, BAND, SILENT = 100, 0.99, 0.15
# Samples of a record, rows of the scan in one of a slow export, and the coefficient of coloured noise.
SAMPLES, ROWS, ROOT = 1200, 3, 0.8
# Steps of a rounded OP in %, and of its PV in standard deviations of the noise.
OUTPUT_STEP, PV_STEP = 0.1, 1.0
# Hidden effects in turn, under which S and J are those of the setting; noise as a share of the swing, and samples.
HIDDEN, SHARE, ROWS_HIDDEN = ("travel-limit", "sinusoidal-disturbance", "extra-lag", "step-disturbance", "re-sticking",
                              "gain-nonlinearity", "slip-overshoot", "ramp-disturbance"), 0.01, 1500
# Scatter of the break-away force as a share of it, speed of a valve that always rests in % / s, least cycles of a
# steady loop, and the largest factor by which its controller is slower than its tuning rule.
SCATTER, RESTS, CYCLES, SLOWER = 0.03, 1e3, 5, 6.0


def scanned(seed: int, scatter: float = 0.0, samples: int = SAMPLES) -> tuple[Loop, Setting]:
    """A loop whose controller scans at the samples, with noise of 0.5 to 5 % of PV's swing."""
    for attempt in range(20):
        known = sticky(seed + attempt * 1_000_000, samples=samples)
        setting = known.setting
        c = replace(setting.controller, scan_s=1.0)
        setting = replace(setting, controller=c, noise_sd=0.0, scatter=scatter * 0.5 * (setting.S + setting.J))
        again = noisy(setting, None, known.noise_share, 0.0, seed)
        if again is not None:
            return again.loop, again.setting
    raise RuntimeError(f"seed {seed} gives no loop")


def steady(seed: int) -> tuple[Loop, Setting]:
    """A steady limit cycle: one setpoint move at the start and none after; every second valve rests after each slip."""
    rng = np.random.default_rng([seed, 41])
    while True:
        plant, _, _ = process(rng)
        controller = tuned(replace(plant, gain=plant.gain * float(np.exp(rng.uniform(0.0, np.log(SLOWER))))), rng, 1.0)
        S = float(rng.uniform(1.5, 6.0))
        effects = (("re-sticking", {"restick_speed": RESTS}),) if seed % 2 else ()
        setting = Setting(plant, controller, S, S * float(rng.uniform(0.2, 0.9)), duration_s=1400.0,
                          setpoint_moves=((5.0, float(rng.uniform(1.0, 4.0))),), effects=effects)
        quiet = simulate(setting, seed=seed).loop
        swing = float(np.ptp(quiet.process_value[quiet.samples // 2:]))
        setting = replace(setting, noise_sd=swing * float(np.exp(rng.uniform(np.log(0.005), np.log(0.03)))))
        loop = simulate(setting, seed=seed).loop
        if swing > 0.0 and len(find_range(loop).cycles) >= CYCLES:
            return replace(loop, position=None), setting


def slow(seed: int) -> tuple[Loop, Setting]:
    """One row in three of a loop whose controller scans every second."""
    loop, setting = scanned(seed, samples=SAMPLES * ROWS)
    pick = slice(0, None, ROWS)
    assert loop.setpoint is not None
    return Loop(output=loop.output[pick], process_value=loop.process_value[pick], setpoint=loop.setpoint[pick],
                step_s=loop.step_s * ROWS, units=loop.units), setting


def rounded(seed: int) -> tuple[Loop, Setting]:
    """A scanned loop with OP in steps of 0.1 % and PV in steps of the standard deviation of its noise."""
    loop, setting = scanned(seed)
    return replace(loop, output=in_steps(loop.output, OUTPUT_STEP),
                   process_value=in_steps(loop.process_value, PV_STEP * setting.noise_sd)), setting


def _known(seed: int, colour: float) -> tuple[Loop, Setting]:
    known = sticky(seed, colour=colour, samples=SAMPLES)
    return known.loop, known.setting


def loaded(seed: int) -> tuple[Loop, Setting]:
    """A loop under a load that wanders."""
    known = wandering(seed, samples=SAMPLES)
    return known.loop, known.setting


def hidden(seed: int) -> tuple[Loop, Setting]:
    """A loop of one of six plants with a hidden effect, noise of 1 % of the swing; `diagnose` adds what it names."""
    setting, loop, *_ = loop_of(seed, HIDDEN[seed % len(HIDDEN)], SHARE, 0.0, ROWS_HIDDEN)
    return loop, setting


FAMILIES: dict[str, Callable[[int], tuple[Loop, Setting]]] = {
    "scan": scanned, "slow": slow, "rounded": rounded, "coloured": lambda seed: _known(seed, ROOT), "load": loaded,
    "steady": steady, "scattered": lambda seed: scanned(seed, SCATTER), "hidden": hidden}
"""Name to the loop of a seed and its setting."""


def held(e: Estimate, setting: Setting) -> tuple[dict[str, list[bool]], dict[str, float]]:
    """For each number whether its intervals hold the truth, and the width of the first one as a share of it."""
    plant = setting.plant
    lags = sorted((t for t in (plant.time_constant_s, plant.second_time_constant_s) if t > 0.0), reverse=True)
    S, J = ((getattr(e, f"{name}_pieces", None) or [getattr(e, f"{name}_interval")]) for name in ("S", "J"))
    numbers = {"S": [(S, setting.S)], "J": [(J, setting.J)], "gain": [([e.gain_interval], plant.gain)]}
    if len(e.time_constants_s) == len(lags) and not e.integrating:
        numbers |= {"lags": [([span], t) for span, t in zip(e.time_constants_intervals, lags, strict=True)],
                    "dead time": [([e.dead_time_interval], plant.dead_time_s)]}
    holds = {name: [any(span is not None and span[0] <= truth <= span[1] for span in spans) for spans, truth in mine]
             for name, mine in numbers.items()}
    wide = {name: float(sum(span[1] - span[0] for span in spans if span is not None) / truth)
            for name, ((spans, truth), *_) in numbers.items()}
    return holds, wide


def set_level(level: float) -> None:
    """Set the thresholds behind the intervals of this process to those of a level, as a normal parameter would."""
    from stictionid.fit.intervals import along_path, assemble

    one, known = float(chi2.ppf(level, 1)), float(chi2.ppf(LEVEL, 1))
    for module in (assemble, along_path):
        module.INTERVAL_THRESHOLD = SMOOTH * one / known
        module.INTERVAL_LEVEL = level
    assemble.PROCESS_THRESHOLD, along_path.POINT_90 = PROCESS * one / known, one**0.5


def one(family: str, seed: int, intervals: bool, level: float = LEVEL) -> store.Row:
    """One loop identified."""
    from stictionid.verbs.diagnose import diagnose
    from stictionid.verbs.identify import Options, identify

    set_level(level)
    try:
        loop, setting = FAMILIES[family](seed)
    except RuntimeError as error:
        return {"family": family, "seed": seed, "out": str(error)}
    start = time.process_time()
    study = identify(loop, options=Options() if intervals else Options(intervals=False))
    if family == "hidden" and study.estimate is not None:
        study = diagnose(loop, study, apply=True)
    row: store.Row = {"family": family, "seed": seed, "cpu_s": time.process_time() - start, "S": setting.S,
                      "J": setting.J, "rests": bool(setting.effects), "verdict": study.verdict.stiction}
    e = study.estimate
    if e is None:
        return row
    row |= {"found": [e.S, e.J], "spans": [e.S_interval, e.J_interval], "known": e.J_known,
            "effects": list(study.steps[-1].effects), "alike": len(study.equivalents)}
    if e.S_interval is not None:
        holds, wide = held(e, setting)
        row |= {"holds": holds, "wide": wide}
    return row


def table(rows: Iterable[store.Row], level: float = LEVEL) -> list[str]:
    """Print one line a family; returns the targets missed."""
    rows, missed = [r for r in rows if "out" not in r], []
    pooled: dict[str, list[bool]] = {"S": [], "J": []}
    print(f"{'family':10s} {'loops':>6s} {'silent':>7s}" + "".join(f"{n:>10s} {'width':>6s}" for n in NUMBERS)
          + f"{'open':>6s} {'alike':>6s} {'CPU s':>6s}")
    for family in FAMILIES:
        part = [r for r in rows if r["family"] == family]
        told = [r for r in part if "holds" in r]
        if not part:
            continue
        cells = ""
        for name in NUMBERS:
            hits = [hit for r in told for hit in r["holds"].get(name, ())]
            wide = [r["wide"][name] for r in told if name in r["wide"]]
            lost = round(max(len(part) - len(told) - SILENT * len(part), 0.0)) if name in pooled and told else 0
            share = sum(hits) / max(len(hits) + lost, 1)
            cells += f"{100 * share:9.0f}% {100 * np.median(wide) if wide else 0.0:5.1f}%"
            if name in pooled:
                pooled[name] += [*hits, *[False] * lost]
                low, high = binom.interval(BAND, len(hits) + lost, level) if hits else (0, 0)
                if len(part) >= JUDGED and hits and not low <= sum(hits) <= high:
                    missed.append(f"{family}: {name} in {sum(hits)} of {len(hits) + lost}, the band is {low:.0f} to "
                                  f"{high:.0f}")
        answers = [r for r in part if "found" in r]
        print(f"{family:10s} {len(part):6d} {len(part) - len(answers):7d}{cells}"
              f"{sum(not r['known'] for r in answers):6d} {sum(r['alike'] > 0 for r in answers):6d} "
              f"{np.mean([r['cpu_s'] for r in part]):6.1f}")
    for name, hits in pooled.items():
        share = sum(hits) / max(len(hits), 1)
        print(f"all families: {name} in {100 * share:.1f} % of {len(hits)}")
        if hits and level == LEVEL and not LEAST <= share <= MOST:
            missed.append(f"all families: {name} in {100 * share:.1f} %")
    return missed


def main() -> int:
    """Run the loops and print the table; the exit code says whether a target was missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="60000:60030", help="first seed and the one after the last")
    parser.add_argument("--family", action="append", choices=list(FAMILIES), help="repeatable; default all")
    parser.add_argument("--level", type=float, default=LEVEL, help="level of the intervals, 0 to 1")
    parser.add_argument("--no-intervals", action="store_true", help="the time without intervals")
    store.options(parser, out="coverage.jsonl")
    given = parser.parse_args()
    first, after = map(int, given.seeds.split(":"))
    at = "" if given.level == LEVEL else f" {given.level:g}"
    tasks = [(f"{family} {seed} {not given.no_intervals}{at}", (family, seed, not given.no_intervals, given.level))
             for seed in range(first, after) for family in given.family or FAMILIES]
    keys = {key for key, _ in tasks}
    missed = table((r for r in store.run(tasks, one, given) if r["key"] in keys), given.level)
    print("\ntargets missed: " + ("none" if not missed else "; ".join(missed)))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
