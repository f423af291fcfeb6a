"""Every number that steers the search is a field of `Policy`: no other file of selection/ holds one."""

from __future__ import annotations

import ast
import dataclasses
from pathlib import Path

import pytest

import stictionid
from stictionid.selection.policy import Policy

SELECTION = Path(stictionid.__file__).parent / "selection"
ALLOWED = {0, 1, 2, 0.5}


def literals(source: str) -> list[tuple[int, float]]:
    """Line and value of every number in a source that is no index, subscript or format."""
    tree = ast.parse(source)
    indices = {id(part) for node in ast.walk(tree) if isinstance(node, ast.Subscript) for part in ast.walk(node.slice)}
    return [(node.lineno, node.value) for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, (int, float))
            and not isinstance(node.value, bool) and id(node) not in indices and abs(node.value) not in ALLOWED]


def test_no_file_of_the_selection_but_the_policy_holds_a_number() -> None:
    found = {path.name: numbers for path in sorted(SELECTION.glob("*.py")) if path.name != "policy.py"
             and (numbers := literals(path.read_text(encoding="utf-8")))}
    assert not found


@pytest.mark.parametrize(("source", "value"), [("a = 3", 3), ("f(x, 1e-3)", 1e-3), ("LIMIT: float = 20.0", 20.0)])
def test_a_planted_number_is_found(source: str, value: float) -> None:
    assert [v for _, v in literals(source)] == [value]
    assert literals("a[3:7], b[-1, 4], x + 2, 0.5 * y") == []


def test_the_policy_has_at_most_thirty_fields_with_unit_and_benchmark() -> None:
    fields = dataclasses.fields(Policy)
    assert len(fields) <= 30
    root = SELECTION.parent.parent
    for f in fields:
        source = f.metadata["benchmark"]
        assert f.metadata["unit"] and f.metadata["meaning"]
        assert source.startswith("docs/details.md") or (root / source).exists(), source
