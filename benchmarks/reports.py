"""Reports: time, memory and page weight for short and long records.

Run: python benchmarks/reports.py

The record is simulated. Its study is identified from the first 1,000 s only and written against the whole record,
because reports re-run a model and search nothing. Targets: 10,000 rows under 3 s and 400 MB, 600,000 rows under 15 s; a
page of 10,000 points under 1.5 MB.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Rows, most seconds, most MB of memory, most MB of page; None where nothing is promised.
CASES = ((10_000, 3.0, 400.0, 1.5), (600_000, 15.0, None, None))


def stictionid(*arguments: object, cwd: str) -> None:
    subprocess.run([sys.executable, "-m", "stictionid", *map(str, arguments)], cwd=cwd, check=True,
                   capture_output=True)


def command(*arguments: str) -> tuple[float, float, float]:
    """Seconds of wall clock, seconds of processor and MB of one process; all three, because machines are shared."""
    script = ("import resource, subprocess, sys, time\nt = time.perf_counter()\n"
              "subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)\n"
              "u = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
              "print(time.perf_counter() - t, u.ru_utime + u.ru_stime, u.ru_maxrss / 1024)")
    out = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
    wall, processor, memory = map(float, out.stdout.split())
    return wall, processor, memory


def study_of(rows: int, folder: str) -> Path:
    """A study whose data are `rows` samples."""
    from stictionid.system.files import sha256_of

    process = ("--preset", "foptd", "--S", 4, "--J", 2, "--noise", 0.05, "--seed", 1)
    data, short = Path(folder, f"{rows}.parquet"), Path(folder, "short.parquet")
    stictionid("simulate", *process, "--duration", rows, "-o", data, cwd=folder)
    stictionid("simulate", *process, "--duration", 1000, "-o", short, cwd=folder)
    study = Path(folder, f"{rows}.json")
    stictionid("identify", short, "-o", study, cwd=folder)
    content = json.loads(study.read_text())
    content["data"] |= {"file": str(data), "sha256": sha256_of(data), "rows": rows, "rows_used": rows}
    study.write_text(json.dumps(content))
    return study


def main() -> int:
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        for rows, seconds, memory, weight in CASES:
            study = study_of(rows, folder)
            for kind in ("html", "md", "json"):
                out = Path(folder, f"report-{rows}.{kind}")
                run = [command(sys.executable, "-m", "stictionid", "report", str(study), "-o", str(out))
                       for _ in range(3)]
                t, cpu, mb = min(r[0] for r in run), min(r[1] for r in run), max(r[2] for r in run)
                size = out.stat().st_size / 1e6
                print(f"{rows:7,} rows  {kind:5s} {t:6.2f} s  {cpu:6.2f} s of processor  {mb:5.0f} MB  "
                      f"{size:6.2f} MB written")
                late = t > seconds or (memory is not None and mb > memory)
                heavy = kind == "html" and weight is not None and size > weight
                missed += [f"{rows} {kind}"] if late or heavy else []
    print("targets missed: " + (", ".join(missed) or "none"))
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
