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
    assert mutants.WHOLE.keys() == mutants.ROOMS.keys()
    assert all((mutants.ROOT / name).exists() for names in mutants.WHOLE.values() for name in names)


def of_line(line: int, room: str = "verdict") -> mutants.Mutant:
    return mutants.Mutant(room, "stictionid/verdict/f.py", line, "x * " * 40 + "y < 2", "x * " * 40 + "y > 2", "")


def test_the_table_reads_at_80_columns_and_lists_what_no_test_told() -> None:
    told = [(of_line(line), stage) for line, stage in ((4, "quick"), (3, ""), (2, "studies"), (5, "searches"))]
    lines = list(mutants.table(told))
    assert max(map(len, lines)) <= 80
    shares = ["4", "1", "25%", "1", "25%", "1", "25%", "1"]
    assert lines[1].split() == ["verdict", *shares] and lines[2].split() == ["all", *shares]
    assert [line.strip() for line in lines[4:]] == [
        "stictionid/verdict/f.py:2", "…* x * x * y < 2 -> …* x * x * y > 2",
        "stictionid/verdict/f.py:3", "= …* x * x * y < 2 -> …* x * x * y > 2"]


def test_the_mutants_of_a_printed_table_are_found_again(tmp_path: Path) -> None:
    every = list(mutants.every_mutant(("verdict",), package(tmp_path, SOURCE)))
    some = [m for m in every if m.line in (11, 13)]
    printed = "\n".join(["4 mutants, seed 0", *mutants.table([(m, "") for m in some])])
    assert len(every) == 13 and mutants.listed(printed, every) == some
    assert mutants.listed("\n".join(mutants.table([])), every) == []
