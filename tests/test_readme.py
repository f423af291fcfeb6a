"""README.md and docs/: two commands that set everything up, a walk whose output is real, links that lead somewhere."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path

import pytest
import typer
from printed import said, same_text, whole_page

from stictionid.cli.app import app
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


# A number in the prose: digits or a word. Code, links and what the commands print are no prose.
_WORDS = {"one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8, "nine": 9, "ten": 10,
          "eleven": 11, "twelve": 12, "fourteen": 14, "fifteen": 15, "twenty": 20, "thirty": 30, "hundred": 100}
_NUMBER = re.compile(rf"\d+(?:[.,]\d+)*|\b(?:{'|'.join(_WORDS)})\b", re.IGNORECASE)
# Numbers that no run prints: advice.
_GIVEN = (r"(Ten) whole cycles in automatic", r"Of (100) such intervals")


def prose(text: str) -> str:
    return re.sub(r"```.*?```|`[^`]*`|\]\([^)]*\)", "", text, flags=re.DOTALL)


def sources(text: str) -> dict[str, Sequence[float | str]]:
    """Sentences with numbers, and the same numbers as commands, outputs, settings, figures and lists give them."""
    def first(pattern: str) -> tuple[str, ...]:
        found = re.search(pattern, text)
        assert found, pattern
        return found.groups()

    suite = re.search(r"the README's test command.* (\d+) s of processor time \((\d+) s on the slower",
                      (ROOT / "docs" / "figures.md").read_text(encoding="utf-8"))
    assert suite, "docs/figures.md has no processor time of the tests"
    codes = typer.main.get_command(app).commands["identify"].epilog  # type: ignore[attr-defined]
    level = first(r"(\d+) % intervals\n")
    return {
        r"from (\w+)\s+signals": (len(first(r"```csv\nTime,(.*)\n")[0].split(",")),),
        r"answers (\w+) questions": (len(re.findall(r"^\* ", text.split("\n## ")[0], re.MULTILINE)),),
        r"each with a (\d+) % interval": level, r"\*\*(\d+) % interval": level, r"about (\d+) hold the truth": level,
        r"## (\w+) commands": (text.count("```sh\n"),),
        r"(\w+) to (\w+) minutes of processor time": [round(int(seconds) / 60) for seconds in suite.groups()],
        r"Python ([\d.]+) or newer": re.findall(r'requires-python = ">=(.*)"', (ROOT / "pyproject.toml").read_text()),
        r"(\w+) are enough, or setpoint moves that make the valve reverse (\w+) times": first(
            r"(\d+) are needed\) and no setpoint\s+moves that make the valve reverse (\d+) times"),
        r"exit code (\d), or (\d) with": re.findall(r"(\d) (?:done, whatever the answer|with --strict)", codes),
        r"ends with (\d), as these (\d+) s do": (*first(r"exit code (\d)\n```"), *first(r"--end (\d+)")),
        r"S = (\S+) % and J = (\S+) %": first(r"--S (\S+) --J (\S+)"), r"stop at (\S+) %": first(r"upper=(\S+)"),
        r"leaves ([\d.]+)\.\n": first(r"Error \S+ -> (\S+), the noise"),
        r"It is ([\d.]+) at most where": first(r"verdict: stiction \(confidence (.*)\)"),
        r"The error is (\S+) times": first(r"free-run error \S+ is (\S+) times"),
    }


def strange_numbers(said: str, text: str) -> list[str]:
    """Numbers of the prose that its sources contradict, and those that have no source."""
    found, known = [], set()
    for pattern, values in {**sources(text), **dict.fromkeys(_GIVEN, ())}.items():
        match = re.search(pattern, said)
        if match is None:
            found.append(f"nothing says {pattern}")
            continue
        known |= {match.span(i) for i in range(1, len(match.groups()) + 1)}
        found += [f"{value}, not {match[0]}" for word, value in zip(match.groups(), values, strict=bool(values))
                  if float(_WORDS.get(word.lower(), word)) != float(value)]
    return found + [f"no source: {said[m.start() - 30:m.end() + 30]}" for m in _NUMBER.finditer(said)
                    if m.span() not in known]


def test_every_number_of_the_prose_is_what_the_commands_print() -> None:
    assert strange_numbers(prose(TEXT), TEXT) == []


def test_a_spoiled_number_of_the_prose_is_found() -> None:
    said = prose(TEXT)
    given = [re.search(pattern, said) for pattern in _GIVEN]
    for number in _NUMBER.finditer(said):
        if number.span() not in [match and match.span(1) for match in given]:
            spoiled = f"{said[:number.start()]}7{said[number.end():]}"
            assert strange_numbers(spoiled, TEXT), number
    assert any("no source" in line for line in strange_numbers(f"{said} Twelve effects.", TEXT))


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
