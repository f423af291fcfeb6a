"""Kills of batches and their workers at random times, and checks of the output folder after each.

Run: python tests/faults/kills.py [--kills 500] [--minutes 60] [--seed 0] [--record [FILE]]

A batch over small loops is started with --resume. At random times a worker, the parent, or all of them at once get
SIGKILL, until a run completes. One last --resume then repeats the loops that a killed worker left as failed. After each
kill every study on disk is whole, and no process is left. At the end of each round the summaries and all studies are,
byte for byte, those of an undisturbed batch. Exit 1 when anything was lost.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(1, str(Path(__file__).parents[1]))

import hard_results
from batch_files import records, write_csv
from fault_bench import LIMIT_S, surroundings

LOOPS, ROWS = 12, 400
SUMMARIES = ("summary.csv", "summary.parquet", "summary.md", "summary.html")
# Longest wait before the next kill, as a share of an undisturbed run: more, and most runs would come through first.
_MOST_OF_A_RUN = 0.4
# After the parent's death the workers notice within this time. Unit: s.
_ORPHANS_S = 30.0


@dataclass
class Tally:
    """What was done and what came of it."""

    parents: int = 0
    workers: int = 0
    everybody: int = 0
    rounds: int = 0
    problems: list[str] = field(default_factory=list)

    @property
    def kills(self) -> int:
        """Kills that met a living process."""
        return self.parents + self.workers + self.everybody


class Plant:
    """A folder of small loops, and the batch over them that nobody disturbed."""

    def __init__(self, folder: Path, loops: int = LOOPS, level: str = "screen") -> None:
        self.data, self.level = folder / "data", level
        self.data.mkdir()
        for name, loop in records(loops, ROWS).items():
            write_csv(self.data / f"{name}.csv", loop, f"{name}.")
        for name in ("first", "undisturbed"):  # the first may be compiling
            begun = time.monotonic()
            if self.start(folder / name, jobs=2).wait(5 * LIMIT_S) != 0:
                raise RuntimeError("the undisturbed batch failed")
            self.seconds = time.monotonic() - begun
        self.want = products(folder / "undisturbed")

    def start(self, out: Path, *, jobs: int) -> subprocess.Popen[bytes]:
        """The batch, in a session of its own so that its processes can be told from all others."""
        words = [sys.executable, "-m", "stictionid", "batch", str(self.data), "-o", str(out), "--resume", "-q",
                 "--level", self.level, "--jobs", str(jobs)]
        return subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                                env=surroundings(None), start_new_session=True)


def products(out: Path) -> dict[str, bytes]:
    """Summaries and studies by name: all that counts in an output folder."""
    files = [out / name for name in SUMMARIES] + sorted((out / "studies").glob("*.json"))
    return {f.name: f.read_bytes() for f in files if f.exists()}


def living(session: int) -> list[int]:
    """Processes of a session that have not ended."""
    found = []
    for place in Path("/proc").iterdir():
        if place.name.isdigit():
            try:
                state, _, _, its = (place / "stat").read_text().rpartition(")")[2].split()[:4]
            except (OSError, ValueError):
                continue
            if int(its) == session and state not in "ZX":
                found.append(int(place.name))
    return found


def kill_once(run: subprocess.Popen[bytes], rng: random.Random, tally: Tally) -> str:
    """SIGKILL for the parent, one worker, or all at once; which of them, or "" when nobody was left."""
    workers = [p for p in living(run.pid) if p != run.pid and _is_worker(p)]
    what = rng.choice(("parent", "parent", "worker", "worker", "worker", "all"))
    try:
        if what == "worker":
            if not workers:
                return ""
            os.kill(rng.choice(workers), signal.SIGKILL)
            tally.workers += 1
        elif run.poll() is not None:
            return ""
        elif what == "parent":
            os.kill(run.pid, signal.SIGKILL)
            tally.parents += 1
        else:
            os.killpg(run.pid, signal.SIGKILL)
            tally.everybody += 1
    except ProcessLookupError:
        return ""
    return what


def _is_worker(pid: int) -> bool:
    try:
        return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def halves(out: Path) -> list[str]:
    """Studies and failure records that are no JSON."""
    found = []
    for file in [*out.glob("studies/*.json"), *out.glob("failures/*.json"), *out.glob("batch.json")]:
        try:
            json.loads(file.read_text(encoding="utf-8"))
        except (ValueError, OSError) as error:
            found.append(f"{file.name} is half a file: {error}")
    return found


def round_of(plant: Plant, out: Path, rng: random.Random, tally: Tally, kills: int) -> None:
    """Kill and resume until a batch comes through or the kills are used up, then resume undisturbed and compare."""
    shutil.rmtree(out, ignore_errors=True)
    through = False
    while not through and tally.kills < kills:
        run = plant.start(out, jobs=rng.choice((1, 2)))
        while run.poll() is None and tally.kills < kills:
            try:
                run.wait(rng.uniform(0.0, _MOST_OF_A_RUN * plant.seconds))
            except subprocess.TimeoutExpired:
                if kill_once(run, rng, tally) in ("parent", "all"):
                    break
        try:
            through = run.wait(LIMIT_S) == 0
        except subprocess.TimeoutExpired:
            tally.problems.append("a batch hung after a worker was killed")
        _look(run, out, tally)
    if plant.start(out, jobs=2).wait(LIMIT_S) != 0:
        tally.problems.append("the last --resume did not come through")
    made = products(out)
    tally.problems += [f"{name} is not what it would have been" for name in plant.want
                       if made.get(name) != plant.want[name]]
    tally.problems += [f"{name} is extra" for name in set(made) - set(plant.want)]
    left = [p.name for p in out.rglob("*.part")]
    if left:
        tally.problems.append(f"left behind: {left[:3]}")
    tally.rounds += 1


def _look(run: subprocess.Popen[bytes], out: Path, tally: Tally) -> None:
    end = time.monotonic() + _ORPHANS_S
    while (alive := living(run.pid)) and time.monotonic() < end:
        time.sleep(0.05)
    if alive:
        tally.problems.append(f"{len(alive)} processes outlived their batch")
        for pid in alive:
            os.kill(pid, signal.SIGKILL)
    tally.problems += halves(out)


def torment(folder: Path, kills: int, minutes: float, seed: int, *, loops: int = LOOPS, tell: bool = False) -> Tally:
    """Rounds until so many kills have met a process, or the time is used up."""
    plant, rng, tally = Plant(folder, loops), random.Random(seed), Tally()
    end = time.monotonic() + 60 * minutes
    while tally.kills < kills and time.monotonic() < end:
        round_of(plant, folder / "out", rng, tally, kills)
        if tell:
            print(f"{tally.kills} kills in {tally.rounds} rounds, {len(tally.problems)} failures", flush=True)
    return tally


def main() -> int:
    """Kill, print, record."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--kills", type=int, default=500)
    arguments.add_argument("--minutes", type=float, default=60.0)
    arguments.add_argument("--seed", type=int, default=0)
    hard_results.add_record_option(arguments)
    chosen = arguments.parse_args()
    fingerprint, begun = hard_results.code(), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        tally = torment(Path(folder), chosen.kills, chosen.minutes, chosen.seed, tell=True)
    print(f"kills: {tally.kills} ({tally.parents} of parents, {tally.workers} of workers, {tally.everybody} of all at "
          f"once), {tally.rounds} batches brought to their end, {len(tally.problems)} failures")
    for problem in sorted(set(tally.problems)):
        print(f"    {problem}")
    if chosen.record:
        hard_results.add("kills", fingerprint, {
            "seed": chosen.seed, "seconds": round(time.monotonic() - begun), "parents": tally.parents,
            "workers": tally.workers, "all": tally.everybody, "rounds": tally.rounds,
            "problems": sorted(set(tally.problems)), "failures": len(tally.problems)}, chosen.record)
    return int(bool(tally.problems))


if __name__ == "__main__":
    sys.exit(main())
