"""Time and memory: kernels against their plain twins, whole commands against the imports that they make.

Run: python benchmarks/speed.py
Ratios are taken side by side in one run, best of several, because machines are noisy. Times of whole processes are CPU
seconds, which a busy machine disturbs less; a last table shows where those of `identify` go. Targets: one ARX cost
evaluation at least 120 times faster than its plain twin, the free run within 2 times of it; `identify` on 1000 rows
under 2.5 times the imports and under 250 MB; `--help` under 0.25 s; `import stictionid` under 40 ms; the first command
after install under 10 s; no searched law above 3 ns a sample and candidate.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))
# The libraries that every `identify` imports. It imports neither pandas nor, with kernels on disk, modules of scipy.
IMPORTS = "import numpy, numba, pyarrow"


def best(function, repeats: int = 30) -> float:
    """Shortest of several times, in seconds."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def kernels() -> list[str]:
    """Per candidate and per 1000 samples: laws, response, ARX and free-run cost, against the plain twin."""
    import naive

    from stictionid.fit.points.arx_cost import Arx
    from stictionid.laws import catalogue
    from stictionid.model.closed_loop import preset, simulate
    from stictionid.model.model import Model
    from stictionid.model.spec import Spec
    from stictionid.record.oscillation import find_range

    loop = simulate(preset("foptd")).loop
    found = find_range(loop)
    model = Model(loop, Spec(), s_max=found.s_max, period_s=found.period_median_s)
    lanes, rng = 128, np.random.default_rng(0)
    values = model.values(rng.random((lanes, model.space.size)))
    arx = Arx(model, 2, (5,))
    twin = best(lambda: naive.arx_cost(loop.output, loop.process_value, 4.0, 2.0, 2, 5, arx.first), 10)
    ours = best(lambda: arx.costs(values)) / lanes
    free = best(lambda: model.costs_of(values)) / lanes
    print(f"\nper candidate, {loop.samples} samples, {lanes} candidates together")
    print(f"plain twin of the ARX cost (Python valve, numpy.linalg.lstsq)  {1e6 * twin:8.1f} us")
    print(f"ARX cost                                                       {1e6 * ours:8.2f} us, "
          f"{twin / ours:.0f} times")
    print(f"free-run cost of the base model                                {1e6 * free:8.2f} us, {free / ours:.2f} ARX")
    slow = []
    for law in catalogue().values():
        if law.searchable:
            table = law.searched_friction(values[0], values[1])
            state = law.start(float(loop.output[0]), table, np.zeros(lanes))
            position, profile = np.empty((loop.samples, lanes)), np.zeros(loop.samples)
            run = partial(law.run, loop.output, table, profile, state, position)
            t = best(run) / lanes / loop.samples
            print(f"law {law.name:12s}                                               {1e9 * t:8.2f} ns a sample")
            slow += [f"law {law.name} {1e9 * t:.1f} ns"] if 1e9 * t > 3 else []
    slow += [f"ARX cost only {twin / ours:.0f} times faster"] if twin / ours < 120 else []
    return slow + ([f"free run {free / ours:.2f} ARX"] if free / ours > 2 else [])


