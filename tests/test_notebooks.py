"""A notebook of the docs runs as written, and its page shows what it prints today; benchmarks/long runs the other."""

from __future__ import annotations

import importlib.util
import json
import re
from pathlib import Path
from typing import Any

import pytest
from printed import same_text, whole_page

pytest.importorskip("jupytext")

ROOT = Path(__file__).parent.parent
NOTEBOOKS = ROOT / "docs" / "notebooks"


def loaded() -> Any:
    spec = importlib.util.spec_from_file_location("make_notebooks", ROOT / "docs" / "make_notebooks.py")
    assert spec and spec.loader
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


NAMES = loaded().names()


def blocks(page: str) -> list[str]:
    return re.split(r"\n```(?:text|python)?\n", page)


def test_there_are_two_and_the_site_shows_them() -> None:
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert NAMES == ["one_loop", "plant_month"] and all(f"notebooks/{name}.md" in nav for name in NAMES)


@pytest.mark.printed
@whole_page
@pytest.mark.parametrize("name", ["one_loop"])
def test_a_notebook_runs_and_its_page_shows_it(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    monkeypatch.syspath_prepend(str(ROOT))
    shown, today = (NOTEBOOKS / f"{name}.md").read_text(encoding="utf-8"), loaded().page(name, tmp_path)
    pyplot.close("all")
    assert len(blocks(shown)) == len(blocks(today)) > 10
    for a, b in zip(blocks(shown), blocks(today), strict=True):
        if "rejected_because" in a and "\n0 " in a:
            a, b = (text.partition("\n1 ")[0] for text in (a, b))  # the effect that was named; others in any order
        same_text(a, b)
    pictures = {path.name for path in NOTEBOOKS.glob(f"{name}-*.png")}
    assert pictures == {path.name for path in tmp_path.iterdir()} == set(re.findall(r"\]\((\S+\.png)\)", shown))


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_the_same_for_jupyter(name: str) -> None:
    made = loaded()
    book = json.loads(made.as_ipynb(name))
    assert [(c["cell_type"], "".join(c["source"])) for c in book["cells"]] == made.cells(name)
    assert made.as_ipynb(name) == made.as_ipynb(name) and all(not c.get("outputs") for c in book["cells"])
