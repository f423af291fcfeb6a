"""Parts shared by all fault injections: test files, a runner for commands, and checks of the result."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
LIMIT_S = 1800.0  # a command that takes longer hangs, on the slowest and busiest machine too

# A loop that is identified in some two seconds, for the command `simulate`.
SMALL = ("--gain", 2, "--time-constant", 6, "--dead-time", 3, "--kc", 0.15, "--ti", 6, "--scan", 1, "--S", 4,
         "--J", 2.5, "--duration", 450, "--noise", 0.06, "--seed", 11, "--setpoint", "0:3", "--setpoint", "112:-4",
         "--setpoint", "225:5", "--setpoint", "337:-3")

# Trials made, what went wrong, and why the fault could not be made ("" when it could).
Result = tuple[int, list[str], str]


def listen() -> None:
    """A child of a job in the background would inherit that SIGINT is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@dataclass(frozen=True)
class Outcome:
    """One kind of fault: how often injected, every failure in a sentence, why it was skipped."""

    name: str
    trials: int
    problems: list[str]
    skipped: str


@dataclass(frozen=True)
class Done:
    """One finished command."""

    arguments: list[str]
    code: int
    out: bytes
    err: str


class Bench:
    """A folder with a small record, its study and a report's inputs, made by the real commands."""

    def __init__(self, folder: Path, seed: int = 0) -> None:
        self.folder, self.random = folder, random.Random(seed)
        self.csv, self.parquet = folder / "loop.csv", folder / "loop.parquet"
        self.study, self.bad = folder / "study.json", folder / "bad.csv"
        for data in (self.csv, self.parquet):
            self.must("simulate", *SMALL, "-o", data)
        self.must("identify", self.csv, "-o", self.study)
        self.study_bytes = self.study.read_bytes()

    def must(self, *arguments: object) -> None:
        """A command that has to work before anything can be broken; the first one may be compiling."""
        done = self.run(*arguments, limit_s=5 * LIMIT_S)
        if done.code:
            raise RuntimeError(f"{done.arguments}: exit {done.code}: {done.err}")

    def place(self, name: str) -> Path:
        """An empty folder of that name, everything of an earlier trial gone."""
        place = self.folder / name
        place.mkdir(exist_ok=True)
        for file in place.iterdir():
            file.unlink()
        return place

    def run(self, *arguments: object, stdin: Any = subprocess.DEVNULL, stdout: Any = subprocess.PIPE,
            env: dict[str, str | None] | None = None, before: Callable[[], None] | None = None,
            cwd: Path | None = None, limit_s: float = LIMIT_S) -> Done:
        """One command in a process of its own; a hang is exit code 999. `before` runs in the child."""
        words = [sys.executable, "-m", "stictionid", *map(str, arguments)]
        try:
            done = subprocess.run(words, stdin=stdin, stdout=stdout, stderr=subprocess.PIPE, env=surroundings(env),
                                  preexec_fn=before, cwd=cwd or self.folder, timeout=limit_s)
        except subprocess.TimeoutExpired:
            return Done(words[3:], 999, b"", f"no end within {limit_s:g} s")
        return Done(words[3:], done.returncode, done.stdout or b"", done.stderr.decode("utf-8", "replace"))

    def start(self, *arguments: object, cwd: Path | None = None) -> subprocess.Popen[bytes]:
        """A command left running."""
        return subprocess.Popen([sys.executable, "-m", "stictionid", *map(str, arguments)], stdin=subprocess.DEVNULL,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=surroundings(None),
                                cwd=cwd or self.folder, preexec_fn=listen)


def surroundings(changes: dict[str, str | None] | None) -> dict[str, str]:
    """The environment with changes, None removing a variable."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    for name, value in (changes or {}).items():
        env.pop(name, None)
        if value is not None:
            env[name] = value
    return env


def judge(done: Done, *codes: int) -> list[str]:
    """What is wrong with a finished command that may only end in one of `codes`."""
    said = " ".join(done.arguments)[:90]
    found = []
    if done.code not in codes:
        found.append(f"{said}: exit {done.code}, not {' or '.join(map(str, codes))}: {done.err.strip()[-200:]}")
    for word in ("Traceback", "Exception ignored", "defect in the program"):
        if word in done.err:
            found.append(f"{said}: {word} on stderr: {done.err.strip()[-300:]}")
    if done.code in (2, 3) and not any(line.startswith("stictionid: ") or "undecided" in line
                                       for line in done.err.splitlines()) and not done.out:
        found.append(f"{said}: no sentence: {done.err.strip()[-200:]}")
    return found


def whole_or_absent(folder: Path) -> list[str]:
    """Studies must load, and nothing half-written may lie about."""
    found = []
    for file in folder.iterdir():
        if file.name.endswith(".part"):
            found.append(f"{file.name} was left behind")
        elif file.suffix == ".json":
            try:
                json.loads(file.read_text(encoding="utf-8"))
            except ValueError as error:
                found.append(f"{file.name} is half a file: {error}")
        elif file.suffix == ".html" and not file.read_bytes().rstrip().endswith(b"</html>"):
            found.append(f"{file.name} is half a file")
    return found
