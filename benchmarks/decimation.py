"""Bias of S and J where a historian keeps one scan of the controller in several, and where the tool abstains.

Run: python benchmarks/decimation.py [--loops 6] [--keep 1,2,3,5,10] [--noise 0.05,0.5,1,3] [--between auto]

Loops with a 1 s scan, PI control and S of 1 to 6 %, simulated at 1 s and thinned afterwards. Noise is in % of the swing
of y and is seen by the controller at every scan, kept or not. Errors are in % of S (J, too: it may be small). `chosen`
is the method's choice for the command between its samples.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.verbs.identify import Options, identify

DURATION_S = 3000.0


def setting(seed: int) -> Setting:
    """A first-order loop with SIMC tuning whose valve sticks."""
    rng = np.random.default_rng([seed, 5])
    T = float(np.exp(rng.uniform(np.log(6.0), np.log(25.0))))
    L, K = T * rng.uniform(0.3, 1.0), rng.uniform(0.7, 3.0)
    wanted = L * rng.uniform(0.8, 1.5)
    S = float(rng.uniform(1.0, 6.0))
    return Setting(Plant(K, T, L), Controller(T / (K * (wanted + L)), min(T, 4.0 * (wanted + L)), scan_s=1.0), S,
                   S * float(rng.uniform(0.3, 0.9)), duration_s=DURATION_S, setpoint_moves=((0.0, 3.0),))


def decimated(seed: int, keep: int, noise_percent: float) -> tuple[Loop, Setting]:
    """The record of which one scan in `keep` was exported, and its truth."""
    known = setting(seed)
    quiet = simulate(known, seed=seed).loop.process_value
    swing = float(np.ptp(quiet[quiet.size // 10:]))
    loop = simulate(replace(known, noise_sd=noise_percent / 100.0 * swing), seed=seed).loop
    assert loop.setpoint is not None and loop.used is not None
    return replace(loop, output=loop.output[::keep], process_value=loop.process_value[::keep], position=None,
                   setpoint=loop.setpoint[::keep], used=loop.used[::keep], step_s=float(keep)), known


def row(keep: int, noise: float, loops: int, between: str) -> str:
    """One line of the table."""
    S, J, held, chosen, withheld = [], [], 0, Counter[str](), 0
    for seed in range(loops):
        loop, known = decimated(seed, keep, noise)
        way = "hold" if keep == 1 and between == "decimated" else between
        study = identify(loop, options=Options(between=way, base_only=True))
        if study.estimate is None:
            chosen[str(study.verdict.evidence.code)] += 1
            continue
        e = study.estimate
        S.append(100.0 * (e.S / known.S - 1.0))
        J.append(100.0 * (e.J - known.J) / known.S)
        withheld += e.S_interval is None
        held += e.S_interval is not None and e.S_interval[0] <= known.S <= e.S_interval[1]
        warned = any(f.code == "scans-too-noisy" for f in study.steps[0].findings)
        chosen[study.steps[0].model["between"] + " (warned)" * warned] += 1
    words = ", ".join(f"{n} {word}" for word, n in sorted(chosen.items()))
    if not S:
        return f"{keep:4d} {noise:7.2f}  {'abstains':>42}  {words}"
    return (f"{keep:4d} {noise:7.2f}  {np.median(S):+7.2f} {np.abs(S).max():6.1f}  {np.median(J):+7.2f} "
            f"{np.abs(J).max():6.1f}  {f'{held} of {len(S) - withheld}' if withheld < len(S) else 'withheld':>13s}"
            f"  {words}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=6)
    parser.add_argument("--keep", default="1,2,3,5,10")
    parser.add_argument("--noise", default="0.05,0.5,1,3")
    parser.add_argument("--between", default="auto")
    a = parser.parse_args()
    print("keep noise %  S: median  worst  J: median  worst  S in interval  chosen")
    for noise in a.noise.split(","):
        for keep in a.keep.split(","):
            print(row(int(keep), float(noise), a.loops, a.between), flush=True)


if __name__ == "__main__":
    main()
