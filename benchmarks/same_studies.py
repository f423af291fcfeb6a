"""Comparison of the studies of this checkout with those of another commit: python benchmarks/same_studies.py REV.

Each commit identifies and diagnoses every loop of sample_data/ and, where present, of ../shared/hidden_effects in
processes of its own. A row says whether the studies are equal byte for byte. Otherwise it gives the largest relative
difference of their numbers, or the place where their structure differs. Exit 1 where a difference exceeds --within.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
HIDDEN = ROOT.parent / "shared" / "hidden_effects"


def loops() -> list[Path]:
    """Every data file of the two folders."""
    return [path for folder in (ROOT / "sample_data", HIDDEN) for path in sorted(folder.glob("*"))
            if path.suffix in (".csv", ".parquet")]


def study(checkout: Path, data: Path, folder: Path) -> str:
    """The study of a loop after `diagnose --apply`, as one checkout writes it; its own name for itself is left out."""
    target = folder / f"{data.stem}.json"
    for words in (["identify", str(data), "-o", str(target), "-q"], ["diagnose", str(target), "--apply", "-q"]):
        done = subprocess.run([sys.executable, "-m", "stictionid", *words], cwd=folder, capture_output=True, text=True,
                              env={**os.environ, "PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"})
        if done.returncode not in (0, 3):
            raise SystemExit(f"{checkout}: {' '.join(words)}\n{done.stderr}")
        if done.returncode == 3:
            break
    return target.read_text(encoding="utf-8").replace(str(folder), "")


def apart(one: Any, other: Any, place: str = "study") -> tuple[float, str]:
    """Largest relative difference of two parsed studies and its place; infinite where their structure differs."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        return max((apart(one[k], other[k], f"{place}.{k}") for k in one), default=(0.0, place))
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        return max((apart(a, b, f"{place}[{i}]") for i, (a, b) in enumerate(zip(one, other, strict=True))),
                   default=(0.0, place))
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) / max(abs(one), abs(other), 1e-300), place
    return (0.0 if one == other else float("inf")), place


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rev", help="commit to compare with")
    parser.add_argument("--within", type=float, default=0.0, help="largest relative difference of a number")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    worst = 0.0
    with tempfile.TemporaryDirectory() as name:
        other = Path(name) / "other"
        subprocess.run(["git", "clone", "-q", str(ROOT), str(other)], check=True)
        subprocess.run(["git", "-C", str(other), "checkout", "-q", given.rev], check=True)

        def both(data: Path) -> tuple[Path, str, str]:
            folder = Path(name) / data.stem
            folder.mkdir()
            texts = []
            for checkout in (other, ROOT):
                texts.append(study(checkout, data, folder))
                (folder / f"{data.stem}.json").unlink()
            return data, texts[0], texts[1]

        with ThreadPoolExecutor(given.jobs) as pool:
            for data, before, after in pool.map(both, loops()):
                far, place = (0.0, "") if before == after else apart(json.loads(before), json.loads(after))
                worst = max(worst, far)
                print(f"{data.name:24} {'equal bytes' if before == after else f'{far:.2g} at {place}'}", flush=True)
    print(f"largest difference: {worst:.2g}")
    return 0 if worst <= given.within else 1


if __name__ == "__main__":
    sys.exit(main())
