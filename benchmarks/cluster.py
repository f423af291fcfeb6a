"""A site of 100,000 loops on a Dask cluster: measured with local processes, extrapolated to 100 workers.

Run: python benchmarks/cluster.py [--loops 1000] [--level screen] [--identify 60] [--workers 2] (extra `cluster`)

Measured: tasks and overheads of `batch --scheduler` on a LocalCluster, undisturbed, with a worker killed halfway, and
with a delay before each reading. The model below is held against these runs before it is extrapolated. Targets: every
loop of every run is done, summaries are equal byte for byte, and the model is within 15 % of each run.

The model. N loops on W workers take

    max(N (task + delay + gap) / W, N parent, N scheduler) + D (restart + half a task) / W + N (plan + end)

`task` is the mean time of a worker on a loop, `gap` its wait for the next, `parent` and `scheduler` their CPU time a
loop: each is one process, so that they limit the rate however many workers there are. `plan` and `end` are the parent's
times a loop before the first and after the last loop, from runs of two sizes. D workers die; their cores miss the
restart, and the loops in their hands begin anew elsewhere. The model knows no network and no limit of the disks but
the delay.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import plant

ROOT = Path(__file__).resolve().parent.parent
# The site and the cluster that are extrapolated to.
_SITE, _WORKERS = 100_000, 100
# A worker that dies once in so long, and a slow disk's wait before each reading.
_LIFE_H, _SLOW_S = 24.0, 0.2
_WITHIN = 0.15
# Longest wait for a new worker. Unit: s.
_LONGEST_S = 60.0


@dataclass
class Run:
    """One batch on the cluster, times in seconds; `parent` and `scheduler` are CPU seconds a loop."""

    loops: int
    seconds: float
    plan: float
    work: float
    end: float
    task: float
    longest: float
    gap: float
    parent: float
    scheduler: float
    failed: int
    summary: bytes

    @classmethod
    def of(cls, data: Path, out: Path, level: str, cluster: Any, idle: float = 0.0,
           halfway: Callable[[], None] | None = None) -> Run:
        """Run the command; `idle` is the CPU share of a scheduler without work, `halfway` is called midway."""
        begun = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "stictionid", "batch", str(data), "-o", str(out), "--level", level, "--json",
             "--scheduler", cluster.scheduler_address], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)})
        assert process.stdout is not None and process.stderr is not None
        told: list[str] = []
        reader = threading.Thread(target=lambda: told.append(process.stdout.read()))  # type: ignore[union-attr]
        reader.start()
        stamps, other, used, total = [], [], [], 0
        for line in process.stderr:
            if not line.startswith('{"event"'):
                other.append(line)
                continue
            stamps.append(time.perf_counter())
            used.append((_cpu_s_of(process.pid), _own_cpu_s()))
            total = json.loads(line).get("total", total)
            if halfway is not None and len(stamps) * 2 >= total > 0:
                halfway()
                halfway = None
        reader.join()
        code = process.wait()
        seconds = time.perf_counter() - begun
        if code:
            sys.exit("".join(other))
        with open(out / "timing.csv", newline="", encoding="utf-8") as file:
            times = np.array([float(row["total_s"]) for row in csv.DictReader(file)])
        workers, loops = len(cluster.workers), times.size
        # The last loops leave workers idle; the gap is asked for while all had work.
        full = stamps[-1 - workers] - stamps[0]
        gap = full * workers / (len(stamps) - 1 - workers) - times.mean()
        span = stamps[-1] - stamps[0]
        parent, own = (used[-1][i] - used[0][i] for i in (0, 1))
        return cls(loops, seconds, stamps[0] - begun - times.mean(), span + times.mean(),
                   begun + seconds - stamps[-1], float(times.mean()), float(times.max()), max(float(gap), 0.0),
                   parent / (loops - 1), max(own - idle * span, 0.0) / (loops - 1),
                   json.loads(told[0])["failed"], (out / "summary.csv").read_bytes())


def predicted(m: Run, loops: int, workers: int, *, delay: float = 0.0, deaths: float = 0.0,
              restart: float = 0.0) -> float:
    """Seconds of the work by the model in this file's head, with what one run measured; without plan and end."""
    each = m.task + delay + m.gap
    return max(loops * each / workers, loops * m.parent, loops * m.scheduler) \
        + deaths * (restart + each / 2) / workers


def _own_cpu_s() -> float:
    """CPU seconds of this process, which runs the scheduler."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _idle_share(seconds: float = 5.0) -> float:
    """Share of a core that this process takes while the cluster has no work."""
    before = _own_cpu_s()
    time.sleep(seconds)
    return (_own_cpu_s() - before) / seconds


def _cpu_s_of(pid: int) -> float:
    """CPU seconds of a process that runs."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _kill_one(cluster: Any, workers: int, restarts: list[float]) -> None:
    """Kill one worker process as a machine that fails does; Dask's nanny starts another, whose time is noted."""
    begun = time.perf_counter()
    os.kill(next(iter(cluster.workers.values())).process.process.pid, signal.SIGKILL)

    def watch() -> None:
        while len(cluster.scheduler.workers) == workers and time.perf_counter() - begun < _LONGEST_S:
            time.sleep(0.01)
        while len(cluster.scheduler.workers) < workers and time.perf_counter() - begun < _LONGEST_S:
            time.sleep(0.01)
        restarts.append(time.perf_counter() - begun)

    threading.Thread(target=watch).start()


def _slow_disk(seconds: float) -> None:
    """Make every reading of this worker wait; runs in the worker."""
    import stictionid.batch.work.worker as worker

    plain = getattr(worker.read_task, "plain", worker.read_task)

    def slow(*args: Any) -> Any:
        time.sleep(seconds)
        return plain(*args)

    slow.plain = plain  # type: ignore[attr-defined]
    worker.read_task = slow


