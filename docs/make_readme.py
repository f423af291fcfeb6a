"""Runs the commands of README.md's walk through and puts their real output below them: python docs/make_readme.py.

A console block after `<!-- run -->` holds commands (lines that begin with "$ ") and what they print. All blocks run in
one empty folder, in order. Pictures that the README shows from docs/ are those that the commands made there.
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
README = ROOT / "README.md"
_PICTURE = re.compile(r"\]\(docs/([\w-]+\.svg)\)")
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
        done = subprocess.run(words, shell=True, cwd=folder, capture_output=True, text=True, timeout=300,
                              env={**os.environ, "PYTHONPATH": str(ROOT), "NO_COLOR": "1"})
        if done.returncode:
            raise SystemExit(f"{command}\n{done.stderr}")
        lines += [f"$ {command}", *(line.rstrip() for line in done.stdout.splitlines())]
    return "\n".join(lines) + "\n"


def made(text: str, pictures: Path) -> Iterator[tuple[str, str]]:
    """Every block of `text` beside what its commands print today; the pictures it shows are put into a folder."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "sample_data", Path(folder) / "sample_data")
        for commands, body in blocks(text):
            yield body, run(commands, Path(folder))
        for name in _PICTURE.findall(text):
            shutil.copy(Path(folder) / name, pictures / name)


if __name__ == "__main__":
    content = README.read_text(encoding="utf-8")
    for old, new in made(content, ROOT / "docs"):
        content = content.replace(f"```console\n{old}```", f"```console\n{new}```")
    README.write_text(content, encoding="utf-8")
