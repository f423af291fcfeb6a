"""Branches of the search over models: a count of what a reader must hold, by file.

Run: python benchmarks/branches.py
Counts if, elif, while, conditional expressions, conditions of comprehensions and `filter` in selection/,
methods/auto.py, and files of fit/ that stood in these folders once. Code that moved out of all these counts where it
lands: name its files behind the command.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent / "stictionid"
WHERE = ("selection/*.py", "methods/auto.py", "fit/decimated.py", "fit/rung.py", "fit/study_steps.py")


def branches(source: str) -> Counter[str]:
    """Number of branches of a module by kind."""
    found: Counter[str] = Counter()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.If):
            found["if"] += 1
        elif isinstance(node, ast.While):
            found["while"] += 1
        elif isinstance(node, ast.IfExp):
            found["ternary"] += 1
        elif isinstance(node, ast.comprehension):
            found["filter"] += len(node.ifs)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "filter":
            found["filter"] += 1
    return found


def main() -> int:
    """Print a line a file and the sum."""
    files = sorted({path for pattern in (*WHERE, *sys.argv[1:]) for path in ROOT.glob(pattern)})
    kinds, total = ("if", "while", "ternary", "filter"), Counter[str]()
    print(f"{'file':<28}" + "".join(f"{kind:>9}" for kind in kinds) + f"{'all':>7}")
    for path in files:
        found = branches(path.read_text(encoding="utf-8"))
        total += found
        print(f"{path.relative_to(ROOT).as_posix():<28}" + "".join(f"{found[kind]:>9}" for kind in kinds)
              + f"{sum(found.values()):>7}")
    print(f"{'all':<28}" + "".join(f"{total[kind]:>9}" for kind in kinds) + f"{sum(total.values()):>7}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
