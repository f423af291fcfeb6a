"""README.md and docs/: two commands that set everything up, a walk whose output is real, links that lead somewhere."""

from __future__ import annotations

import importlib.util
import re
from fnmatch import fnmatch
from pathlib import Path

import pytest
from printed import said, same_text, whole_page

from stictionid.effects import catalogue
from stictionid.errors import DataError
from stictionid.historian import ReadOptions, read_loop

ROOT = Path(__file__).parent.parent
PAGES = [*(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG", "SECURITY")),
         *sorted((ROOT / "docs").glob("*.md"))]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


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


def test_the_readme_is_short() -> None:
    assert len(TEXT.splitlines()) <= 150


def test_git_ignores_what_the_readme_writes() -> None:
    ignored = [line[1:] for line in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
               if line.startswith("/")]
    code = "\n".join(re.findall(r"```(?:sh|console|python)\n(.*?)```", TEXT, re.DOTALL))
    written = {*re.findall(r"(?: -o | > )(\S+\.\w+)", code),
               *re.findall(r"(?:savefig|save|report)\((?:found, )?\"(\S+)\"\)", code), "loop.truth.json",
               "report-ladder.svg"}
    assert {"study.json", "loop.csv", "fit.png", "loop.html", "diagnose.txt"} <= written
    assert [name for name in written if not any(fnmatch(name, pattern) for pattern in ignored)] == []


def test_no_page_counts_the_effects_and_those_by_hand_are_in_the_table() -> None:
    guide = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    for text in (page.read_text(encoding="utf-8") for page in PAGES):
        assert not re.search(r"(?i)\b(\d+|(twenty|thirty)(-\w+)?|three|four|five) (physical )?effects are\b", text)
        assert not re.search(r"(?i)\b(\d+|(twenty|thirty)(-\w+)?) are known\b", text)
    by_hand = [effect.name for effect in catalogue().values() if effect.asked == "by hand"]
    assert by_hand and [name for name in by_hand if not re.search(rf"^\| `{name}\b", guide, re.MULTILINE)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_to_a_file(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert "://" in target or (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_path_that_a_page_names_exists(page: Path) -> None:
    """Paths in backticks, from the root or from the package; capitals stand for a name to be chosen."""
    for path in re.findall(r"`((?:[a-z_.]+/)+(?:[a-z_]+\.[a-z]+)?)`", page.read_text(encoding="utf-8")):
        assert (ROOT / path).exists() or (ROOT / "stictionid" / path).exists(), f"{page.name} names {path}"


def test_the_example_csv_reads_as_the_readme_says(tmp_path: Path) -> None:
    block = re.search(r"```csv\n(.*?)```", TEXT, re.DOTALL)
    named = re.search(r"identify mine.csv --sp (\w+) --pv (\w+) --op (\w+)", TEXT)
    assert block and named
    header, *rows = block.group(1).splitlines()
    assert len(rows) == 5
    file = tmp_path / "mine.csv"
    file.write_text(block.group(1), encoding="utf-8")
    found = read_loop(file)
    assert (found.name, found.samples, found.step_s) == ("FIC101", 5, 1.0)
    tags = dict(zip(("SP", "PV", "OP"), named.groups(), strict=True))
    for suffix, tag in tags.items():
        header = header.replace(f"FIC101.{suffix}", tag)
    file.write_text("\n".join([header, *rows]), encoding="utf-8")
    with pytest.raises(DataError, match="no column"):
        read_loop(file)
    renamed = read_loop(file, options=ReadOptions(sp=tags["SP"], pv=tags["PV"], op=tags["OP"]))
    assert (renamed.process_value == found.process_value).all() and (renamed.output == found.output).all()
    file.write_text("\n".join(line.partition(",")[2] for line in [header, *rows]), encoding="utf-8")
    timed = read_loop(file, options=ReadOptions(sp=tags["SP"], pv=tags["PV"], op=tags["OP"], step_s=1.0))
    assert (timed.output == found.output).all()


@pytest.mark.printed
@whole_page
def test_the_walk_prints_what_the_pages_show(tmp_path: Path) -> None:
    compared = 0
    for _, shown, today in module().made(tmp_path):
        same_text(shown, today)
        compared += len(said(shown))
    assert compared > 300
    shown = {path.name: path for path in (ROOT / "docs").glob("*.svg")}
    assert shown.keys() == {path.name for path in tmp_path.iterdir()} and len(shown) == 3
    for path in tmp_path.iterdir():
        words = [re.findall(r">([^<]*[A-Za-z][^<]*)</text>", p.read_text(encoding="utf-8"))
                 for p in (path, shown[path.name])]
        assert words[0], f"docs/{path.name} has no words"
        same_text("\n".join(words[1]), "\n".join(words[0]))
