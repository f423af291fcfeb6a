"""Mutants at length: one is killed in a copy, and the copy is put back."""

from __future__ import annotations

import ast
from pathlib import Path

import mutants
import pytest
from test_mutants import package


def test_a_mutant_is_killed_in_a_copy_and_the_copy_is_put_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = package(tmp_path / "tree", "def f():\n    return 1\n")
    (root / "tests").mkdir()
    (root / "tests" / "test_f.py").write_text("from stictionid.verdict.f import f\n\n\n"
                                              "def test_f():\n    assert f() > 0\n", encoding="utf-8")
    monkeypatch.setattr(mutants, "ROOT", root)
    monkeypatch.setattr(mutants, "ROOMS", {"verdict": ("f",)})
    monkeypatch.setenv("PYTHONSAFEPATH", "")
    before = {path: path.read_bytes() for path in root.rglob("*.py")}
    copy = mutants.Copy(tmp_path / "copy")
    assert copy.passes("verdict")
    there = tmp_path / "copy" / "stictionid" / "verdict" / "f.py"
    kept = there.stat().st_mtime_ns
    found = {m.change: copy.told_by(m, {"quick": 60.0}) for m in mutants.drawn(10, 0, ("verdict",), root)}
    assert found == {"return 1 -> return None": "quick", "1 -> 2": "", "1 -> -1": "quick"}
    assert there.read_text(encoding="utf-8") == "def f():\n    return 1\n" and there.stat().st_mtime_ns == kept
    assert {path: path.read_bytes() for path in root.rglob("*.py")} == before


def test_a_seed_gives_the_same_mutants_each_of_which_parses() -> None:
    rooms = ("record", "verdict")
    found = mutants.drawn(12, 5, rooms)
    assert found == mutants.drawn(12, 5, rooms) != mutants.drawn(12, 6, rooms)
    for mutant in found:
        there = (mutants.ROOT / mutant.path).read_text(encoding="utf-8")
        assert ast.dump(ast.parse(mutant.source)) != ast.dump(ast.parse(there))
        assert 0 < mutant.line <= there.count("\n")
