"""Searches for the valve of a known model: with no process assumed, with the process, and both.

Run: python benchmarks/valve_starts.py [--loops 72] [--seed 98000]

Every loop of benchmarks/plants with one effect is searched with its true effects; true disturbances are taken out of y.
Loops whose true model leaves more than NEAR times the noise are left out. A search finds the valve where one of its
points, after a descent, comes within CLOSE times the error of the true model. CPU seconds are those of the search.
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

from stictionid.fit.moves import descended, search_model, with_start
from stictionid.fit.starts.basins import with_process
from stictionid.fit.starts.beside_effect import undisturbed, valve_columns
from stictionid.fit.starts.continuation import grown_valves
from stictionid.fit.starts.with_lags import grown_models

NEAR, CLOSE, TURNS = 1.5, 1.3, 6
SEARCHES = {"no process assumed": lambda *a: with_process(a[0], grown_valves(*a)), "with the process": grown_models}


def main() -> None:
    """Search every loop with both, and print how many valves each finds, by excitation."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=72)
    parser.add_argument("--seed", type=int, default=98000)
    args = parser.parse_args()
    rows: list[tuple[str, dict[str, bool]]] = []
    seconds = dict.fromkeys(SEARCHES, 0.0)
    for number in range(args.loops):
        try:
            plant = plant_of("one", number, args.seed)
        except NoLoop:
            continue
        before, values, noise = true_model(plant)
        if before.evaluate(values).rmse > NEAR * noise:
            continue
        model = search_model(undisturbed(before, before, values))
        known = before.named(values)
        limit = CLOSE**2 * float(model.costs_of(model.vector(known)[:, None])[0])
        found = {}
        for name, search in SEARCHES.items():
            begun = time.process_time()
            points = search(model, valve_columns(model), np.random.default_rng(number))
            seconds[name] += time.process_time() - begun
            found[name] = bool(descended(model, with_start(model, points), turns=TURNS).costs[0] <= limit)
        rows.append((plant.truth["levels"]["excitation"], found))
    print(f"{'':28}{'loops':>6}" + "".join(f"{name:>20}" for name in SEARCHES) + f"{'either':>8}")
    for level in (*sorted({level for level, _ in rows}), "all"):
        of = [found for kind, found in rows if level in (kind, "all")]
        print(f"{level:28}{len(of):6}" + "".join(f"{sum(f[n] for f in of):20}" for n in SEARCHES)
              + f"{sum(any(f.values()) for f in of):8}")
    print(f"{'CPU s a loop':34}" + "".join(f"{seconds[n] / max(len(rows), 1):20.2f}" for n in SEARCHES))


if __name__ == "__main__":
    main()
