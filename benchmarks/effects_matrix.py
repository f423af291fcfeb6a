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
from dataclasses import replace
from multiprocessing import get_context

import numpy as np

from stictionid.diagnose import diagnose
from stictionid.effects import catalogue, parse
from stictionid.errors import StictionidError
from stictionid.identify import identify
from stictionid.simulate import Controller, Plant, Setting, simulate

PLANTS = ((Plant(1.2, 20.0, 4.0), Controller(0.7, 12.0)), (Plant(2.0, 6.0, 3.0), Controller(0.15, 6.0)),
          (Plant(3.0, 5.0, 5.0), Controller(0.1, 5.0)), (Plant(0.8, 12.0, 2.0), Controller(1.2, 8.0)))
KINDS = ("scan", "scan", "moving", "karnopp")
# What a Karnopp valve itself may be named for: it rests between scans, or jumps past its place.
PHYSICAL = {"re-sticking", "slip-overshoot"}


def loop_of(seed: int, effect: str | None, noise: float, colour: float, samples: int):
    """One simulated loop: its setting, its record, and how it was made."""
    rng = np.random.default_rng([seed, 77])
    plant, controller = PLANTS[seed % len(PLANTS)]
    kind = KINDS[(seed // len(PLANTS)) % len(KINDS)]
    S = float(rng.uniform(3.0, 7.0))
    J = float(S * rng.uniform(0.35, 0.85))
    moves = [(0.0, float(rng.uniform(2.0, 4.0)))]
    if seed % 5:  # one loop in five has no setpoint change but the first
        moves += [(float(t) * samples, float(s)) for t, s in
                  zip((0.27, 0.5, 0.75), rng.uniform(2.0, 5.0, 3) * (-1, 1, -1), strict=True)]
    setting = Setting(plant, replace(controller, scan_s=0.0 if kind == "moving" else 1.0), S=S, J=J,
                      law="karnopp" if kind == "karnopp" else "chen", duration_s=float(samples),
                      setpoint_moves=tuple(moves))
    clean = simulate(setting, seed=seed).loop
    half = clean.process_value[samples // 4:]
    if np.ptp(half) < 0.2:  # this loop does not cycle by itself, so nothing could be identified
        moves += [(0.2 * samples * i, 3.0 * (-1) ** i) for i in (1, 2, 3, 4)]
        setting = replace(setting, setpoint_moves=tuple(moves))
        clean = simulate(setting, seed=seed).loop
        half = clean.process_value[samples // 4:]
    sd = noise * float(np.ptp(half))
    effects = []
    if effect:
        effects.append((effect, sized(effect, rng, setting, clean, sd)))
    if colour and effect not in ("coloured-noise", "random-walk-disturbance"):
        effects.append(("coloured-noise", {"root": colour, "innovation_sd": sd * float(np.sqrt(1.0 - colour**2))}))
    setting = replace(setting, effects=tuple(effects), noise_sd=0.0 if colour else sd)
    return setting, simulate(setting, seed=seed).loop, kind, sd


def sized(name: str, rng, s: Setting, clean, sd: float) -> dict:
    """Parameters of a hidden effect: large enough to show at this noise, small enough to be physical."""
    u = rng.uniform
    length, T = s.duration_s, s.plant.time_constant_s
    v = clean.position
    speeds = np.abs(np.diff(clean.output))
    speeds = speeds[speeds > 1e-9]
    sign = float(rng.choice([-1.0, 1.0]))
    swing = float(np.ptp(clean.process_value[clean.samples // 4:]))
    return {
        "asymmetric-stiction": lambda: {"jump_up": s.J * (1 + sign * u(0.25, 0.5)),
                                        "jump_down": s.J * (1 - sign * u(0.25, 0.5))},
        "stiction-drift": lambda: {"stickband_growth": s.S * u(0.15, 0.4) * 1000 / length,
                                   "jump_growth": s.J * u(0.0, 0.2) * 1000 / length},
        "re-sticking": lambda: {"restick_speed": float(np.quantile(speeds, u(0.4, 0.9)))},
        "slip-overshoot": lambda: {"overshoot": u(1.3, 1.8)},
        "travel-limit": lambda: {"upper": float(np.quantile(v, u(0.75, 0.9)))} if sign > 0 else
            {"lower": float(np.quantile(v, u(0.1, 0.25)))},
        "slew-limit": lambda: {"rate": s.J * u(0.05, 0.2)},
        "valve-characteristic": lambda: {"log_rangeability": sign * u(2.5, 4.5)},
        "gain-nonlinearity": lambda: {"curvature": sign * u(0.25, 0.5) / (0.5 * swing)},
        "extra-lag": lambda: {"second_time_constant_s": T * u(0.3, 0.8)},
        "sinusoidal-disturbance": lambda: {"period_s": T * u(3.0, 11.0), "amplitude": swing * u(0.05, 0.12),
                                           "phase": u(-3.0, 3.0)},
        "step-disturbance": lambda: {"time_s": length * u(0.25, 0.75), "size": sign * swing * u(0.1, 0.3),
                                     "at": str(rng.choice(["output", "load"]))},
        "ramp-disturbance": lambda: {"start_s": length * u(0.1, 0.5), "rate": sign * swing * u(0.3, 0.6) / length,
                                     "at": str(rng.choice(["output", "load"]))},
        "narrow-band-disturbance": lambda: {"period_s": T * u(1.5, 6.0), "coherence_cycles": u(2.0, 6.0),
                                            "amplitude": swing * u(0.05, 0.1)},
        "random-walk-disturbance": lambda: {"innovation_sd": sd * u(0.6, 1.5)},
        "coloured-noise": lambda: {"root": u(0.6, 0.9), "innovation_sd": sd},
        "measured-disturbance": lambda: {"lag_s": u(1.0, T), "dead_time_s": u(0.0, 5.0), "gain": swing * u(0.05, 0.15)},
    }[name]()


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


def right(row: dict) -> bool:
    """Whether the hidden effect came first or as an equivalent; a Karnopp valve may be named for its inertia."""
    truth, names = row["effect"], list(row["found"])
    if row["colour"]:  # coloured noise is there, so naming it is right
        names = [n for n in names if n != "coloured-noise"]
    if row["kind"] == "karnopp" and truth not in PHYSICAL:
        names = [n for n in names if n not in PHYSICAL]
    if truth == "none":
        return not names
    if truth in PHYSICAL and row["kind"] == "karnopp":
        return bool(set(row["found"]) & PHYSICAL)
    return bool(names) and (names[0] == truth or (truth in row["equivalent"] and len(names) <= 1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="10000:10004", help="first:last+1")
    parser.add_argument("--effects", default="", help="names, comma-separated; all when empty, 'none' for clean loops")
    parser.add_argument("--noise", type=float, default=0.01, help="share of PV's swing")
    parser.add_argument("--colour", type=float, default=0.0, help="root of AR(1) noise; 0 is white")
    parser.add_argument("--samples", type=int, default=1500)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=6.0, help="no new loops after so long")
    parser.add_argument("--apply", action="store_true", help="add what is named and repeat")
    parser.add_argument("--rows", default="", help="write one JSON line per loop here")
    parser.add_argument("--quiet", action="store_true")
    a = parser.parse_args()
    first, last = (int(x) for x in a.seeds.split(":"))
    names = [None] if a.effects == "none" else a.effects.split(",") if a.effects else list(catalogue())
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
