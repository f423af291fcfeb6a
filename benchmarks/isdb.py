"""Scoreboard on the International Stiction Data Base: the verdict of every loop against the label of the experts.

Run: python benchmarks/isdb.py FILE.mat [--labels LABELS.csv] [--published METHODS.csv] [--apply] [--only chemicals]
     [--out isdb.jsonl] [--minutes 60] [--jobs 1]
FILE.mat holds `cdata.<industry>.loop<k>` with PV, OP, SP, t, Ts and comments. A label is read from the words of the
comments; LABELS.csv (columns loop, label) replaces it. METHODS.csv has a column `loop` and one column for each
published method with stiction, "no stiction" or nothing; each is scored on the same labels. `--apply` judges after
`diagnose --apply`. Rows already in the file of --out are skipped. The data base comes with: Jelali and Huang, Detection
and Diagnosis of Stiction in Control Loops, Springer 2010; cite the book when figures are shown.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import reliability
import rows as store

from stictionid.errors import StictionidError
from stictionid.historian import ReadOptions, loops_in
from stictionid.historian.bytes.source import open_source
from stictionid.historian.reading import reading_of
from stictionid.historian.table.formats import read_table
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify

_NOT = re.compile(r"\b(?:no|not|without|non)\b[\s-]+(?:\w+[\s-]+)?stiction", re.IGNORECASE)
_OTHER = re.compile("tuning|disturbance|faulty|dead ?zone|interaction|no oscillation|quanti[sz]ation|saturation|"
                    "sensor", re.IGNORECASE)


def label_of(comments: str) -> str:
    """Label in the words of the comments: stiction, no stiction (another cause is named), or unknown."""
    if _NOT.search(comments):
        return "no stiction"
    if re.search("stiction|sticky|sticking", comments, re.IGNORECASE):
        return "stiction"
    return "no stiction" if _OTHER.search(comments) else "unknown"


def one(file: str, name: str, apply: bool) -> store.Row:
    """Row of one loop: label by its comments, verdict, confidence, S with its interval."""
    options = ReadOptions(loop=name)
    row: store.Row = {"loop": name, "verdict": "undecided", "confidence": 0.0, "S": None, "S_interval": None}
    start = time.process_time()
    try:
        source = open_source(file)
        table = read_table(source, options)
        words = " ".join(text for field, text in table.attributes.items() if "comment" in field.lower())
        row |= {"comments": words, "truth": label_of(words)}
        loop = reading_of(source, table, options).loop
        study = identify(loop, options=Options())
        if apply and study.estimate is not None:
            study = diagnose(loop, study, apply=True)
        verdict, e = study.verdict, study.estimate
        row |= {"verdict": verdict.stiction, "confidence": verdict.confidence, "reason": verdict.reason,
                "S": None if e is None else e.S, "S_interval": None if e is None else e.S_interval}
    except StictionidError as error:
        row |= {"reason": error.message, "failed": True}
    return row | {"cpu_s": time.process_time() - start}


def _column(path: str) -> dict[str, dict[str, str]]:
    """Rows of a CSV file by their loop."""
    with open(path, newline="") as file:
        return {row["loop"].strip(): {k: (v or "").strip().lower() for k, v in row.items() if k}
                for row in csv.DictReader(file)}


def _score(name: str, said: dict[str, str], truth: dict[str, str]) -> None:
    """Print one line of the scoreboard: `said` is a verdict by loop."""
    cells = []
    for label in ("stiction", "no stiction"):
        mine = [loop for loop, t in truth.items() if t == label and loop in said]
        right = sum(said[loop] == label for loop in mine)
        wrong = sum(said[loop] not in (label, "undecided", "") for loop in mine)
        cells.append(f"{right:4d} right {wrong:4d} wrong {len(mine) - right - wrong:4d} open of {len(mine):3d}")
    print(f"{name:12s}   {cells[0]}   {cells[1]}")


def scoreboard(found: list[store.Row], published: dict[str, dict[str, str]]) -> None:
    """Print every loop, the tool beside published methods, and the table of reliability."""
    for row in sorted(found, key=lambda r: r["loop"]):
        S = "" if row["S"] is None else f"S {row['S']:.3g}"
        print(f"{row['loop']:24s} {row.get('truth', 'unknown'):12s} {row['verdict']:12s} {row['confidence']:.2f}  "
              f"{S:10s} {row.get('reason', '')[:90]}")
    truth = {row["loop"]: row.get("truth", "unknown") for row in found}
    print(f"\n{'':12s}   {'sticking loops':40s}  others")
    _score("stictionid", {row["loop"]: row["verdict"] for row in found}, truth)
    for method in sorted({m for cells in published.values() for m in cells} - {"loop"}):
        _score(method, {loop: cells.get(method, "") for loop, cells in published.items()}, truth)
    reliability.table(found)


def main() -> int:
    """Run the loops of the file that are not done yet and print the scoreboard."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file")
    parser.add_argument("--labels", default="")
    parser.add_argument("--published", default="")
    parser.add_argument("--only", default="", help="only loops whose name begins so")
    parser.add_argument("--apply", action="store_true", help="judge after diagnose --apply")
    store.options(parser, out="isdb.jsonl")
    given = parser.parse_args()
    try:
        names = [n for n in loops_in(given.file) if n.startswith(given.only)]
    except StictionidError as error:
        print(f"{error.message}; {error.hint}", file=sys.stderr)
        return error.exit_code
    tasks = [(f"{n}{' applied' if given.apply else ''}", (given.file, n, given.apply)) for n in names]
    keys = {key for key, _ in tasks}
    found = [row for row in store.run(tasks, one, given) if row["key"] in keys]
    labels = _column(given.labels) if given.labels else {}
    for row in found:
        if row["loop"] in labels:
            row["truth"] = labels[row["loop"]]["label"]
    scoreboard(found, _column(given.published) if given.published else {})
    return 0


if __name__ == "__main__":
    sys.exit(main())
