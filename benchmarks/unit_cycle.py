"""One cycle, many loops: a unit of six loops in which one sticky valve makes four others swing.

A flow loop with a sticky valve feeds a temperature, which feeds a composition; the flow also disturbs a level and a
pressure. A sixth loop stands apart. All are PI loops of first order with dead time, written from the equations alone.

    python benchmarks/unit_cycle.py -o /path/to/new/folder
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

SAMPLES, START_S = 2400, 1_772_000_000  # one a second, from 2026-02-25
S, J = 5.0, 2.5


class Member(NamedTuple):
    """One loop: process (gain, lag and dead time in s), PI (gain, s), and the loop that disturbs it by so much."""

    gain: float
    lag: float
    dead: int
    kc: float
    ti: float
    by: str = ""
    much: float = 0.0


UNIT = {
    "FIC101": Member(1.0, 8.0, 2, 1.0, 9.0),
    "TIC102": Member(1.4, 25.0, 6, 0.9, 30.0, "FIC101", 0.8),
    "AIC103": Member(0.8, 30.0, 10, 0.8, 40.0, "TIC102", 1.2),
    "LIC104": Member(1.2, 40.0, 3, 1.2, 60.0, "FIC101", 0.7),
    "PIC105": Member(0.9, 12.0, 2, 0.8, 15.0, "FIC101", 0.5),
    "FIC106": Member(1.1, 6.0, 2, 0.8, 8.0),
}
STICKY = "FIC101"


def simulated(seed: int = 1, samples: int = SAMPLES) -> dict[str, dict[str, np.ndarray]]:
    """Setpoint, process value and output (samples,) of every loop."""
    rng = np.random.default_rng(seed)
    out = {name: {role: np.full(samples, 50.0) for role in ("SP", "PV", "OP")} for name in UNIT}
    noise = {name: 0.03 * rng.standard_normal(samples) for name in UNIT}
    place, held, way = 50.0, True, 0.0
    state, total, valve = dict.fromkeys(UNIT, 0.0), dict.fromkeys(UNIT, 0.0), {n: [50.0] * samples for n in UNIT}
    out[STICKY]["SP"][:] = 52.0
    for k in range(1, samples):
        for name, m in UNIT.items():
            pushed = m.much * (out[m.by]["PV"][k - 1] - 50.0 - 2.0 * (m.by == STICKY)) if m.by else 0.0
            moved = m.gain * (valve[name][max(k - 1 - m.dead, 0)] - 50.0) + pushed
            state[name] += (moved - state[name]) / m.lag
            y = 50.0 + state[name] + noise[name][k]
            e = out[name]["SP"][k] - y
            total[name] += m.kc * e / m.ti
            u = 50.0 + m.kc * e + total[name]
            if name == STICKY:
                step = u - out[name]["OP"][k - 1]
                held = held or step * way < 0.0
                way = step or way
                if not held or abs(u - place) > 0.5 * (S + J):
                    place, held = u - np.sign(u - place) * 0.5 * (S - J), False
            valve[name][k] = place if name == STICKY else u
            out[name]["PV"][k], out[name]["OP"][k] = y, u
    return out


def write(folder: Path, unit: dict[str, dict[str, np.ndarray]]) -> None:
    """One CSV a loop."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, signals in unit.items():
        stamps = np.datetime64(START_S, "s") + np.arange(len(signals["PV"]))
        with (folder / f"{name}.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["Timestamp", *(f"{name}.{role}" for role in signals)])
            rows.writerows(zip(stamps.astype(str), *(x.round(4) for x in signals.values()), strict=True))


def main() -> None:
    """Write the unit, study it with `batch`, and print who swings with whom."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--level", default="identify")
    a = parser.parse_args()
    write(a.output / "exports", simulated())
    command = [sys.executable, "-m", "stictionid", "batch", str(a.output / "exports"), "-o", str(a.output / "studies"),
               "--level", a.level, "--jobs", "1", "--quiet"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    with (a.output / "studies" / "summary.csv").open() as file:
        for row in csv.DictReader(file):
            period = float(row["period_median_s"]) if row["period_median_s"] else float("nan")
            print(f"{row['loop']:8} {row['verdict']:12} period {period:6.1f} s  "
                  f"group {row['group'] or '-'}  {row['role'] or '-'}")
    print(next(line for line in (a.output / "studies" / "summary.md").read_text().splitlines() if "Group" in line))


if __name__ == "__main__":
    main()