def installed() -> dict[str, str]:
    """The environment in which modules have their bytecode on disk, as after an installation by pip."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


# Stages of `identify` on 1000 rows, in the order of a command; each line of code is timed alone.
STAGES = (
    ("numpy, numba, pyarrow", "import numpy, numba, pyarrow"),
    ("typer, rich, options of the command", "import rich.table, stictionid.cli, stictionid.cli.app as app, typer.main; "
     "typer.main.get_command(app.app).commands['identify'].make_context('identify', [FILE])"),
    ("own modules, other than those", "import stictionid.historian.reading, stictionid.verbs.identify"),
    ("reading the file", "from stictionid.historian import read; loop = read(FILE).loop"),
    ("identify: the search, and kernels from disk", "from stictionid.verbs.identify import identify; identify(loop)"),
    ("of it the search alone (a second identify)", "identify(loop)"),
)


def stages() -> str:
    """CPU seconds of each stage of one command, the best of 5 processes: shows where the time of a short command goes.
    """
    file = str(ROOT / "sample_data" / "foptd_scanned.parquet")
    head = ["import gc, time", "gc.set_threshold(50_000)", f"FILE = {file!r}", "times = []"]
    timed = [f"begun = time.process_time()\n{line}\ntimes.append(time.process_time() - begun)" for _, line in STAGES]
    script = "\n".join([*head, *timed, "print(*times)"])
    runs = [list(map(float, subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True,
                                           env=installed(), cwd=ROOT).stdout.split())) for _ in range(5)]
    best_of = np.min(np.array(runs), axis=0)
    lines = ["where the time of identify on 1000 rows goes, CPU seconds, best of 5",
             *(f"{name:50s} {seconds:6.3f} s  {seconds / best_of[0]:5.2f} imports"
               for (name, _), seconds in zip(STAGES, best_of, strict=True))]
    return "\n".join(lines)


def command(*arguments: str, cwd: str | None = None) -> tuple[float, float, float]:
    """CPU seconds, MB and elapsed seconds of one process with those that it started."""
    script = ("import resource, subprocess, sys, time\n"
              "begun = time.perf_counter()\n"
              "subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)\n"
              "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
              "print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, time.perf_counter() - begun)")
    out = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True,
                         cwd=cwd, env=installed())
    seconds, memory, elapsed = map(float, out.stdout.split())
    return seconds, memory, elapsed


def processes() -> list[str]:
    """Whole commands, alternating with the imports they are measured against."""
    me = [sys.executable, "-m", "stictionid"]
    nothing, package = (min(command(sys.executable, "-c", code)[0] for _ in range(7))
                        for code in ("pass", "import stictionid"))
    print(f"\nimport stictionid: {1000 * (package - nothing):.0f} ms of CPU time")
    jobs = {
        "imports": [sys.executable, "-c", IMPORTS],
        "--help": [*me, "--help"],
        "identify, held output": [*me, "identify", str(ROOT / "sample_data" / "foptd_scanned.parquet")],
        "identify, moving output": [*me, "identify", str(ROOT / "sample_data" / "foptd.csv")],
    }
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    memory = dict.fromkeys(jobs, 0.0)
    for _ in range(7):
        for name, arguments in jobs.items():
            t, mb, _ = command(*arguments)
            seconds[name].append(t)
            memory[name] = max(memory[name], mb)
    base, missed = min(seconds["imports"]), []
    print(f"\nwhole processes, CPU seconds, best of 7, 1000 rows; imports: {IMPORTS}")
    for name, times in seconds.items():
        ratio = min(times) / base
        print(f"{name:24s} {min(times):6.2f} s (median {np.median(times):5.2f})  {ratio:5.2f} imports  "
              f"{memory[name]:5.0f} MB")
        if name.startswith("identify") and (ratio > 2.5 or memory[name] > 250):
            missed.append(f"{name}: {ratio:.2f} imports, {memory[name]:.0f} MB")
    if package - nothing > 0.04:
        missed.append(f"import stictionid {1000 * (package - nothing):.0f} ms")
    if min(seconds["--help"]) > 0.25:
        missed.append(f"--help {min(seconds['--help']):.2f} s")
    return missed


def cold() -> list[str]:
    """The first command after install: an empty kernel cache."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "stictionid", Path(folder) / "stictionid", ignore=shutil.ignore_patterns("__pycache__"))
        t, _, elapsed = command(sys.executable, "-m", "stictionid", "identify", str(ROOT / "sample_data" / "foptd.csv"),
                       cwd=folder)
    print(f"\nfirst command, nothing compiled yet: {elapsed:.1f} s on {os.cpu_count()} cores, {t:.1f} CPU s; "
          f"load before it {load:.1f}")
    return [f"first command {elapsed:.1f} s"] if elapsed > 10 else []


if __name__ == "__main__":
    missed = kernels() + processes() + cold()
    print("\n" + stages())
    print("\ntargets missed: " + (", ".join(missed) or "none"))
    sys.exit(bool(missed))
