"""The longer notebook of the docs runs as written, and its page shows what it prints today."""

from __future__ import annotations

from pathlib import Path

import pytest
import test_notebooks


@pytest.mark.parametrize("name", ["plant_month"])
def test_a_notebook_runs_and_its_page_shows_it(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    test_notebooks.test_a_notebook_runs_and_its_page_shows_it(name, tmp_path, monkeypatch)
