"""The installed package has the files of the source tree, from which tests and their processes run."""

from __future__ import annotations

import sysconfig
from importlib.metadata import distributions
from pathlib import Path

import pytest

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
