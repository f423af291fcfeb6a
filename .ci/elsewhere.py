"""Runs the tests of .ci/elsewhere.txt with the oldest allowed dependencies, and with the newest on other Pythons.

The oldest are tested as on another processor, too (.ci/processor.py): one set of kernels is compiled for both.
The tests, and with them the console blocks of README.md, run the wheel and not the folder. The wheel is built from the
source distribution.
Run: python .ci/elsewhere.py [--every] [--only WORD]
Of the other Pythons the newest is taken, where there are more than two cores; --every takes all (each is about three
minutes of one core).
Each gets a virtual environment of its own in a temporary folder. An environment is left out, with the reason in one
line, only where a Python is not here or a dependency has no wheels for it; anything else that goes wrong is a failure,
and the exit code is 1. Only Python's own library is used here.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
OLDEST = HERE / "oldest.txt"
# Minor versions of Python 3 looked for beyond the one that runs this.
_AHEAD = 8
_LIMIT_S = 1800
# Environments made and tested side by side; each works on one core.
_SIDE_BY_SIDE = 2
# Cores beside which another Python is tested only on request.
_FEW_CORES = 2
# Files and folders that a clean checkout does not have.
_NOT_SOURCE = (".git", ".venv*", "__pycache__", ".*_cache", ".hypothesis", "*.egg-info", "build", "dist", "site")


@dataclass(frozen=True)
class Place:
    """One environment: what it is called, its Python, and the file that pins its dependencies, if any."""

    name: str
    python: str
    pins: Path | None


class Failed(Exception):
    """What went wrong, with the log to show."""


class NoWheels(Exception):
    """Which requirements have no wheel for this Python."""


def required() -> list[str]:
    """The package's requirements."""
    return list(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"])


def lines_of(path: Path) -> list[str]:
    """The lines of a list without comments."""
    return [line.strip() for line in path.read_text(encoding="utf-8").splitlines()
            if line.strip() and not line.startswith("#")]


def version_of(python: str) -> tuple[int, int] | None:
    """Version of a Python that can make environments, or None; a pyenv shim of an unchosen version can't even run."""
    code = "import sys, venv, ensurepip; print(sys.version_info[0], sys.version_info[1])"
    try:
        done = subprocess.run([python, "-c", code], capture_output=True, text=True, timeout=60)
        major, minor = map(int, done.stdout.split())
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return None
    return None if done.returncode else (major, minor)


def pythons() -> dict[tuple[int, int], str]:
    """Every Python here that the package says it runs on, by version; that of this run is among them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    least = int(project["requires-python"].removeprefix(">=3."))
    found = {(sys.version_info[0], sys.version_info[1]): sys.executable}
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv") / "versions"
    for minor in range(least, sys.version_info[1] + _AHEAD):
        name = f"python3.{minor}"
        for python in (shutil.which(name), *map(str, sorted(pyenv.glob(f"3.{minor}.*/bin/{name}"), reverse=True))):
            if python and (3, minor) not in found and version_of(python) == (3, minor):
                found[3, minor] = python
    return dict(sorted(found.items()))


def places(found: dict[tuple[int, int], str], every: bool) -> list[Place]:
    """Oldest dependencies on the oldest Python here, newest ones on the newest other than this run's, or on all.

    Two cores have no time for the newest ones beside the whole suite.
    """
    (major, minor), oldest = next(iter(found.items()))
    made = [Place(f"oldest dependencies, Python {major}.{minor}, another processor", oldest, OLDEST)]
    others = [Place(f"newest dependencies, Python {major}.{minor}", python, None)
              for (major, minor), python in found.items() if (major, minor) != sys.version_info[:2]]
    return made + (others if every else others[-1:] if (os.cpu_count() or 1) > _FEW_CORES else [])


def run(words: list[str], folder: Path) -> tuple[int, str]:
    """Exit code and what was said of one command, free of what this run's own environment set up."""
    drop = ("PYTHONPATH", "VIRTUAL_ENV", "PIP_CONSTRAINT", "PYTHONDONTWRITEBYTECODE")
    env = {k: v for k, v in os.environ.items() if k not in drop} | {
        "NUMBA_CACHE_DIR": str(folder / "kernels"), "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_INPUT": "1",
        # The folder that a Python starts in is not searched: the tests import what is installed.
        "PYTHONSAFEPATH": "1"}
    try:
        done = subprocess.run(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              text=True, errors="replace", cwd=ROOT, env=env, timeout=_LIMIT_S)
    except subprocess.TimeoutExpired as late:
        said = late.stdout or b""
        return 1, (said.decode("utf-8", "replace") if isinstance(said, bytes) else said) + \
            f"\nno end within {_LIMIT_S} s: {' '.join(words)}\n"
    return done.returncode, done.stdout


def without_wheels(pip: list[str], pins: Path | None, folder: Path) -> list[str]:
    """The requirements of which the index has no wheel for this Python; none where it can't be asked at all.

    Asked one by one, because a resolver that fails does not say which of its reasons was the first.
    """
    wanted = lines_of(pins) if pins else required()
    asked = [*pip, "install", "--dry-run", "--ignore-installed", "--no-deps", "--only-binary", ":all:"]
    absent = []
    for requirement in wanted:
        code, said = run([*asked, requirement], folder)
        if code and "No matching distribution found" in said and not re.search("Retrying|connection|HTTP error", said):
            absent.append(requirement)
        elif code:
            return []
    # Where there is nothing at all it is the index that is out of reach.
    return absent if len(absent) < len(wanted) else []


def built(folder: Path, install: list[str]) -> Path:
    """The wheel, from the source distribution of a copy: .ci/run builds in the folder itself meanwhile. Failed."""
    shutil.copytree(ROOT, folder / "source", ignore=shutil.ignore_patterns(*_NOT_SOURCE))
    for words in ([*install, "build", "setuptools>=77"],
                  [install[0], "-m", "build", "--no-isolation", "--outdir", str(folder), str(folder / "source")]):
        code, said = run(words, folder)
        if code:
            raise Failed(said)
    return next(folder.glob("*.whl"))


def tested(place: Place, folder: Path) -> str:
    """The closing line of the tests in a new environment with the wheel. Failed, or NoWheels."""
    code, said = run([place.python, "-m", "venv", str(folder / "env")], folder)
    if code:
        raise Failed(said)
    pip = [str(folder / "env" / "bin" / "python"), "-m", "pip"]
    pins = ["-c", str(place.pins)] if place.pins else []
    install = [*pip, "install", "-q", "--no-compile", "--only-binary", ":all:"]
    wheel = built(folder, install)
    code, said = run([*install, *pins, f"{wheel}[test]"], folder)
    if code:
        absent = without_wheels(pip, place.pins, folder)
        raise NoWheels(", ".join(absent)) if absent else Failed(said)
    tests = [str(HERE / "processor.py")] if place.pins else ["-m", "pytest", "-p", "no:cacheprovider"]
    code, said = run([str(folder / "env" / "bin" / "python"), *tests, "-n", "1", *lines_of(HERE / "elsewhere.txt")],
                     folder)
    closing = [line for line in said.splitlines() if re.search(r"\d+ (passed|failed|error)", line)]
    if code or not closing:
        raise Failed(said)
    return closing[-1].strip("= ")


def report(place: Place, top: Path) -> bool:
    """Test one environment and say in a line how it went, the log before it where it failed; whether it did not."""
    folder = Path(tempfile.mkdtemp(dir=top))
    begun = time.monotonic()
    try:
        line, good = tested(place, folder), True
    except NoWheels as reason:
        line, good = f"left out, no wheels of {reason}", True
    except Failed as failure:
        line, good = f"FAILED\n{str(failure)[-20_000:]}", False
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(f"+ {place.name}: {line} ({time.monotonic() - begun:.0f} s with its making)", flush=True)
    return good


def main() -> int:
    """Test every environment, exit 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="environments whose name holds this word")
    parser.add_argument("--every", action="store_true", help="every other Python here, not only the newest")
    chosen = parser.parse_args()
    found = pythons()
    if len(found) > 1 and not chosen.every and (os.cpu_count() or 1) <= _FEW_CORES:
        print("+ two cores: other Pythons are left out; python .ci/elsewhere.py --every tests them")
    if max(found) == sys.version_info[:2]:
        print("+ no newer Python than this run's is here: only the oldest dependencies are tested elsewhere")
    with tempfile.TemporaryDirectory(prefix="elsewhere-") as top:
        wanted = [place for place in places(found, chosen.every) if chosen.only in place.name]
        with ThreadPoolExecutor(min(_SIDE_BY_SIDE, os.cpu_count() or 1)) as lanes:
            good = list(lanes.map(lambda place: report(place, Path(top)), wanted))
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
