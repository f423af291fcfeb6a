"""False random walks against the margin that a walk must gain, and the power on true ones.

Run: python benchmarks/noise_family.py [--records 400] [--samples 1500] [--missing 0] [--seed 20000]

Noise is simulated without a loop, fitted by numerics/noise/fit.py, and a walk named where its BIC beats that of the
best stationary noise by the margin. `gain` is the median of that difference, beside its 99th percentile and largest
value. WALK_MARGIN is a margin at which no stationary noise of the table is a walk in more than 1 % of its records. The
last table has the CPU time of one fit.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from stictionid.numerics.noise.family import WALK, Noise
from stictionid.numerics.noise.fit import WALK_MARGIN, fits_of

MARGINS = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0)
STATIONARY = {
    "white": Noise(),
    **{f"AR(1) {rho:g}": Noise((-rho,)) for rho in (0.5, 0.7, 0.8, 0.9, 0.95)},
    "AR(2), period 20, 3 cycles": Noise((-1.805, 0.9006)),
    "AR(1) 0.9, measured": Noise((), 0.9, 0.6),
    "AR(1) 0.95, measured": Noise((), 0.95, 0.8),
}
WALKS = {f"walk, 1 - theta = {1.0 - theta:.2g}": Noise((), 1.0, theta)
         for theta in (0.99, 0.98, 0.95, 0.9, 0.8, 0.5, 0.0)}
WALKS["walk, 1 - theta = 0.2, AR(1) 0.6"] = Noise((-0.6,), 1.0, 0.8)


def simulated(noise: Noise, samples: int, rng: np.random.Generator, burn: int = 1000) -> np.ndarray:
    """Noise (samples,) with unit innovations; a walk's differences have settled before it begins."""
    e = rng.standard_normal(samples + burn)
    polynomial = np.array([1.0, *noise.taps]) if noise.walks else noise.plain[0]
    theta = noise.theta if noise.walks else noise.plain[1]
    moved = e - theta * np.concatenate([[0.0], e[:-1]])
    out = np.zeros(e.size)
    p = polynomial.size - 1
    for t in range(e.size):
        past = out[max(t - p, 0):t][::-1]
        out[t] = moved[t] - polynomial[1:1 + past.size] @ past
    return np.cumsum(out[burn:]) if noise.walks else out[burn:]


def gains(noise: Noise, records: int, samples: int, missing: float, seed: int) -> np.ndarray:
    """BIC (records,) that the best walk gains over the best stationary noise."""
    out = []
    for record in range(records):
        rng = np.random.default_rng([seed, record])
        v = simulated(noise, samples, rng)
        found = fits_of(v, rng.random(samples) >= missing)
        out.append(min(f.bic for kind, f in found.items() if kind != WALK) - found[WALK].bic)
    return np.array(out)


def table(noises: dict[str, Noise], args: argparse.Namespace) -> dict[str, np.ndarray]:
    """Print the share of records named a walk at every margin."""
    print(f"{'noise':36}" + "".join(f"{margin:>8g}" for margin in MARGINS) + f"{'gain':>9}{'p99':>8}{'max':>8}")
    found = {}
    for name, noise in noises.items():
        gain = found[name] = gains(noise, args.records, args.samples, args.missing, args.seed)
        print(f"{name:36}" + "".join(f"{np.mean(gain > margin):8.1%}" for margin in MARGINS)
              + f"{np.median(gain):9.1f}{np.quantile(gain, 0.99):8.1f}{gain.max():8.1f}", flush=True)
    return found


def times() -> None:
    """Print the shortest of 5 times of one fit, all kinds and orders, in ms."""
    print(f"\n{'CPU time of one fit in ms':36}{'all':>9}{'10 % missing':>15}{'every 5th kept':>16}")
    for samples in (2000, 100_000):
        for name, noise in {"AR(1) 0.8": Noise((-0.8,)), "walk, 0.2": Noise((), 1.0, 0.8)}.items():
            rng = np.random.default_rng(1)
            v = simulated(noise, samples, rng)
            row = []
            for good in (np.ones(samples, np.bool_), rng.random(samples) > 0.1, np.arange(samples) % 5 == 0):
                spent = []
                for _ in range(5 if samples < 10_000 else 2):
                    start = time.process_time()
                    fits_of(v, good)
                    spent.append(time.process_time() - start)
                row.append(1e3 * min(spent))
            print(f"{f'{name}, {samples} samples':36}{row[0]:9.0f}{row[1]:15.0f}{row[2]:16.0f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--records", type=int, default=400)
    parser.add_argument("--samples", type=int, default=1500)
    parser.add_argument("--missing", type=float, default=0.0, help="share of the samples that are missing at random")
    parser.add_argument("--seed", type=int, default=20_000)
    args = parser.parse_args()
    print(f"{args.records} records of {args.samples} samples, {args.missing:.0%} missing; share named a walk at a "
          f"margin in BIC (default {WALK_MARGIN:g})\n")
    clean = table(STATIONARY, args)
    least = next((m for m in range(100) if all(np.mean(g > m) <= 0.01 for g in clean.values())), None)
    print(f"\nleast margin with at most 1 % false in every row: {least}\n")
    table(WALKS, args)
    times()


if __name__ == "__main__":
    main()
