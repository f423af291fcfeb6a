"""Times of `identify` and `diagnose` by stage: cost evaluations, kernels, Python.

Run: python benchmarks/where.py [--page docs/time.md]

Times are CPU seconds in one process, the second of two runs, so that everything is loaded. An evaluation is one
candidate on all samples of the loop. Its physical limit is what the cost of the base model takes with 128 candidates
at a time, measured here. A kernel is compiled code; the rest of a stage is Python, numpy and small arrays. With --page
the tables of the page are written anew.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
# Functions whose time is a stage; within another one the inner stage counts.
STAGES = (
    ("base model: swarm and descents", "fit.fit", "search"),
    ("base model: completion, held-out blocks", "fit.fit", "finish_fit"),
    ("starts beside an effect", "selection.looks", "pool_of"),
    ("another valve: its starts", "fit.starts.beside_effect", "resting_valves"),
    ("another valve: growing records", "fit.starts.basins", "grow_starts"),
    ("another process", "selection.looks", "_look_at_process"),
    ("scouting effects", "fit.with_effect", "scout_effect"),
    ("settling an effect", "fit.with_effect", "settle_look"),
    ("noise models", "fit.noise.completion", "complete_quickly"),
    ("noise models", "fit.noise.completion", "complete_model"),
    ("held-out blocks", "fit.cross_validation", "held_out_of"),
    ("intervals", "fit.fit", "widen_intervals"),
    ("intervals", "fit.intervals.assemble", "region"),
    ("verdict", "verdict.judge", "judge"),
    ("verdict", "verdict.from_position", "from_position"),
    ("preconditions, swing", "record.oscillation", "find_range"),
    ("preconditions, swing", "record.preconditions", "check"),
)
REST = "all else"


@dataclass
class Spent:
    """CPU seconds of a stage, those within kernels, calls of kernels, and evaluations."""

    seconds: float = 0.0
    kernels: float = 0.0
    calls: int = 0
    evaluations: float = 0.0


class Watch:
    """Time by stage: a stack of stages, of which the innermost pays."""

    def __init__(self) -> None:
        self.spent: dict[str, Spent] = defaultdict(Spent)
        self.stack, self.since, self.inside = [REST], 0.0, 0

    def turn(self) -> None:
        now = time.process_time()
        self.spent[self.stack[-1]].seconds += now - self.since
        self.since = now

    def stage(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            self.turn()
            self.stack.append(name)
            try:
                return function(*args, **kwargs)
            finally:
                self.turn()
                self.stack.pop()
        return timed

    def kernel(self, compiled: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any) -> Any:
            begun = time.process_time()
            try:
                return compiled(*args)
            finally:
                own = self.spent[self.stack[-1]]
                own.kernels += time.process_time() - begun
                own.calls += 1
        return timed

    def start(self) -> None:
        self.spent.clear()
        self.stack, self.since = [REST], time.process_time()


WATCH = Watch()


def watched() -> None:
    """Put the watch into kernels and stages; kernels must be on disk, because watched ones can't be compiled."""
    from stictionid.numerics import jit

    plain = jit.kernel
    jit.kernel = lambda function: WATCH.kernel(plain(function))  # type: ignore[assignment]
    import importlib

    import stictionid.verbs.diagnose
    import stictionid.verbs.identify  # noqa: F401
    from stictionid.system import evaluations

    add = evaluations.add

    def counted(candidates: int, samples: int, parts: int = 1) -> None:
        add(candidates, samples, parts)
        WATCH.spent[WATCH.stack[-1]].evaluations += candidates * samples * (1 + parts) / 2

    evaluations.add = counted
    for name, module, function in STAGES:
        found = getattr(importlib.import_module(f"stictionid.{module}"), function)
        instead = WATCH.stage(name, found)
        for each in [m for n, m in sys.modules.items() if n.startswith("stictionid.")]:
            for key, value in list(vars(each).items()):
                if value is found:
                    setattr(each, key, instead)


