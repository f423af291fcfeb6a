"""Statements, lines and files of the package, a row per room.

Run: python benchmarks/size.py [--modules ROOM] [--root FOLDER]

A statement is a node of `ast`; docstrings are not counted. Lines are all lines of a file. With --modules, each file of
the room is a row.
"""

from __future__ import annotations

import argparse
import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
Size = tuple[int, int, int]
"""Statements, lines and files."""


def statements(source: str) -> int:
    """Statements of a file, docstrings not counted."""
    tree = ast.parse(source)
    count = sum(isinstance(node, ast.stmt) for node in ast.walk(tree))
    texts = sum(
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for node in ast.walk(tree)
    )
    return count - texts


def sizes(root: Path, room: str | None = None) -> dict[str, Size]:
    """Size of each room of a package, or of each file of one room."""
    found: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root).parts
        if room is None:
            name = parts[0] if len(parts) > 1 else "(top)"
        elif parts[0] == room:
            name = "/".join(parts[1:])
        else:
            continue
        source = path.read_text(encoding="utf-8")
        for place, value in enumerate((statements(source), source.count("\n"), 1)):
            found[name][place] += value
    return {name: (size[0], size[1], size[2]) for name, size in found.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--modules", metavar="ROOM")
    parser.add_argument("--root", type=Path, default=ROOT / "stictionid")
    asked = parser.parse_args()
    rows = sizes(asked.root, asked.modules)
    print(f"{'room':32}{'statements':>12}{'lines':>8}{'files':>7}")
    for name, (count, lines, files) in sorted(rows.items(), key=lambda row: -row[1][1]):
        print(f"{name:32}{count:12,}{lines:8,}{files:7}")
    total = [sum(size[place] for size in rows.values()) for place in range(3)]
    print(f"{'all':32}{total[0]:12,}{total[1]:8,}{total[2]:7}")


if __name__ == "__main__":
    main()
