"""Table of the plants by family: one line for each level of each factor, with binomial intervals.

    python benchmarks/plants/table.py rows.jsonl more.jsonl
    python benchmarks/plants/table.py --beside old.jsonl new.jsonl
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from plants.design import FACTORS, plain
from plants.score import ERROR_WITHIN, S_WITHIN

# Normal quantile of a two-sided 90 % interval.
_Z90 = 1.6448536269514722
# Error of the true model over the noise, up to which the samples hold what the model needs.
_AT_NOISE = 1.2
Row = dict[str, Any]


def rows_of(path: str | Path) -> list[Row]:
    """Rows of a file; a last line that was cut off is left out."""
    out = []
    for line in Path(path).read_text().splitlines():
        try:
            out.append(json.loads(line))
        except ValueError:
            continue
    return out


def wilson(hits: int, total: int) -> tuple[float, float]:
    """Wilson's 90 % interval of a share, (0, 1) for no loops."""
    if not total:
        return 0.0, 1.0
    p, z = hits / total, _Z90
    middle = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * float(np.sqrt(p * (1 - p) / total + z * z / (4 * total * total)))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def families(rows: Iterable[Row]) -> list[tuple[str, list[Row]]]:
    """All rows, those whose true model comes to the noise or not, of each level of a factor, and of each effect."""
    rows = list(rows)
    out = [("all", rows)]
    checked = [r for r in rows if r.get("true_error")]
    out += [("true model at the noise", [r for r in checked if r["true_error"] <= _AT_NOISE]),
            ("true model above it", [r for r in checked if r["true_error"] > _AT_NOISE])]
    for factor, levels in FACTORS.items():
        out += [(f"{factor} {level}", [r for r in rows if r["levels"][factor] == level]) for level in levels]
    hidden = sorted({plain(name) for r in rows for name in r["hidden"]})
    return out + [(name, [r for r in rows if name in map(plain, r["hidden"])]) for name in hidden]


def scored(rows: Iterable[Row]) -> list[Row]:
    """Rows that count: neither without a loop nor with an effect that the samples do not show."""
    return [r for r in rows if "out" not in r]


def print_table(rows: list[Row], say: Callable[[str], None] = print) -> None:
    """Print the loops left out, the table by family, and the wrong answers.

    The column "error" counts free-run errors within 1.05 of the noise, "path" those with slips where PV placed them.
    The column "true" counts loops whose true model, polished from the true values, comes within 1.2 of the noise; the
    column "scans" those held ones whose true model does so under the true command at every scan.
    """
    left = Counter(r["out"] for r in rows if "out" in r)
    say(f"{len(rows)} loops, {len(scored(rows))} scored" + "".join(f", {n} {why}" for why, n in left.items()))
    say(f"{'family':26s} {'loops':>5s} {'out':>4s} {'right':>5s} {'alike':>5s}   % (90 %)          {'false':>5s} "
        f"{'S 2%':>5s} {'J 10%':>5s} {'error':>5s} {'path':>5s} {'true':>5s} {'scans':>5s}   "
        "CPU s: median, 95 %, longest")
    for name, members in families(rows):
        if members:
            say(_family(name, members))
    rebuilt = [r["rebuilt_error"] for r in rows if r.get("rebuilt_error")]
    if rebuilt:
        say(f"held commands exported slower than the scan, no gap: the true model under the true command, less what "
            f"noise between samples did to it: {np.median(rebuilt):.2f} times the noise (median of {len(rebuilt)}), "
            f"{sum(e <= _AT_NOISE for e in rebuilt)} within {_AT_NOISE:g}")
    fitted = [r for r in scored(rows) if "true_S_error" in r]
    if fitted:
        close = [abs(r["true_S_error"]) <= S_WITHIN for r in fitted]
        say(f"the true model itself, fitted from the true values: S within 2 % in {sum(close)} of {len(fitted)}, error "
            f"within {ERROR_WITHIN:g} of the noise in {sum(r['true_error'] <= ERROR_WITHIN for r in fitted)}")
    wrong = [r for r in scored(rows) if r["right"] == "wrong"]
    for r in wrong:
        said = "+".join(r["answer"]) or r.get("error") or ("abstained: " + r.get("reason", "") if r.get("abstained")
                                                           else "nothing")
        say(f"wrong {r['kind']} {r['loop']} {'|'.join(r['levels'].values())}: {'+'.join(r['hidden']) or 'clean'} -> "
            f"{said}" + (f", error {r['error_over_noise']:.2f}, S {100 * r['S_error']:+.1f} %, "
                         f"J {100 * r['J_error']:+.1f} %" if "S_error" in r else ""))


def _family(name: str, members: list[Row]) -> str:
    rows = scored(members)
    exact, alike = (sum(r["right"] == how for r in rows) for how in ("exact", "alike"))
    low, high = wilson(exact + alike, len(rows))
    # A missing number is a miss: an answer without S and J is not within 2 %.
    good = [sum(bool(r.get(key)) for r in rows) for key in ("S_good", "J_good", "error_good", "path_error_good")]
    seconds = [r["cpu_s"] for r in rows]
    times = f"{np.median(seconds):7.1f} {np.quantile(seconds, 0.95):7.1f} {max(seconds):7.1f}" if seconds else ""
    share = 100.0 * (exact + alike) / max(len(rows), 1)
    false = sum(bool(r.get("false")) for r in rows)
    # Where the check was left out, or the command moves, there is no such error.
    true, scans = (sum((r.get(key) or np.inf) <= _AT_NOISE for r in members) for key in ("true_error", "scans_error"))
    return (f"{name:26s} {len(rows):5d} {len(members) - len(rows):4d} {exact + alike:5d} {alike:5d} {share:5.1f} "
            f"({100 * low:3.0f} to {100 * high:3.0f})  {false:5d} {good[0]:5d} {good[1]:5d} {good[2]:5d} {good[3]:5d} "
            f"{true:5d} {scans:5d}  {times}")


def beside(old: list[Row], new: list[Row], say: Callable[[str], None] = print) -> None:
    """Both checkouts on the loops that both have run and that count; then each loop whose judgement differs."""
    first = {_key(r): r for r in old}
    both = [(first[_key(r)], r) for r in scored(new) if _key(r) in first]
    for title, rows in (("old", [a for a, _ in both]), ("new", [b for _, b in both])):
        say(f"--- {title}")
        print_table(rows, say)
    say("--- loops whose judgement differs")
    for a, b in both:
        if a["right"] != b["right"]:
            say(f"{b['kind']} {b['loop']} {'|'.join(b['levels'].values())}: {'+'.join(b['hidden']) or 'clean'}: "
                f"{'+'.join(a['answer']) or 'nothing'} ({a['right']}, {a['cpu_s']:.1f} s) -> "
                f"{'+'.join(b['answer']) or 'nothing'} ({b['right']}, {b['cpu_s']:.1f} s)")


def _key(row: Row) -> tuple[str, int, int]:
    return row["kind"], row["loop"], row["seed"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--beside", action="store_true", help="two files, old and new, on their common loops")
    a = parser.parse_args()
    if a.beside:
        if len(a.files) != 2:
            parser.error(f"--beside takes two files, not {len(a.files)}")
        beside(*(rows_of(path) for path in a.files))
        return
    print_table([row for path in a.files for row in rows_of(path)])


if __name__ == "__main__":
    main()
