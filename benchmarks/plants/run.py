"""Run `stictionid` on plants nobody tuned to, one JSON line a loop, then the table by family.

Each loop is drawn from the design (`--kind clean`, `one` or `two` hidden effects), checked for identifiability,
identified and diagnosed with `apply`. Rows already in the file are skipped; no loop starts after `--minutes`. Seeds
below 50000 are for building; 50000 and up are for reporting.

    python benchmarks/plants/run.py --kind one --loops 40 --seed 1000 --minutes 20 --out rows.jsonl
    python benchmarks/plants/run.py --kind clean --loops 600 --seed 1000 --minutes 60 --jobs 2 --out clean.jsonl
    python benchmarks/plants/run.py --kind two --loops 40 --seed 1000 --out two.jsonl --shadow ../other-checkout
    python benchmarks/plants/table.py rows.jsonl
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from plants.design import KINDS, design
from plants.draw import NoLoop, Plant, drawn
from plants.score import run
from plants.table import beside, print_table, rows_of

# Seeds of the loops of two base seeds don't meet, as long as a run has fewer loops than this.
_APART = 10_000


def plant_of(kind: str, number: int, seed: int) -> Plant:
    """Loop `number` of a kind and base seed; NoLoop where no draw is acceptable."""
    levels, effects = design(kind, number + 1, seed)[number]
    return _plant(kind, number, seed, levels, effects)


def _plant(kind: str, number: int, seed: int, levels: dict[str, str], effects: tuple[str, ...]) -> Plant:
    return drawn(levels, effects, (seed * len(KINDS) + KINDS.index(kind)) * _APART + number)


def one(kind: str, number: int, seed: int, levels: dict[str, str], effects: tuple[str, ...],
        check: bool) -> dict[str, Any]:
    """Row of one loop, from drawing to judgement."""
    row: dict[str, Any] = {"kind": kind, "loop": number, "seed": seed, "levels": levels, "hidden": list(effects)}
    try:
        plant = _plant(kind, number, seed, levels, effects)
    except NoLoop as error:
        return {**row, "out": "no loop", "error": str(error)}
    if check:
        from plants.identifiable import MARGIN, error_with_scans, error_without_hidden_noise, losses

        begin = time.process_time()
        try:
            row["losses"], row["true_error"], row["true_S_error"] = losses(plant)
            row["scans_error"], row["rebuilt_error"] = error_with_scans(plant), error_without_hidden_noise(plant)
        except Exception as error:
            row["losses_error"] = f"{type(error).__name__}: {error}"
        row["check_s"] = time.process_time() - begin
        if any(loss < MARGIN for loss in row.get("losses", {}).values()):
            return {**row, "truth": plant.truth, "out": "unidentifiable"}
    return row | run(plant)


def _tasks(a: argparse.Namespace, done: set[tuple[str, int, int]]) -> Iterator[tuple[Any, ...]]:
    wanted = {int(k) for k in a.only.split(",")} if a.only else None
    for number, (levels, effects) in enumerate(design(a.kind, a.loops, a.seed)):
        if (a.kind, number, a.seed) not in done and (wanted is None or number in wanted):
            yield a.kind, number, a.seed, levels, effects, a.check


def _all(a: argparse.Namespace, out: Path) -> None:
    """Append a row for each loop that is missing in the file, with at most `jobs` at a time, until the time is over."""
    stop = time.monotonic() + 60.0 * a.minutes
    done = {(r["kind"], r["loop"], r["seed"]) for r in rows_of(out)} if out.exists() else set()
    tasks = _tasks(a, done)
    with out.open("a") as file, ProcessPoolExecutor(a.jobs, get_context("spawn")) as pool:
        running: set[Future[dict[str, Any]]] = set()
        while True:
            while len(running) < a.jobs and time.monotonic() < stop and (task := next(tasks, None)):
                running.add(pool.submit(one, *task))
            if not running:
                break
            ready, running = wait(running, return_when=FIRST_COMPLETED)
            for future in ready:
                row = future.result()
                print(json.dumps(row), file=file, flush=True)
                if not a.quiet:
                    print(_line(row), file=sys.stderr, flush=True)


def _line(row: dict[str, Any]) -> str:
    head = f"{row['loop']:4d} {'|'.join(row['levels'].values())} {'+'.join(row['hidden']) or 'clean'}"
    if "out" in row:
        return f"{head} -> {row['out']} {row.get('losses', '')}"
    if "S_error" not in row:
        return f"{head} -> {row.get('error') or row.get('reason')} {row['cpu_s']:.0f} s"
    return (f"{head} -> {row['right']} {'+'.join(row['answer']) or 'nothing'} error {row['error_over_noise']:.2f} "
            f"S {100 * row['S_error']:+.1f} % J {100 * row['J_error']:+.1f} % {row['cpu_s']:.1f} s")


def _shadow(a: argparse.Namespace, out: Path) -> Path:
    """The same loops in a process of its own that imports the other checkout; its rows are beside those of this one."""
    other = out.with_suffix(".shadow.jsonl")
    command = [sys.executable, str(Path(__file__).resolve()), "--kind", a.kind, "--loops", str(a.loops), "--seed",
               str(a.seed), "--minutes", str(a.minutes), "--jobs", str(a.jobs), "--out", str(other), "--only", a.only,
               "--no-check", "--no-table", *(["--quiet"] if a.quiet else [])]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": str(Path(a.shadow).resolve())})
    return other


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", default="one", choices=KINDS)
    parser.add_argument("--loops", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1000, help="base seed of design and loops")
    parser.add_argument("--minutes", type=float, default=20.0, help="no new loop after so long")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", default="plants.jsonl", help="rows, one JSON line a loop; those in it are skipped")
    parser.add_argument("--only", default="", help="only these loop numbers, comma-separated")
    parser.add_argument("--shadow", default="", help="run the same loops with another checkout, too; print old and new")
    parser.add_argument("--check", action=argparse.BooleanOptionalAction, default=True,
                        help="leave out loops whose hidden effect the exported samples do not show")
    parser.add_argument("--table", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--quiet", action="store_true")
    a = parser.parse_args()
    out = Path(a.out)
    _all(a, out)
    if a.shadow:
        beside(rows_of(_shadow(a, out)), rows_of(out))
    elif a.table:
        print_table(rows_of(out))


if __name__ == "__main__":
    main()
