"""Fuzzing of every door for a number of executions or minutes; every failing input is kept.

Run: python tests/fuzz/run.py --executions 100000 --minutes 10 --seed 1 [--doors "study JSON"] [--record [FILE]]

One worker process runs at a time. When it dies (a crash in native code) or hangs, its present input is kept and a new
worker goes on. Exit 1 when anything failed. `--record` adds the run to docs/hard_results.json.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "faults")]

import hard_results  # noqa: E402
from fuzz_doors import DOORS, put_through, slug  # noqa: E402

CORPUS = HERE / "corpus"
HANG_S = 5.0
"""CPU time one input may take; the load of the machine doesn't count."""
COMPILING_S = 60.0
"""CPU time where the first try ended while a kernel was compiled, which happens once for each kernel."""
STANDSTILL_S = 120.0
"""Time after which a worker that says nothing waits for something that never comes."""
MAX_GROWTH_MB = 200.0
"""Peak memory one small input may add."""


class Hang(BaseException):
    """Raised by the alarm; not an Exception, so that nothing swallows it."""


def _alarm(*_: object) -> None:
    raise Hang("takes too long")


def _timed(door: Any, data: bytes) -> tuple[str, str]:
    """The outcome of one input and the traceback of its failure; a first try spent on compiling is made again."""
    text = ""
    for limit in (HANG_S, COMPILING_S):
        signal.setitimer(signal.ITIMER_PROF, limit)
        try:
            return put_through(door, data), ""
        except Hang:
            text = traceback.format_exc()
            if "numba" not in text:
                break
        except Exception:
            text = traceback.format_exc()
            break
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
    return "failed", text


def worker(names: list[str], seed: int, executions: int, until: float, current: str, results: Any) -> None:
    """Deals executions out to the doors; sends (door, outcome) counts and failures through `results`."""
    import pyarrow

    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    pyarrow.set_cpu_count(1)
    warnings.simplefilter("error")
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
    signal.signal(signal.SIGPROF, _alarm)
    rng = random.Random(seed)
    shares = [DOORS[n].share for n in names]
    counts: dict[str, list[int]] = {n: [0, 0, 0] for n in names}
    peak = _peak_mb()
    with open(current, "r+b", buffering=0) as note:
        for done in range(executions):
            name = rng.choices(names, shares)[0]
            data = DOORS[name].make(rng)
            note.seek(0)
            note.write(len(data).to_bytes(8, "little") + name.encode().ljust(64) + data)
            outcome, text = _timed(DOORS[name], data)
            if done > 200 and _peak_mb() > peak + MAX_GROWTH_MB:
                outcome, text = "failed", f"memory grew by {_peak_mb() - peak:.0f} MB"
            peak = _peak_mb()
            counts[name][("read", "refused", "failed").index(outcome)] += 1
            if text:
                results.put(("failure", name, data, text))
            if done % 200 == 0:
                results.put(("counts", counts))
                if time.time() > until:
                    break
    results.put(("counts", counts))
    results.put(("end",))


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run(names: list[str], seed: int, executions: int, minutes: float) -> tuple[dict[str, list[int]], dict[str, str]]:
    """Counts (read, refused, failed) per door, and the failures by the file they were kept in."""
    total: dict[str, list[int]] = {n: [0, 0, 0] for n in names}
    failures: dict[str, str] = {}
    seen: set[str] = set()
    until = time.time() + 60 * minutes
    context = multiprocessing.get_context("fork")

    def keep(name: str, data: bytes, text: str) -> None:
        place = "|".join(line.strip() for line in text.splitlines() if line.strip().startswith("File"))[-200:]
        if place and (name + place) in seen:
            return
        seen.add(name + place)
        CORPUS.mkdir(exist_ok=True)
        path = CORPUS / f"{slug(name)}-{hashlib.sha256(data).hexdigest()[:10]}.bin"
        path.write_bytes(data)
        failures[path.name] = text
        print(f"FAILED {path.name}\n{text[-1200:]}", flush=True)

    while time.time() < until and sum(map(sum, total.values())) < executions:
        with tempfile.NamedTemporaryFile(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as current:
            results: Any = context.Queue()
            left = executions - sum(map(sum, total.values()))
            process = context.Process(target=worker, args=(names, seed, left, until, current.name, results))
            process.start()
            part: dict[str, list[int]] = {}
            ended, last = False, time.time()
            while not ended:
                try:
                    message = results.get(timeout=1.0)
                    last = time.time()
                except Exception:
                    if process.is_alive() and time.time() - last < STANDSTILL_S:
                        continue
                    message = ("died",)
                if message[0] == "counts":
                    part = message[1]
                elif message[0] == "failure":
                    keep(*message[1:])
                else:
                    ended = True
                    if message[0] == "died":
                        process.kill()
                        process.join()
                        raw = Path(current.name).read_bytes()
                        size, name = int.from_bytes(raw[:8], "little"), raw[8:72].decode().strip()
                        keep(name, raw[72 : 72 + size], f"worker died or stood still, exit {process.exitcode}")
                        part.setdefault(name, [0, 0, 0])[2] += 1
            process.join(5)
            for name, counts in part.items():
                total[name] = [a + b for a, b in zip(total[name], counts, strict=True)]
            seed += 1_000_003
    return total, failures


def _load() -> None:
    """Import the whole package before the first worker is forked."""
    import importlib
    import pkgutil

    import stictionid

    for module in pkgutil.walk_packages(stictionid.__path__, "stictionid."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)


def main() -> None:
    """Run, print the table, add to the tally."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--executions", type=int, default=20_000)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--doors", nargs="*", choices=list(DOORS), default=list(DOORS))
    hard_results.add_record_option(parser)
    options = parser.parse_args()
    # The code as it is now is the code that runs, whatever happens to the files meanwhile.
    fingerprint, started = hard_results.code(), time.time()
    _load()
    total, failures = run(options.doors, options.seed, options.executions, options.minutes)
    if options.record:
        hard_results.add("fuzz", fingerprint, {
            "seed": options.seed, "seconds": round(time.time() - started), "doors": total,
            "failing": sorted(failures)}, options.record)
    print(f"{'door':28s} {'executions':>10s} {'read':>10s} {'refused':>10s} {'failed':>8s}")
    for name, counts in [*total.items(), ("all", [sum(c) for c in zip(*total.values(), strict=True)])]:
        print(f"{name:28s} {sum(counts):10,d} {counts[0]:10,d} {counts[1]:10,d} {counts[2]:8,d}")
    print(f"{time.time() - started:.0f} s, seed {options.seed}; failing inputs of this run: {len(failures)}")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
