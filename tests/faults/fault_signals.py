"""Fault injection: interruptions. Ctrl-C, SIGTERM and SIGKILL at random times, readers that close the pipe."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

from fault_bench import LIMIT_S, Bench, Done, Result, judge, surroundings, whole_or_absent


def begun(pid: int) -> None:
    """Wait until the program runs: before it catches SIGTERM, Python itself is still starting."""
    for _ in range(400):
        try:
            caught = Path(f"/proc/{pid}/status").read_text().partition("SigCgt:")[2].split()[0]
        except (OSError, IndexError):
            return
        if int(caught, 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.01)


def _kill(bench: Bench, which: signal.Signals, codes: tuple[int, ...], trials: int) -> Result:
    found = []
    commands = [("identify", bench.csv, "-q", "-o", "s.json"), ("report", bench.study, "-o", "r.html"),
                ("report", bench.study, "-o", "r.md", "--figures", "png"),
                ("identify", bench.csv, "-q", "-o", "old.json")]
    for k in range(trials):
        place = bench.place("killed")
        (place / "old.json").write_bytes(bench.study_bytes)
        arguments = commands[k % len(commands)]
        running = bench.start(*arguments, cwd=place)
        begun(running.pid)
        time.sleep(bench.random.uniform(0.0, 4.0))
        running.send_signal(which)
        try:
            out, err = running.communicate(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            running.kill()
            found.append(f"{which.name} did not end {arguments[0]}")
            continue
        done = Done([str(a) for a in arguments], running.returncode, out, err.decode("utf-8", "replace"))
        found += judge(done, 0, *codes)
        left = whole_or_absent(place)
        # Nothing can tidy up after SIGKILL; a temporary file may stay, a study may not be half.
        found += [p for p in left if which != signal.SIGKILL or not p.endswith("left behind")]
    return trials, found, ""


def interrupt(bench: Bench, trials: int = 12) -> Result:
    # A shell shows the death by a signal as 128 + its number: after main() has ended, Python's own end is cut short.
    return _kill(bench, signal.SIGINT, (130, -signal.SIGINT), trials)


def terminate(bench: Bench, trials: int = 12) -> Result:
    return _kill(bench, signal.SIGTERM, (143, -signal.SIGTERM), trials)


def kill(bench: Bench, trials: int = 8) -> Result:
    return _kill(bench, signal.SIGKILL, (-signal.SIGKILL,), trials)


def closed_pipe(bench: Bench) -> Result:
    """`command | head -c 1`: the reader leaves, which is no error."""
    found = []
    commands = [("range", bench.csv, "--json"), ("identify", bench.csv, "--json"), ("report", bench.study),
                ("report", bench.study, "--json"), ("laws",), ("laws", "--test", "chen", "--json", "--series"),
                ("effects",), ("--help",)]
    for arguments in commands:
        running = subprocess.Popen([sys.executable, "-m", "stictionid", *map(str, arguments)], cwd=bench.folder,
                                   stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                   env=surroundings(None))
        assert running.stdout and running.stderr
        running.stdout.read(1)
        running.stdout.close()
        err = running.stderr.read().decode("utf-8", "replace")
        running.stderr.close()
        found += judge(Done([str(a) for a in arguments], running.wait(LIMIT_S), b"", err), 0)
    return len(commands), found, ""


def closed_streams(bench: Bench) -> Result:
    """Started with stdin, stdout or stderr closed, as some schedulers do."""
    found = []
    trials = 0
    for closed in (">&-", "2>&-", "<&-", ">&- 2>&- <&-"):
        for arguments in (f"range {bench.csv}", f"identify {bench.csv} -q -o closed.json", f"report {bench.study}"):
            words = f"exec {sys.executable} -m stictionid {arguments} {closed}"
            done = subprocess.run(["sh", "-c", words], capture_output=True, cwd=bench.folder, timeout=LIMIT_S,
                                  env=surroundings(None))
            found += judge(Done([words[len("exec "):]], done.returncode, done.stdout,
                                done.stderr.decode("utf-8", "replace")), 0)
            trials += 1
    found += whole_or_absent(bench.folder)
    return trials, found, ""


FAULTS = {"SIGINT at random times": interrupt, "SIGTERM at random times": terminate, "kill -9 at random times": kill,
          "reader closes the pipe": closed_pipe, "closed standard streams": closed_streams}
