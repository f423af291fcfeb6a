"""False noise ahead of the process against the margin that it must gain over noise at the output, and the power.

Run: python benchmarks/load_noise.py [--records 200] [--samples 1500] [--seed 30000]

Noise is simulated without a loop. The process that load noise would pass is a first-order lag of 5, 20 or 60 samples.
The gain is the BIC of the best noise at the output (numerics/noise/fit.py) less that of the best noise ahead of the
process (numerics/noise/load.py). One family of output noise is left out at a time: the margin comes from the others, at
most 1 % false in every row of theirs, and the left-out family is judged by it. `alike` of the policy is the margin in
use. Beside it stands the share in which nobody can tell: the gain is within the margin on either side.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from noise_family import STATIONARY, WALKS, simulated

from stictionid.numerics.autoregression import predicted_covariance
from stictionid.numerics.noise.family import Noise
from stictionid.numerics.noise.fit import fits_of
from stictionid.numerics.noise.likelihood import likelihood
from stictionid.numerics.noise.load import LARGEST_ORDER, ROOTS, WALK, fit_load
from stictionid.selection.policy import Policy
from stictionid.typing import FloatArray

LAGS, MARGINS, MOST_FALSE, RESPONSE = (5.0, 20.0, 60.0), (0.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0), 0.01, 4096
FAMILIES = {"white": ("white",), "AR(1)": tuple(n for n in STATIONARY if n.startswith("AR(1)") and "meas" not in n),
            "AR(2)": tuple(n for n in STATIONARY if n.startswith("AR(2)")),
            "AR(1), measured": tuple(n for n in STATIONARY if "measured" in n), "walk": tuple(WALKS)}
# Load noise by name: its root, and the white noise at the output over the innovations that the load makes in y.
LOADS = {f"load {root:g}, white {ratio:g}": (root, ratio)
         for root in (0.0, 0.5, 0.9, 0.98, 1.0) for ratio in (0.0, 1.0, 4.0)}


def passed(load: FloatArray, lag: float) -> FloatArray:
    """A load (n,) behind a first-order lag in samples, of unit gain."""
    keep, y, out = float(np.exp(-1.0 / lag)), 0.0, np.empty(load.size)
    for k, d in enumerate(load.tolist()):
        out[k] = y
        y = keep * y + (1.0 - keep) * d
    return out


def drawn(name: str, lag: float, samples: int, rng: np.random.Generator) -> FloatArray:
    """Noise (samples,) of a row, at the output or ahead of the process."""
    if name not in LOADS:
        return simulated({**STATIONARY, **WALKS}[name], samples, rng)
    root, ratio = LOADS[name]
    burn = 0 if root == 1.0 else 1000
    white, load, level = rng.standard_normal(samples + burn), np.empty(samples + burn), 0.0
    for k, w in enumerate(white.tolist()):
        load[k] = level = root * level + w
    return (passed(load, lag)[burn:]
            + ratio * (1.0 - np.exp(-1.0 / lag)) * rng.standard_normal(samples))


def gain_of(residual: FloatArray, lag: float) -> float:
    """BIC that noise ahead of a lag gains over noise at the output."""
    good, keep = np.ones(residual.size, np.bool_), float(np.exp(-1.0 / lag))
    power = np.abs(np.fft.rfft(keep ** np.arange(RESPONSE))) ** 2
    found = []
    for own, roots, rho in ((np.ones(1), ROOTS, 0.0), (np.array([1.0, -1.0]), WALK, 1.0)):
        signal = np.convolve(residual, own)[own.size - 1:residual.size]
        load = fit_load(predicted_covariance(signal, np.ones(signal.size, np.bool_), LARGEST_ORDER), signal.size, power,
                        own, roots)
        if load is not None:
            noise = Noise(tuple(load.taps.tolist()), rho)
            found.append(likelihood(residual, noise, good).bic(load.numbers))
    return min(f.bic for f in fits_of(residual, good).values()) - min(found, default=np.inf)


def gains(name: str, args: argparse.Namespace) -> dict[float, FloatArray]:
    """Gains (records,) of a row for every lag."""
    return {lag: np.array([gain_of(drawn(name, lag, args.samples, np.random.default_rng([args.seed, k])), lag)
                           for k in range(args.records)]) for lag in LAGS}


def table(names: tuple[str, ...], args: argparse.Namespace) -> dict[str, dict[float, FloatArray]]:
    """Print the share of records named a load at every margin; gains by row and lag."""
    alike = Policy().alike
    print(f"{'noise':36}{'lag':>5}" + "".join(f"{margin:>8g}" for margin in MARGINS)
          + f"{'median':>9}{'max':>8}{'no telling':>12}")
    found = {}
    for name in names:
        found[name] = gains(name, args)
        for lag, gain in found[name].items():
            print(f"{name:36}{lag:5g}" + "".join(f"{np.mean(gain >= margin):8.1%}" for margin in MARGINS)
                  + f"{np.median(gain):9.1f}{gain.max():8.1f}{np.mean(np.abs(gain) < alike):12.1%}", flush=True)
    return found


def least_margin(rows: dict[str, dict[float, FloatArray]]) -> float:
    """Least whole margin at which no row of any lag is named a load in more than 1 % of its records."""
    return float(next(m for m in range(1000) if all(np.mean(g >= m) <= MOST_FALSE
                                                    for row in rows.values() for g in row.values())))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--samples", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=30_000)
    args = parser.parse_args()
    print(f"{args.records} records of {args.samples} samples; share named a load at a margin in BIC (in use: "
          f"{Policy().alike:g})\n")
    clean = table(tuple(name for names in FAMILIES.values() for name in names), args)
    print(f"\n{'left out':36}{'margin of the others':>22}{'false in it, worst row':>24}")
    for family, names in FAMILIES.items():
        margin = least_margin({name: row for name, row in clean.items() if name not in names})
        false = max(float(np.mean(g >= margin)) for name in names for g in clean[name].values())
        print(f"{family:36}{margin:22g}{false:24.1%}")
    print(f"{'none':36}{least_margin(clean):22g}\n")
    table(tuple(LOADS), args)


if __name__ == "__main__":
    main()
