"""The installed package has the files of the source tree; the papers of a release name its version."""

from __future__ import annotations

import re
import sys
import sysconfig
from importlib.metadata import distributions
from pathlib import Path

import pytest

from stictionid import __version__
from stictionid.system import files

PACKAGE = Path(__file__).resolve().parent.parent / "stictionid"


def test_the_installed_package_holds_every_file_of_the_source() -> None:
    found = distributions(name=PACKAGE.name, path=[sysconfig.get_path("purelib")])
    installed = {path.as_posix() for one in found for path in one.files or []
                 if path.parts[0] == PACKAGE.name and "__pycache__" not in path.parts}
    if not installed:
        pytest.skip("stictionid is not installed here, or as a link to its source")
    source = {path.relative_to(PACKAGE.parent).as_posix() for path in PACKAGE.rglob("*")
              if path.is_file() and "__pycache__" not in path.parts}
    assert source == installed


def test_a_run_that_asks_for_the_installed_package_tests_it() -> None:
    if not sys.flags.safe_path:
        pytest.skip("the source is tested here; .ci/elsewhere.py tests the wheel")
    assert PACKAGE not in Path(files.__file__).parents


def test_citation_and_changelog_name_this_version() -> None:
    citation, changelog = ((PACKAGE.parent / name).read_text(encoding="utf-8")
                           for name in ("CITATION.cff", "CHANGELOG.md"))
    day = re.search(rf"^## \[{re.escape(__version__)}\] - (\S+)$", changelog, re.MULTILINE)
    assert day and f"\nversion: {__version__}\ndate-released: {day[1]}\n" in citation
