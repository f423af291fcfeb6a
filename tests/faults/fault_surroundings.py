"""Fault injection: odd environments. Locales, time zones, hash seeds, no home, no cache, no terminal: same bytes."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from fault_bench import Bench, Result, judge

# Each changes several things at once, because all of them must change nothing.
SURROUNDINGS: dict[str, dict[str, str | None]] = {
    "C without UTF-8, Kolkata": {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0",
                                 "TZ": "Asia/Kolkata", "PYTHONHASHSEED": "0"},
    "German, New York, four threads": {"LC_ALL": "de_DE.UTF-8", "LANG": "de_DE.UTF-8", "TZ": "America/New_York",
                                       "PYTHONHASHSEED": "1", "OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "4"},
    "German Latin-1, no zone, narrow": {"LC_ALL": "de_DE.ISO-8859-1", "TZ": "Not/AZone", "PYTHONHASHSEED": "4242",
                                        "COLUMNS": "20", "TERM": "dumb"},
    "ASCII only, Apia, optimised": {"PYTHONIOENCODING": "ascii", "LC_ALL": None, "LANG": None, "TZ": "Pacific/Apia",
                                    "PYTHONOPTIMIZE": "1", "NO_COLOR": "1"},
}


def products(bench: Bench, place: Path, env: dict[str, str | None],
             jobs: int = 1) -> tuple[dict[str, bytes], list[str]]:
    """What the commands write and print in one surrounding: bytes by name, and what went wrong."""
    found = []
    site = place.with_name(f"{place.name}-site")
    shutil.rmtree(site, ignore_errors=True)
    commands = [("simulate", "--S", 4, "--J", 2, "--duration", 120, "--noise", 0.02, "--seed", 5, "-o", "x.csv"),
                ("identify", bench.csv, "-q", "--json", "-o", "s.json"), ("report", bench.study, "-q", "-o", "r.html"),
                ("report", bench.study, "-q", "-o", "r.md"), ("report", bench.study, "-q", "-o", "r.json"),
                ("range", bench.csv, "-q", "--json"), ("laws", "chen", "--json"),
                ("batch", bench.csv, "x.csv", "--level", "screen", "-q", "--jobs", jobs, "-o", site)]
    made: dict[str, bytes] = {}
    for k, arguments in enumerate(commands):
        done = bench.run(*arguments, env=env, cwd=place)
        found += judge(done, 0)
        made[f"stdout of {' '.join(map(str, arguments[:1]))} {k}"] = done.out
    for file in sorted([*place.iterdir(), *site.glob("summary.*"), *site.glob("studies/*.json")]):
        made[file.name] = file.read_bytes()
    return made, found


def same_bytes(bench: Bench, names: list[str] | None = None) -> Result:
    """Same input, seed and version: same bytes in any locale, zone, hash seed, number of threads and of processes."""
    want, found = products(bench, bench.place("same"), {})
    chosen = {n: SURROUNDINGS[n] for n in names} if names else SURROUNDINGS
    for name, env in chosen.items():
        made, wrong = products(bench, bench.place("same"), env, jobs=2)
        found += [f"{name}: {w}" for w in wrong]
        found += [f"{name}: {key} differs" for key in want if made.get(key) != want[key]]
        found += [f"{name}: {key} is extra" for key in set(made) - set(want)]
    return (1 + len(chosen)) * 8, found, ""


def homeless(bench: Bench) -> Result:
    """No home folder and nowhere to keep compiled kernels or fonts: slower, and not a word about it."""
    found = []
    place = bench.place("homeless")
    nowhere: dict[str, str | None] = {"HOME": "/nonexistent", "XDG_CACHE_HOME": "/nonexistent",
                                      "XDG_CONFIG_HOME": "/nonexistent", "NUMBA_CACHE_DIR": "/proc/nonexistent"}
    gone: dict[str, str | None] = {"HOME": None, "USER": None, "LOGNAME": None, "XDG_CACHE_HOME": None}
    commands = [("range", bench.csv, "-q"), ("report", bench.study, "-q", "-o", place / "r.html"),
                ("report", bench.study, "-q", "-o", place / "p.md", "--figures", "png"),
                ("laws", "--test", "chen", "-q", "-o", place / "b.png")]
    for env in (nowhere, gone):
        for arguments in commands:
            done = bench.run(*arguments, env=env, cwd=place)
            found += judge(done, 0)
            if done.err.strip():
                found.append(f"{arguments[0]} speaks of its troubles: {done.err.strip()[:250]}")
    return 2 * len(commands), found, ""


def no_terminal(bench: Bench) -> Result:
    """A session without a controlling terminal and without TERM."""
    found = []
    for arguments in (("identify", bench.csv), ("report", bench.study), ("range", bench.csv), ("effects",)):
        done = bench.run(*arguments, env={"TERM": None}, before=os.setsid, stdin=subprocess.DEVNULL)
        found += judge(done, 0)
        if b"\x1b" in done.out or "\x1b" in done.err:
            found.append(f"{arguments[0]} sends control sequences to no terminal")
        if done.out and max(map(len, done.out.decode().splitlines())) > 80:
            found.append(f"{arguments[0]} is wider than 80 columns")
    return 4, found, ""


FAULTS = {"same bytes in odd surroundings": same_bytes, "no home, no cache": homeless, "no terminal": no_terminal}
