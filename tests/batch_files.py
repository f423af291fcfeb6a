"""Simulated plants for batch tests and benchmarks, tiny loops in every layout; a crew that works in this process."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path

import numpy as np

from stictionid.model.closed_loop import preset, simulate
from stictionid.record.loop import Loop

ROWS = 400


class Inline(Executor):
    """A crew that works here and now."""

    room, sure = 1, True

    def submit(self, fn, /, *args, **kwargs):
        future: Future = Future()
        future.set_result(fn(*args, **kwargs))
        return future

    def dead(self, error):
        return False

    lost = dead


def records(count: int, rows: int = ROWS, *, seed: int = 0) -> dict[str, Loop]:
    """Loops FIC100… with stickband and noise of their own; every third valve is healthy."""
    made = {}
    rng = np.random.default_rng(seed)
    for i in range(count):
        S = 0.0 if i % 3 == 2 else float(rng.uniform(3.0, 8.0))
        # A healthy loop does not swing by itself: its setpoint moves.
        moves = ((0.0, 5.0),) if S else tuple((k * rows / 8, 5.0 - 9.0 * (k % 2)) for k in range(8))
        setting = replace(preset("foptd"), S=S, J=0.8 * S, noise_sd=0.02, duration_s=float(rows), setpoint_moves=moves)
        made[f"FIC{100 + i}"] = simulate(setting, seed=seed + i).loop
    return made


def columns(loop: Loop) -> dict[str, np.ndarray]:
    """The signals of a loop by the suffix of their tag."""
    n = loop.samples
    return {"SP": loop.setpoint if loop.setpoint is not None else np.zeros(n), "PV": loop.process_value,
            "OP": loop.output}


def write_csv(path: Path, loop: Loop, prefix: str = "") -> Path:
    """One loop as a wide CSV with seconds."""
    signals = columns(loop)
    lines = [",".join(["t", *(prefix + name for name in signals)])]
    lines += [",".join([f"{t:g}", *(repr(float(v[k])) for v in signals.values())])
              for k, t in enumerate(loop.time_s)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_wide(path: Path, loops: dict[str, Loop]) -> Path:
    """Several loops as columns FIC100.SP … of one CSV."""
    signals = {f"{name}.{role}": v for name, loop in loops.items() for role, v in columns(loop).items()}
    time = next(iter(loops.values())).time_s
    lines = [",".join(["t", *signals])]
    lines += [",".join([f"{t:g}", *(repr(float(v[k])) for v in signals.values())]) for k, t in enumerate(time)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def long_table(loops: dict[str, Loop], *, area: bool = False):
    """Several loops as an Arrow table of tag, timestamp and value, tag by tag; with `area` a column for folders."""
    import pyarrow as pa

    tags, times, values = [], [], []
    start = np.datetime64("2024-03-01T00:00:00", "ns")
    for name, loop in loops.items():
        stamps = start + (loop.time_s * 1e9).astype("timedelta64[ns]")
        for role, v in columns(loop).items():
            tags.append(np.full(v.size, f"{name}.{role}"))
            times.append(stamps)
            values.append(np.asarray(v))
    made = {"tag": pa.array(np.concatenate(tags)), "timestamp": pa.array(np.concatenate(times)),
            "value": pa.array(np.concatenate(values))}
    if area:
        made["area"] = pa.array([str(t)[:5] for t in np.concatenate(tags)])
    return pa.table(made)


def write_dataset(folder: Path, loops: dict[str, Loop], *, by: str = "area") -> Path:
    """Several loops as a Parquet dataset in hive folders, by area or by tag."""
    import pyarrow as pa
    import pyarrow.dataset as ds

    table = long_table(loops, area=by == "area")
    ds.write_dataset(table, folder, format="parquet",
                     partitioning=ds.partitioning(pa.schema([(by, pa.string())]), flavor="hive"),
                     existing_data_behavior="delete_matching")
    return folder
