"""The README: exactly two commands that set everything up, and a walk through whose output is real."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?")


def module():
    spec = importlib.util.spec_from_file_location("make_readme", ROOT / "docs" / "make_readme.py")
    assert spec and spec.loader
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def test_exactly_two_commands_set_everything_up() -> None:
    commands = re.findall(r"^```sh\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
    assert len(commands) == 2 and all(len(c.splitlines()) == 1 for c in commands)
    assert "pip install ." in commands[0] and "stictionid identify sample_data/" in commands[0]
    assert "-m pytest" in commands[1]
    for name in re.findall(r"sample_data/\S+", commands[0]):
        assert (ROOT / name).is_file()


def test_ci_runs_the_readmes_commands() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "README.md" in script and "```sh" in script


def ranked(text: str) -> list[str]:
    """Lines of an output; of effects that are not named only the names, in their order: a refit that explains little
    may end in another basin on another processor. Of the intervals of a model that misses something only that there
    are some: their ends lie where points that differ by next to nothing were met. Nor how many searches it took until
    two agreed."""
    lines = text.splitlines()
    if any(line.startswith("adequate: no") for line in lines):
        lines = [re.sub(r"2 of \d\|$", "2 agree|", line) for line in lines]
        lines = [re.sub(r"\| +\S+ to \S+ +\|", "| an interval |", line) for line in lines]
    at = [i for i, line in enumerate(lines) if re.match(r"\|[a-z@-]+ +\| +no \|", line)]
    for i, line in zip(at, sorted(lines[i].split("|")[1].strip() for i in at), strict=True):
        lines[i] = line
    return lines


def test_the_walk_through_prints_what_the_readme_shows(tmp_path: Path) -> None:
    compared = 0
    for shown, today in module().made(TEXT, tmp_path):
        for a, b in zip(ranked(shown), ranked(today), strict=True):
            words_a, words_b = _NUMBER.sub("#", a).split(), _NUMBER.sub("#", b).split()
            assert words_a == words_b, f"README shows {a!r}, today it is {b!r}"
            # Numbers may differ in the last digits on another processor, not more.
            for x, y in zip(_NUMBER.findall(a), _NUMBER.findall(b), strict=True):
                assert float(x) == pytest.approx(float(y), rel=0.03, abs=0.02), (a, b)
            compared += 1
    assert compared > 30
    shown = {path.name: path for path in (ROOT / "docs").glob("*.svg")}
    assert shown.keys() == {path.name for path in tmp_path.iterdir()} and len(shown) == 3
    for path in tmp_path.iterdir():
        words = [re.findall(r">([^<]*[A-Za-z][^<]*)</text>", p.read_text(encoding="utf-8"))
                 for p in (path, shown[path.name])]
        assert words[0] and words[0] == words[1], f"docs/{path.name} shows other words than today's"
