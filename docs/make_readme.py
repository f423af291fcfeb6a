"""Run the commands of README.md and of the pages in docs/, and put their real output below them.

Run: python docs/make_readme.py
A console block after `<!-- run -->` holds commands (lines that begin with "$ ") and what they print. All blocks run in
one empty folder, those of README.md first. The pictures that a page shows are those that the commands made there.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
_PICTURE = re.compile(r"\]\((?:docs/)?([\w-]+\.svg)\)")
_BLOCK = re.compile(r"(<!-- run -->\n```console\n)(.*?)(```\n)", re.DOTALL)


def blocks(text: str) -> list[tuple[list[str], str]]:
    """Commands and printed text of every block that runs."""
    return [([line[2:] for line in body.splitlines() if line.startswith("$ ")], body)
            for _, body, _ in _BLOCK.findall(text)]


def run(commands: list[str], folder: Path) -> str:
    """The block as it should stand: each command and what it printed on stdout."""
    lines = []
    for command in commands:
        words = command.replace("stictionid ", f"{sys.executable} -m stictionid ", 1)
        done = subprocess.run(words, shell=True, cwd=folder, capture_output=True, text=True,
                              env={**os.environ, "NO_COLOR": "1", "COLUMNS": "80"})
        if done.returncode:
            raise SystemExit(f"{command}\n{done.stderr}")
        lines += [f"$ {command}", *(line.rstrip() for line in done.stdout.splitlines())]
    return "\n".join(lines) + "\n"


def made(pictures: Path) -> Iterator[tuple[Path, str, str]]:
    """Every block of every page: the page, the block as it stands, and what its commands print today.

    The pictures that the pages show are put into the folder `pictures`.
    """
    with tempfile.TemporaryDirectory() as folder:
        for page in PAGES:
            text = page.read_text(encoding="utf-8")
            for commands, body in blocks(text):
                yield page, body, run(commands, Path(folder))
            for name in _PICTURE.findall(text):
                shutil.copy(Path(folder) / name, pictures / name)


if __name__ == "__main__":
    os.environ["PYTHONPATH"] = str(ROOT)
    for page, old, new in made(ROOT / "docs"):
        content = page.read_text(encoding="utf-8")
        page.write_text(content.replace(f"```console\n{old}```", f"```console\n{new}```"), encoding="utf-8")
