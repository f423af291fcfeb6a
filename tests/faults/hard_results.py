"""Results of fuzzing, faults, kills and soak, run by run, in docs/hard_results.json; runs are only ever added.

Every run carries a fingerprint of the package's files, so that nothing is claimed for later code. `python
tests/faults/hard_results.py` prints the fingerprint of the present code; `python tests/faults/hard_results.py
OTHER.json` adds the runs of another file.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import json
import os
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "hard_results.json"


@functools.cache
def code() -> str:
    """A fingerprint of every Python file of the package: the same for the same code, wherever it lies."""
    digest = hashlib.sha256()
    for file in sorted((ROOT / "stictionid").rglob("*.py")):
        digest.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def add_record_option(parser: argparse.ArgumentParser) -> None:
    """The option --record [FILE] of every tool that adds to the results."""
    parser.add_argument("--record", type=Path, nargs="?", const=RESULTS)


def runs(path: Path = RESULTS) -> list[dict[str, Any]]:
    """All runs so far, oldest first."""
    found: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["runs"] if path.exists() else []
    return found


def add(what: str, fingerprint: str, result: dict[str, Any], path: Path = RESULTS) -> None:
    """Add one run of `what` (fuzz, faults, kills, soak, numbers) on the code with that fingerprint."""
    from stictionid import __version__

    ended = datetime.now(UTC).strftime("%Y-%m-%dT%H:%MZ")
    merge([{"what": what, "code": fingerprint, "version": __version__, "ended": ended} | result], path)


def merge(more: list[dict[str, Any]], path: Path = RESULTS) -> int:
    """Add runs that are not there yet; how many those were. The file is whole at any time."""
    have = runs(path)
    new = [run for run in more if run not in have]
    lines = ",\n".join(json.dumps(run, ensure_ascii=False) for run in have + new)
    part = path.with_suffix(".part")
    part.write_text('{"runs": [\n' + lines + "\n]}\n", encoding="utf-8")
    os.replace(part, path)
    return len(new)


if __name__ == "__main__":
    print(code())
    for other in sys.argv[1:]:
        print(f"{merge(runs(Path(other)))} runs added from {other}")
