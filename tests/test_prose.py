"""Docstrings of stictionid/: openers such as What or Whether, and the length of a module's first sentence."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "stictionid"
# A docstring begins with a noun phrase or an imperative, not with one of these.
OPENERS = ("What", "Where", "Whether", "How", "Of", "Beside", "Nor", "Not")
LONGEST_SENTENCE = 25


def first_sentence(docstring: str) -> str:
    """Text up to the first full stop before a blank, or up to the end of the first paragraph."""
    paragraph = re.split(r"\n\s*\n", docstring.strip())[0]
    return re.split(r"(?<=[.!?])\s", " ".join(paragraph.split()))[0]


def strings_of(tree: ast.Module) -> Iterator[ast.Constant]:
    """Docstrings of modules, classes and functions, and the strings that stand below a constant."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.value


def faults_of(text: str) -> list[str]:
    """Breaches of the rule in one module, each with its line."""
    tree = ast.parse(text)
    found = [f"line {string.lineno} begins with {word!r}" for string in strings_of(tree)
             if (word := (re.findall(r"\w+", str(string.value)) or [""])[0]) in OPENERS]
    docstring = ast.get_docstring(tree)
    if not docstring:
        return [*found, "the module has no docstring"]
    words = len(first_sentence(docstring).split())
    if words > LONGEST_SENTENCE:
        found.append(f"the first sentence has {words} words, more than {LONGEST_SENTENCE}")
    return found


def test_docstrings_follow_the_rule() -> None:
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if faults := faults_of(path.read_text(encoding="utf-8")):
            found[name] = faults
    assert found == {}


@pytest.mark.parametrize(("text", "said"), [
    ("x = 1\n", "the module has no docstring"),
    ('"""What a valve does."""\n', "line 1 begins with 'What'"),
    ('"""Valve."""\ndef f():\n    """Whether it sticks."""\n', "line 3 begins with 'Whether'"),
    ('"""Valve."""\nclass A:\n    """Valve."""\n    def f():\n        """How far."""\n', "line 5 begins with 'How'"),
    ('"""Valve."""\nLIMIT = 1.0\n"""Beside the point."""\n', "line 3 begins with 'Beside'"),
    ('"""Valve' + " and valve" * 13 + '."""\n', "the first sentence has 27 words, more than 25"),
    ('"""Valve' + "\nand valve" * 13 + '\n\nMore."""\n', "the first sentence has 27 words, more than 25"),
])
def test_a_planted_fault_is_found(text: str, said: str) -> None:
    assert faults_of(text) == [said]


def test_good_docstrings_pass() -> None:
    assert faults_of('"""Valve. ' + "More " * 30 + '."""\ndef f():\n    """Notable share, e.g. Often."""\n') == []
