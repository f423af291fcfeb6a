"""Counts of work that do not depend on the machine's load: modules loaded, kernels compiled, cost evaluations.

Run: python benchmarks/counts.py [--write REASON]
Modules and kernels are those of one `identify` in a process of its own. Evaluations are the sum of `identify` and
`diagnose` over twelve short loops. The counts are compared with the last line of `benchmarks/counts.txt`: modules and
kernels exactly, evaluations within 10 %, because they differ by processor. Exit 1 where they differ. With --write a
line is added, with the commit and the reason, so that no slow drift goes unseen.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "benchmarks" / "counts.txt"
sys.path.insert(0, str(ROOT))
# Share by which evaluations may differ from the table.
WITHIN = 0.1
HIDDEN = (None, "extra-lag", "re-sticking", "asymmetric-stiction", "travel-limit", "slew-limit")
SAMPLES, NOISE = 700.0, 0.05
# What one process loads and compiles for the command that a user types first.
COMMAND = """
import sys
from stictionid.cli import main
sys.argv = ["stictionid", "identify", sys.argv[1], "--json", "--quiet"]
try:
    main()
except SystemExit:
    pass
from numba.core.dispatcher import Dispatcher
loaded = [m for m in list(sys.modules.values()) if m and m.__name__.startswith("stictionid")]
used = {id(k): k for m in loaded for k in vars(m).values() if isinstance(k, Dispatcher) and k.signatures}
print(len(loaded), len(used), file=sys.stderr)
"""


def loaded_and_compiled() -> tuple[int, int]:
    """Modules of the package that `identify` loads, and kernels that it calls."""
    import numpy as np

    from stictionid.model.closed_loop import preset, simulate

    loop = simulate(preset("foptd")).loop
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "loop.csv"
        time = np.arange(loop.samples) * loop.step_s
        np.savetxt(path, np.column_stack([time, loop.setpoint, loop.process_value, loop.output]), delimiter=",",
                   header="t,SP,PV,OP", comments="")
        done = subprocess.run([sys.executable, "-c", COMMAND, str(path)], capture_output=True, text=True, cwd=ROOT,
                              check=True, env={**os.environ, "PYTHONPATH": str(ROOT)})
    modules, kernels = done.stderr.split()[-2:]
    return int(modules), int(kernels)


def evaluations_of(loop: tuple[int, str | None]) -> int:
    """Cost evaluations of `identify` and `diagnose --apply` of one loop, by seed and hidden effect."""
    from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
    from stictionid.model.visible import visible_values
    from stictionid.verbs.diagnose import diagnose
    from stictionid.verbs.identify import identify

    seed, name = loop
    setting = Setting(Plant(1.5, 10.0, 3.0), Controller(0.4, 12.0), S=4.0, J=2.0, duration_s=SAMPLES, noise_sd=NOISE,
                      setpoint_moves=((0.0, 3.0), (SAMPLES / 2.0, -2.0)))
    if name:
        setting = replace(setting, effects=((name, visible_values(name, setting)),))
    known = simulate(setting, seed=seed).loop
    study = identify(known)
    # (a loop that abstains has no model to go on from)
    return (study if study.estimate is None else diagnose(known, study, apply=True)).evaluations or 0


def evaluations() -> int:
    """Cost evaluations of `identify` and `diagnose --apply`, summed over twelve loops."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        return sum(pool.map(evaluations_of, [(seed, name) for seed in range(2) for name in HIDDEN]))


def main() -> int:
    """Print the counts beside those of the table; 1 where they differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", metavar="REASON", default="")
    args = parser.parse_args()
    now = (*loaded_and_compiled(), evaluations())
    lines = TABLE.read_text().splitlines() if TABLE.exists() else []
    if args.write:
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=ROOT,
                                check=True).stdout.strip()
        lines = lines or ["modules kernels evaluations commit reason"]
        TABLE.write_text("\n".join([*lines, " ".join([*map(str, now), commit, args.write])]) + "\n")
        print(TABLE.read_text(), end="")
        return 0
    modules, kernels, spent = map(int, lines[-1].split()[:3])
    print(f"{'':22}{'now':>12}{'table':>12}")
    for words, a, b in zip(("modules loaded", "kernels called", "cost evaluations"), now, (modules, kernels, spent),
                           strict=True):
        print(f"{words:22}{a:12,}{b:12,}")
    if now[:2] == (modules, kernels) and abs(now[2] - spent) <= WITHIN * spent:
        return 0
    print("The counts differ from the table. Say why: python benchmarks/counts.py --write REASON")
    return 1


if __name__ == "__main__":
    sys.exit(main())