def limits() -> tuple[float, float, int]:
    """Seconds of one free-run cost and of one ARX cost, many candidates at a time, and the samples of the loop."""
    import numpy as np
    from speed import best

    from stictionid.fit.points.arx_cost import Arx
    from stictionid.model.closed_loop import preset, simulate
    from stictionid.model.model import Model
    from stictionid.model.spec import Spec
    from stictionid.record.oscillation import find_range

    loop = simulate(preset("foptd")).loop
    found = find_range(loop)
    model = Model(loop, Spec(), s_max=found.s_max, period_s=found.period_median_s)
    lanes = 128
    values = model.values(np.random.default_rng(0).random((lanes, model.space.size)))
    arx = Arx(model, 2, (5,))
    return best(lambda: model.costs_of(values)) / lanes, best(lambda: arx.costs(values)) / lanes, loop.samples


def table(title: str, run: Callable[[], Any], samples: int, limit: float) -> str:
    """One command's stages; `limit` is the time of one evaluation on so many samples."""
    run()
    WATCH.start()
    begun = time.process_time()
    run()
    WATCH.turn()
    cpu = time.process_time() - begun
    total = sum(s.seconds for s in WATCH.spent.values())
    out = [f"{title}: {cpu:.2f} CPU s",
           f"{'stage':39s} {'s':>6s} {'share':>6s} {'cost evals':>10s} {'us each':>7s} {'limit':>6s} {'kernels':>7s}"]
    ranked = sorted(WATCH.spent.items(), key=lambda row: -row[1].seconds)
    for name, s in [*ranked, ("all", _sum(WATCH.spent.values()))]:
        count = s.evaluations / samples
        each = f"{1e6 * s.seconds / count:7.2f}" if count > 1 else f"{'-':>7s}"
        reached = f"{100 * limit * count / s.seconds:4.0f} %" if count > 1 else f"{'-':>6s}"
        out.append(f"{name:39s} {s.seconds:6.3f} {100 * s.seconds / total:4.0f} % {count:10,.0f} {each} "
                   f"{reached} {100 * s.kernels / max(s.seconds, 1e-9):5.0f} %")
    everything = _sum(WATCH.spent.values())
    each_us = 1e6 * everything.kernels / max(everything.calls, 1)
    out.append(f"{everything.calls:,} calls of kernels, {each_us:.1f} us each; "
               f"Python, numpy and small arrays {100 * (1 - everything.kernels / total):.0f} %")
    return "\n".join(out)


def _sum(rows: Any) -> Spent:
    rows = list(rows)
    return Spent(*(sum(getattr(r, name) for r in rows) for name in ("seconds", "kernels", "calls", "evaluations")))


def tables() -> dict[str, str]:
    """The tables by name: a plain loop, one with a hidden effect, and diagnose of it."""
    from loops_with_effects import small

    from stictionid.historian import read
    from stictionid.model.closed_loop import simulate
    from stictionid.verbs.diagnose import diagnose
    from stictionid.verbs.identify import identify

    free, arx, samples = limits()
    watched_loop = read(str(ROOT / "sample_data" / "foptd_scanned.parquet")).loop
    setting, _ = small("sinusoidal-disturbance")
    hidden = simulate(replace(setting, duration_s=1000.0), seed=7).loop
    base = identify(hidden)
    limit = free / samples
    return {
        "limit": f"one evaluation on {samples:,} samples, 128 candidates at a time: base model {1e6 * free:.2f} us, "
                 f"ARX cost {1e6 * arx:.2f} us",
        "identify": table("identify, sample_data/foptd_scanned.parquet", lambda: identify(watched_loop),
                          watched_loop.samples, limit * watched_loop.samples),
        "hidden": table("identify, a loop with a hidden sine", lambda: identify(hidden), hidden.samples,
                        limit * hidden.samples),
        "diagnose": table("diagnose --apply of that loop", lambda: diagnose(hidden, base, apply=True), hidden.samples,
                          limit * hidden.samples),
    }


def main() -> int:
    """Print the tables, and write them into a page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--page", type=Path)
    parser.add_argument("--warm", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if not given.warm:
        # Another process compiles what is not on disk.
        subprocess.run([sys.executable, __file__, "--warm"], check=True, stdout=subprocess.DEVNULL)
        watched()
    found = tables()
    print("\n\n".join(found.values()))
    if given.page:
        from speed import stages

        text = given.page.read_text(encoding="utf-8")
        for name, body in {**found, "start": stages()}.items():
            text = re.sub(rf"(<!-- {name} -->\n```text\n).*?(```\n)", lambda m, b=body: f"{m[1]}{b}\n{m[2]}", text,
                          flags=re.DOTALL)
        given.page.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
