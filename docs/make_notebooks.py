"""Run the notebooks of docs/notebooks/ and write each one's page for the site: its text, its code, what it shows.

Run: python docs/make_notebooks.py [NAME]
A notebook is a Python file in the percent format of jupytext, which Jupyter, VS Code and Spyder open. Its cells run in
an empty folder and in one process, as a kernel would run them. The page holds text; pictures are files beside it.
"""

from __future__ import annotations

import ast
import contextlib
import io
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
HERE = ROOT / "docs" / "notebooks"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
_DOTS_PER_INCH = 80


def names() -> list[str]:
    """The notebooks, by name."""
    return sorted(path.stem for path in HERE.glob("*.py"))


def cells(name: str) -> list[tuple[str, str]]:
    """Kind ("markdown" or "code") and text of every cell."""
    import jupytext

    return [(cell.cell_type, cell.source) for cell in jupytext.read(HERE / f"{name}.py").cells]


def as_ipynb(name: str) -> str:
    """The notebook as Jupyter stores it, without results; its cells are numbered, so that equal ones are equal bytes.
    """
    import jupytext

    book = jupytext.read(HERE / f"{name}.py")
    for i, cell in enumerate(book.cells):
        cell.id = f"{name}-{i}"
    return str(jupytext.writes(book, fmt="ipynb"))


def page(name: str, pictures: Path) -> str:
    """The page of a notebook, run in a new folder; its pictures are put into `pictures`."""
    shown = Shown(name, pictures)
    head = [f"[Open it as a notebook]({name}.ipynb), or run it: `python docs/make_notebooks.py {name}`"]
    out: list[str] = []
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), _wide():
        space: dict[str, Any] = {"__name__": "__main__"}
        for kind, text in cells(name):
            if kind == "markdown":
                out += [text, *head]
                head = []
            else:
                out += [f"```python\n{text}\n```", *shown.of(text, space)]
    return "\n\n".join(out) + "\n"


class Shown:
    """Output of the cells of one notebook as markdown; its pictures are numbered."""

    def __init__(self, name: str, pictures: Path) -> None:
        self.name, self.pictures, self.count = name, pictures, 0

    def of(self, code: str, space: dict[str, Any]) -> Iterator[str]:
        """Run a cell; what it prints, then the value of its last line, as a kernel shows both."""
        body = ast.parse(code).body
        last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
        printed = io.StringIO()
        value = None
        with contextlib.redirect_stdout(printed):
            exec(compile(ast.Module(body, []), self.name, "exec"), space)
            if isinstance(last, ast.Expr):
                value = eval(compile(ast.Expression(last.value), self.name, "eval"), space)
        if printed.getvalue():
            yield _text(printed.getvalue())
        if hasattr(value, "savefig"):
            self.count += 1
            file = f"{self.name}-{self.count}.png"
            value.savefig(self.pictures / file, dpi=_DOTS_PER_INCH, metadata={"Software": None}, bbox_inches="tight")
            yield f"![Picture {self.count} of the notebook]({file})"
        elif value is not None:
            yield _text(repr(value))


def _text(shown: str) -> str:
    return "```text\n" + "\n".join(line.rstrip() for line in shown.strip("\n").splitlines()) + "\n```"


@contextlib.contextmanager
def _wide() -> Iterator[None]:
    """DataFrames as wide as a page of the site."""
    import pandas as pd

    with pd.option_context("display.width", 110, "display.max_columns", None, "display.max_colwidth", 50):
        yield


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    for name in sys.argv[1:] or names():
        (HERE / f"{name}.md").write_text(page(name, HERE), encoding="utf-8")
        print(f"wrote docs/notebooks/{name}.md")
