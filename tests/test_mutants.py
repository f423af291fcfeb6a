"""Small faults that measure the tests: the same draw for a seed, code that parses, and a working tree left alone.

Mutants of the package, and one that is killed in a copy, are in benchmarks/long.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import mutants

SOURCE = '''
"""Docstring."""
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from b import c


def f(x: float, y: int | None = None) -> float:
    """Docstring."""
    if x < 0.5 and not y:
        raise ValueError
    x += g(x) * 2
    return x
'''


def package(folder: Path, source: str) -> Path:
    room = folder / "stictionid" / "verdict"
    room.mkdir(parents=True)
    # (a folder without these would give way to an installed package)
    for each in (room, room.parent):
        (each / "__init__.py").touch()
    (room / "f.py").write_text(source, encoding="utf-8")
    return folder


def test_every_edit_of_a_module_may_be_drawn_and_no_other(tmp_path: Path) -> None:
    found = mutants.drawn(1000, 0, ("verdict",), package(tmp_path, SOURCE))
    assert Counter((m.line, m.change) for m in found) == Counter([
        (11, "if x < 0.5 and (not y) -> if not (x < 0.5 and (not y))"),
        (11, "x < 0.5 and (not y) -> x < 0.5 or not y"), (11, "x < 0.5 -> x <= 0.5"), (11, "x < 0.5 -> x > 0.5"),
        (11, "0.5 -> 1.0"), (11, "0.5 -> -0.5"), (11, "not y -> y"), (12, "raise ValueError -> pass"),
        (13, "x += g(x) * 2 -> pass"), (13, "g(x) * 2 -> g(x) / 2"), (13, "2 -> 3"), (13, "2 -> -2"),
        (14, "return x -> return 0.0")])


def test_modules_with_compiled_kernels_are_left_out(tmp_path: Path) -> None:
    kernel = "@kernel\ndef f(x):\n    return x + 1\n"
    assert mutants.compiled(kernel) and not mutants.compiled(SOURCE)
    assert mutants.drawn(10, 0, ("verdict",), package(tmp_path, kernel)) == []


def test_every_room_names_tests_that_exist() -> None:
    files = {path.stem.removeprefix("test_") for path in (mutants.ROOT / "tests").glob("test_*.py")}
    assert set().union(*mutants.ROOMS.values()) <= files


def test_the_table_reads_at_80_columns() -> None:
    long = mutants.Mutant("verdict", "stictionid/verdict/f.py", 3, "x * " * 40 + "y < 2", "x * " * 40 + "y > 2", "")
    lines = list(mutants.table(Counter(verdict=3), Counter(verdict=4), [long]))
    assert max(map(len, lines)) <= 80
    assert lines[1].split() == ["verdict", "4", "3", "75%"] and lines[2].split() == ["all", "4", "3", "75%"]
    assert lines[-1].strip() == "…* x * x * y < 2 -> …* x * x * y > 2"
