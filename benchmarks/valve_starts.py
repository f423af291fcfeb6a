"""Searches for the valve of a known model with the process left open: how many find it, with which lags.

Run: python benchmarks/valve_starts.py [--loops 72] [--seed 98000] [--lags 0.2,0.1,0.04,0.012]

Every loop of benchmarks/plants with one effect is searched with its true effects; true disturbances are taken out of y.
Loops whose true model leaves more than NEAR times the noise are left out. The points of the search get a process each
and are fitted in full. A valve is found where that fit comes within CLOSE BIC of the true model. With `--lags` (shares
of a period, that of the high pass first) the same loops are searched with these as well. CPU seconds are those of
search and fit.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from plants.draw import NoLoop
from plants.identifiable import true_model
from plants.run import plant_of

from stictionid.fit.noise.completion import complete_quickly
from stictionid.fit.points.fitted import as_it_stands
from stictionid.fit.points.moves import descend_model, with_start
from stictionid.fit.starts import continuation
from stictionid.fit.starts.beside_effect import RESTING, on_valve, open_valves
from stictionid.fit.with_effect import Scouted, settle_look
from stictionid.model.model import Model
from stictionid.typing import FloatArray

NEAR, CLOSE, TURNS, S_WITHIN = 1.5, 15.0, 6, 0.02


def main() -> None:
    """Search every loop with each set of lags, and print how many valves are found, by excitation."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=72)
    parser.add_argument("--seed", type=int, default=98000)
    parser.add_argument("--lags", type=lambda text: tuple(map(float, text.split(","))), default=None)
    args = parser.parse_args()
    sets = [continuation.LAGS, *([args.lags] if args.lags else [])]
    found: dict[str, list[list[tuple[bool, bool]]]] = {}
    seconds = [0.0] * len(sets)
    for number in range(args.loops):
        try:
            plant = plant_of("one", number, args.seed)
        except NoLoop:
            continue
        model, values, noise = true_model(plant)
        if model.evaluate(values).rmse > NEAR * noise:
            continue
        answers = []
        for i, lags in enumerate(sets):
            continuation.LAGS = lags
            begun = time.process_time()
            answers.append(searched(model, values, number))
            seconds[i] += time.process_time() - begun
        found.setdefault(plant.truth["levels"]["excitation"], []).append(answers)
    everything = [a for of in found.values() for a in of]
    print(f"{'':12}{'loops':>6}" + "".join(f"{','.join(map(str, lags)):>22}{'S right':>9}" for lags in sets))
    for level, of in (*sorted(found.items()), ("all", everything)):
        print(f"{level:12}{len(of):6}" + "".join(f"{sum(a[i][0] for a in of):22}{sum(a[i][1] for a in of):9}"
                                               for i in range(len(sets))))
    print(f"{'CPU s a loop':18}" + "".join(f"{s / max(len(everything), 1):22.2f}{'':9}" for s in seconds))


def searched(model: Model, values: FloatArray, seed: int) -> tuple[bool, bool]:
    """True where a search for the valve of a model whose `values` (d,) are true finds it, and where S is right."""
    rng, fit = np.random.default_rng(seed), as_it_stands(model, values)
    valve = [n for n, effect in zip(model.names, model.effects, strict=True) if on_valve(effect)]
    name = next((n for n in valve if n != RESTING), valve[0] if valve else "")
    points = open_valves(model, name, fit, rng)
    near = descend_model(model, with_start(model, points), turns=TURNS)
    fitted, at, _ = settle_look(Scouted(model, near.points, np.inf, np.inf, name), rng)
    gain = complete_quickly(fitted, at).gain_over(complete_quickly(model, values))
    return gain > -CLOSE, abs(at[0] / values[0] - 1.0) < S_WITHIN


if __name__ == "__main__":
    main()
