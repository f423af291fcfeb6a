"""Citations that a reader of the clone can follow: every document, section and export trap that is named is there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
# A name such as README.md, which would have to stand in the root of the clone.
DOCUMENT = re.compile(r"(?<![\w/])[A-Z]{3,}\.md\b")
SECTIONS = re.compile(r"docs/details\.md, sections? (\d+(?:\.\d+)?(?:(?:, | and )\d+(?:\.\d+)?)*)")
TRAPS = re.compile(r"docs/traps\.md, export traps? (\d+(?:(?:, | and )\d+)*)")
# An equation or figure of "the paper", which the reader would have to guess.
UNNAMED = re.compile(r"\bpaper(?:'s|,)? (?:Eqs?|Figs?)\.")
OWN = Path(__file__).name


def texts() -> Iterator[tuple[str, str]]:
    """Name and text of the clone's own files, without the folders that tools make."""
    for folder in ("stictionid", "tests", "benchmarks", "docs", "sample_data"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in {".py", ".md", ".toml", ".json"} and path.name != OWN:
                yield path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
    for name in ("README.md", "CONTRIBUTING.md", "pyproject.toml", "mkdocs.yml"):
        yield name, (ROOT / name).read_text(encoding="utf-8")


def sections() -> set[str]:
    """Numbers of the sections of docs/details.md and of the numbered items that are cited with them."""
    text = (ROOT / "docs" / "details.md").read_text(encoding="utf-8")
    found = set()
    for number, body in re.findall(r"^## (\d+)\. [^\n]*\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL):
        found |= {number, *(f"{number}.{item}" for item in re.findall(r"^(\d+)\. ", body, re.MULTILINE))}
        found |= set(re.findall(rf"^\*\*({number}\.\d+) ", body, re.MULTILINE))
    return found


def traps() -> set[str]:
    """Numbers of the export traps of docs/traps.md."""
    text = (ROOT / "docs" / "traps.md").read_text(encoding="utf-8")
    return set(re.findall(r"^(\d+)\. ", text.partition("## Export traps")[2].partition("\n## ")[0], re.MULTILINE))


def faults_of(text: str) -> list[str]:
    """Citations of one text that lead nowhere; a citation may go on in the next line of a comment."""
    text = re.sub(r"\s*\n\s*(?:# )?", " ", text)
    found = [f"no document {name}" for name in DOCUMENT.findall(text) if not (ROOT / name).exists()]
    for pattern, there, kind in ((SECTIONS, sections(), "section"), (TRAPS, traps(), "export trap")):
        cited = [n for numbers in pattern.findall(text) for n in re.findall(r"\d+(?:\.\d+)?", numbers)]
        found += [f"no {kind} {n}" for n in cited if n not in there]
    return found + [f"unnamed: {said}" for said in UNNAMED.findall(text)]


def test_every_citation_leads_to_a_place_in_the_clone() -> None:
    found = {name: faults for name, text in texts() if (faults := faults_of(text))}
    assert found == {}


def test_the_sections_are_numbered_without_a_gap() -> None:
    whole = sorted(int(n) for n in sections() if "." not in n)
    assert whole == list(range(1, len(whole) + 1))
    assert {"6.1", "6.5", "6.6", "10.1", "10.3"} <= sections()
    assert traps() == {str(k) for k in range(1, 21)}


@pytest.mark.parametrize(("text", "said"), [
    ("Source: NOWHERE.md section 4.", ["no document NOWHERE.md"]),
    ("Source: docs/details.md, section 99.", ["no section 99"]),
    ("Source: docs/details.md, sections 6.1 and\n# 6.9.", ["no section 6.9"]),
    ("docs/traps.md, export traps 2 and 44", ["no export trap 44"]),
    ("as in the paper, Fig. 7", ["unnamed: paper, Fig."]),
    ("README.md; docs/details.md, section 6.1; docs/traps.md, export trap 12; Shang et al., Eq. 21", []),
])
def test_a_planted_citation_is_judged(text: str, said: list[str]) -> None:
    assert faults_of(text) == said