def _show(name: str, m: Run, workers: int, model: float) -> list[str]:
    off = m.work / model - 1
    print(f"{name:34s} {m.loops / m.work:7.2f} {1e3 * m.task:8.1f} {1e3 * m.longest:8.0f} {1e3 * m.gap:7.1f} "
          f"{1e3 * m.parent:7.2f} {1e3 * m.scheduler:7.2f} {m.work:8.1f} {model:8.1f} {100 * off:+6.1f} %")
    return ([f"{name}: model {100 * off:+.0f} %"] if abs(off) > _WITHIN else []) \
        + ([f"{name}: {m.failed} failed"] if m.failed else [])


def main() -> int:
    """All runs, the table, and the site; 1 where a target is missed."""
    import logging

    import distributed

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--loops", type=int, default=1000)
    parser.add_argument("--rows", type=int, default=1000, help="samples of a loop")
    parser.add_argument("--level", default="screen", choices=("screen", "identify", "diagnose"))
    parser.add_argument("--identify", type=int, default=60, help="loops of a second run with --level identify")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; Dask {distributed.__version__}, "
          f"{options.workers} local workers of one thread")
    missed: list[str] = []
    with tempfile.TemporaryDirectory() as name, distributed.LocalCluster(
            n_workers=options.workers, threads_per_worker=1, processes=True, dashboard_address=None) as cluster, \
            distributed.Client(cluster) as client:
        folder, workers = Path(name), options.workers
        data = plant.dataset(folder / "data", options.loops, options.rows)
        few = plant.dataset(folder / "few", max(options.identify, 8), options.rows)
        for level in ("identify", options.level):
            Run.of(few, folder / f"warm-{level}", level, cluster)  # imports and kernels
        idle = _idle_share()
        print(f"scheduler and nannies without work take {100 * idle:.1f} % of a core, left out below")
        small = Run.of(few, folder / "small", options.level, cluster, idle)
        plain = Run.of(data, folder / "plain", options.level, cluster, idle)
        first = f"{options.level}, {options.loops} loops"
        restarts: list[float] = []
        harmed = Run.of(data, folder / "killed", options.level, cluster, idle,
                        lambda: _kill_one(cluster, workers, restarts))
        client.wait_for_workers(workers)
        # The new process imports the program with its first loop, which is therefore the longest.
        restart = restarts[0] + harmed.longest
        client.run(_slow_disk, _SLOW_S / 10)
        slow = Run.of(data, folder / "slow", options.level, cluster, idle)
        client.run(_slow_disk, 0.0)
        again = Run.of(data, folder / "again", options.level, cluster, idle)
        # The machine may be busier in one run than in another: the model takes the mean of two.
        base = replace(plain, task=(plain.task + again.task) / 2, gap=(plain.gap + again.gap) / 2)
        print(f"\n{'run':34s} {'loops/s':>7s} {'task ms':>8s} {'longest':>8s} {'gap':>7s} {'parent':>7s} "
              f"{'sched.':>7s} {'work s':>8s} {'model s':>8s}")
        for label, run, more in ((first, plain, {}), ("the same, a worker killed halfway", harmed,
                                                      {"deaths": 1.0, "restart": restart}),
                                 (f"the same, {_SLOW_S / 10:g} s before reading", slow, {"delay": _SLOW_S / 10}),
                                 ("the same once more", again, {})):
            missed += _show(label, run, workers, predicted(base, plain.loops, workers, **more))
        same = plain.summary == harmed.summary == slow.summary == again.summary
        print(f"summaries of the four equal byte for byte: {'yes' if same else 'NO'}; loops that failed: "
              f"{plain.failed + harmed.failed + slow.failed + again.failed}")
        missed += [] if same else ["summaries differ"]
        found = {options.level: base}
        if options.identify and options.level != "identify":
            found["identify"] = Run.of(few, folder / "identify", "identify", cluster, idle)
            missed += _show(f"identify, {options.identify} loops", found["identify"], workers,
                            predicted(found["identify"], found["identify"].loops, workers))
    _site(found, small, plain, restart)
    print("\ntargets missed: " + (", ".join(missed) or "none"))
    return bool(missed)


def _site(found: dict[str, Run], small: Run, large: Run, restart: float) -> None:
    """The site by the model."""
    plan, end = (max((getattr(large, name) - getattr(small, name)) / (large.loops - small.loops), 0.0)
                 for name in ("plan", "end"))
    print(f"\n{_SITE:,} loops on {_WORKERS} workers with cores like these, by the model: plan {1e3 * plan:.2f} ms and "
          f"end {1e3 * end:.2f} ms a loop, a new worker after {restart:.1f} s, its first loop included")
    for level, m in found.items():
        for label, delay in (("", 0.0), (f", each reading {_SLOW_S:g} s late", _SLOW_S)):
            work = predicted(m, _SITE, _WORKERS, delay=delay)
            deaths = _WORKERS * work / 3600 / _LIFE_H
            work = predicted(m, _SITE, _WORKERS, delay=delay, deaths=deaths, restart=restart)
            limit = max(("the workers", _SITE * (m.task + delay + m.gap) / _WORKERS),
                        ("the parent", _SITE * m.parent), ("the scheduler", _SITE * m.scheduler), key=lambda x: x[1])
            print(f"{level}{label}: {work / 60:.1f} min of work, {(work + _SITE * (plan + end)) / 60:.1f} min in all; "
                  f"limited by {limit[0]}; {deaths:.2f} workers die (one in {_LIFE_H:g} h each)")


if __name__ == "__main__":
    sys.exit(main())
