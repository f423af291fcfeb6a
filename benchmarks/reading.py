"""Reading 2.6 million rows of four tags (one per second for 30 days): time and peak memory, one process each.

    python benchmarks/reading.py [rows]
    python benchmarks/reading.py --wide GIGABYTES      a CSV of 64 columns of which four are wanted, read in pieces
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROWS = 2_600_000

JOBS = {
    "stictionid, CSV": "from stictionid.historian import read_loop\nn = read_loop(r'{csv}').samples",
    "pyarrow.csv, CSV": "from pyarrow import csv\nn = csv.read_csv(r'{csv}').num_rows",
    "pandas.read_csv, CSV": "import pandas\nn = len(pandas.read_csv(r'{csv}', parse_dates=['timestamp']))",
    "stictionid, Parquet": "from stictionid.historian import read_loop\nn = read_loop(r'{parquet}').samples",
    "pyarrow.parquet, Parquet": "import pyarrow.parquet as pq\nn = pq.read_table(r'{parquet}').num_rows",
    "pandas.read_parquet, Parquet": "import pandas\nn = len(pandas.read_parquet(r'{parquet}'))",
}
LIMITS = {"stictionid, CSV": (4.0, 1024), "stictionid, Parquet": (1.5, 1024)}


def make(folder: Path, rows: int) -> tuple[Path, Path]:
    """One loop as CSV and as Parquet."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq
    from pyarrow import csv

    rng = np.random.default_rng(1)
    t = np.arange(rows)
    ns = np.datetime64("2024-05-01T00:00:00", "s") + t.astype("timedelta64[s]")
    table = pa.table(
        {
            "timestamp": pa.array(ns),
            "FIC101.SP": np.full(rows, 50.0),
            "FIC101.PV": np.round(50 + 2 * np.sign(np.sin(t / 40)) + 0.2 * rng.standard_normal(rows), 4),
            "FIC101.OP": np.round(42 + 3 * np.arcsin(np.sin(t / 40 + 1)) + 0.05 * rng.standard_normal(rows), 4),
            "FIC101.ZT": np.round(42 + 3 * np.sign(np.sin(t / 40)) + 0.05 * rng.standard_normal(rows), 4),
        }
    )
    csv.write_csv(table, folder / "loop.csv")
    pq.write_table(table, folder / "loop.parquet")
    return folder / "loop.csv", folder / "loop.parquet"


def make_wide(path: Path, size: float) -> None:
    """A loop and 60 other tags, so many rows that the file has `size` bytes."""
    import numpy as np

    rng = np.random.default_rng(1)
    others = [",".join(f"{v:.3f}" for v in rng.uniform(0, 999, 60)) for _ in range(500)]
    first, block, written = np.datetime64("2024-05-01T00:00:00"), 20_000, 0
    with open(path, "w", encoding="ascii") as file:
        names = ["timestamp", "FIC101.SP", "FIC101.PV", "FIC101.OP", *(f"TI{i}" for i in range(60))]
        file.write(",".join(names) + "\n")
        for begin in range(0, 1 << 40, block):
            t = np.arange(begin, begin + block)
            stamps = np.datetime_as_string(first + t.astype("timedelta64[s]"))
            pv = np.round(50 + 2 * np.sign(np.sin(t / 40)) + 0.2 * rng.standard_normal(block), 3)
            op = np.round(42 + 3 * np.arcsin(np.sin(t / 40 + 1)) + 0.05 * rng.standard_normal(block), 3)
            rows = zip(stamps, pv, op, strict=True)
            text = "\n".join(f"{s},50.0,{y},{u},{others[i % 500]}" for i, (s, y, u) in enumerate(rows))
            written += file.write(text + "\n")
            if written >= size:
                return


def wide(gigabytes: float) -> None:
    """Time and memory of reading a large wide file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "wide.csv"
        make_wide(path, gigabytes * 1e9)
        result = measure(JOBS["stictionid, CSV"].format(csv=path))
        print(f"CSV of {path.stat().st_size / 1e9:.2f} GB, {result['rows']:,.0f} rows x 64 columns, four wanted: "
              f"{result['seconds']:.1f} s, peak {result['mb']:.0f} MB")


def measure(code: str) -> dict[str, float]:
    """Seconds inside the process (imports included) and its peak memory in MB."""
    program = (
        "import json, resource, time\nt = time.perf_counter()\n" + code + "\nseconds = time.perf_counter() - t\n"
        "mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024\n"
        "print(json.dumps({'seconds': seconds, 'rows': n, 'mb': mb}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return result


def main() -> None:
    """Print the table; exit 1 when a limit is missed."""
    if len(sys.argv) > 2 and sys.argv[1] == "--wide":
        wide(float(sys.argv[2]))
        return
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else ROWS
    missed = False
    with tempfile.TemporaryDirectory() as folder:
        csv_path, parquet_path = make(Path(folder), rows)
        print(
            f"{rows:,} rows x 4 tags; CSV {csv_path.stat().st_size / 1e6:.0f} MB, "
            f"Parquet {parquet_path.stat().st_size / 1e6:.0f} MB"
        )
        print(f"{'what':32s} {'seconds':>8s} {'peak MB':>8s}  limit")
        for name, code in JOBS.items():
            result = measure(code.format(csv=csv_path, parquet=parquet_path))
            limit = LIMITS.get(name)
            late = limit is not None and (result["seconds"] > limit[0] or result["mb"] > limit[1])
            missed |= late
            print(
                f"{name:32s} {result['seconds']:8.2f} {result['mb']:8.0f}  "
                + (f"{limit[0]:g} s, {limit[1]} MB {'MISSED' if late else 'met'}" if limit else "")
            )
    sys.exit(1 if missed and rows == ROWS else 0)


if __name__ == "__main__":
    main()
