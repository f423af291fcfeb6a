"""Fault injection: disks and files that fail. Full, too small, read-only, forbidden, changing while they are read."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fault_bench import Bench, Result, judge, whole_or_absent


def writers(bench: Bench, place: Path) -> list[tuple[object, ...]]:
    """Every command that writes a file, aimed at a folder."""
    return [("identify", bench.csv, "-o", place / "s.json"), ("simulate", "-o", place / "x.csv"),
            ("simulate", "-o", place / "x.parquet"), ("report", bench.study, "-o", place / "r.html"),
            ("report", bench.study, "-o", place / "r.md"), ("report", bench.study, "-o", place / "r.json"),
            ("read", bench.csv, "-o", place / "c.csv"), ("read", bench.csv, "-o", place / "c.parquet"),
            ("laws", "--test", "chen", "-o", place / "b.svg")]


def printers(bench: Bench) -> list[tuple[object, ...]]:
    """Every command that prints a result."""
    return [("range", bench.csv), ("range", bench.csv, "--json"), ("read", bench.csv, "--json"),
            ("identify", bench.csv, "--json"), ("report", bench.study), ("report", bench.study, "--json"),
            ("laws",), ("laws", "--test", "chen", "--json"), ("effects",), ("--help",), ("--version",)]


def full_stdout(bench: Bench) -> Result:
    if not Path("/dev/full").exists():
        return 0, [], "no /dev/full"
    found = []
    for arguments in printers(bench):
        with open("/dev/full", "wb") as full:
            found += judge(bench.run(*arguments, stdout=full), 2)
    return len(printers(bench)), found, ""


def device_as_output(bench: Bench) -> Result:
    """A device given as -o is written to, never replaced by a file."""
    found, trials = [], 0
    for device, code in (("/dev/null", 0), ("/dev/full", 2)):
        if Path(device).exists():
            kind = Path(device).stat().st_rdev
            found += judge(bench.run("identify", bench.csv, "--base-only", "-q", "-o", device), code)
            trials += 1
            if not Path(device).is_char_device() or Path(device).stat().st_rdev != kind:
                found.append(f"{device} was replaced")
    return trials, found, ""


def file_size_limit(bench: Bench) -> Result:
    """No file may grow beyond 1,500 bytes: every write that needs more fails in the middle."""
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1500, 1500))

    found = []
    place = bench.place("limited")
    for arguments in writers(bench, place):
        found += judge(bench.run(*arguments, before=limit), 2)
        found += whole_or_absent(place)
    left = [f.name for f in place.iterdir() if f.suffix in (".csv", ".parquet", ".html", ".md")]
    return len(writers(bench, place)), found + [f"{name} was written all the same" for name in left], ""


@contextmanager
def mounted(place: Path, options: str) -> Iterator[str]:
    """A tmpfs at `place`; yields why there is none, or nothing."""
    place.mkdir(exist_ok=True)
    if os.geteuid() != 0 or shutil.which("mount") is None:
        yield "only root can mount a small file system"
        return
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)], capture_output=True, text=True)
    if made.returncode:
        yield f"no tmpfs here: {made.stderr.strip()[:80]}"
        return
    try:
        yield ""
    finally:
        subprocess.run(["umount", str(place)], capture_output=True)


def small_disk(bench: Bench) -> Result:
    found: list[str] = []
    place = bench.folder / "small"
    with mounted(place, "size=8k") as why:
        if why:
            return 0, [], why
        for arguments in writers(bench, place):
            done = bench.run(*arguments)
            found += judge(done, 0, 2) + whole_or_absent(place)
            for file in place.iterdir():
                file.unlink()
    return len(writers(bench, place)), found, ""


def read_only_disk(bench: Bench) -> Result:
    found: list[str] = []
    place = bench.folder / "frozen"
    with mounted(place, "size=1m,ro") as why:
        if why:
            return 0, [], why
        for arguments in writers(bench, place):
            found += judge(bench.run(*arguments), 2)
    return len(writers(bench, place)), found, ""


def common() -> None:
    """In a child of root: give up the right to pass over permissions, so that they count as for anybody else."""
    import ctypes

    for right in (1, 2):  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
        ctypes.CDLL(None).prctl(24, right, 0, 0, 0)  # PR_CAPBSET_DROP


def permissions_count(bench: Bench) -> bool:
    """Whether a child can be denied a file here."""
    probe = bench.folder / "probe"
    probe.write_text("x")
    probe.chmod(0)
    denied = subprocess.run(["cat", str(probe)], preexec_fn=common, capture_output=True).returncode
    probe.unlink()
    return bool(denied)


def forbidden(bench: Bench) -> Result:
    """A folder that can't be written, a file and a study that can't be read."""
    if not permissions_count(bench):
        return 0, [], "this user passes over permissions and can't give that up"
    place = bench.place("forbidden")
    secret = bench.folder / "secret.csv"
    secret.write_bytes(bench.csv.read_bytes())
    study = bench.folder / "secret.json"
    study.write_bytes(bench.study_bytes)
    for file, mode in ((secret, 0o000), (study, 0o000), (place, 0o555)):
        file.chmod(mode)
    found = []
    commands = [*writers(bench, place), ("range", secret), ("identify", secret), ("read", secret),
                ("report", study), ("diagnose", study), ("read", bench.csv, "--profile", secret)]
    try:
        for arguments in commands:
            found += judge(bench.run(*arguments, before=common), 2)
        found += [f"{f.name} appeared in a folder that can't be written" for f in place.iterdir()]
    finally:
        for file, mode in ((secret, 0o644), (study, 0o644), (place, 0o755)):
            file.chmod(mode)
    return len(commands), found, ""


def changed_while_read(bench: Bench, trials: int = 8) -> Result:
    """The export shrinks or grows at a random time during the reading: an answer or a sentence, no crash."""
    found = []
    place = bench.place("changing")
    text = bench.csv.read_bytes()
    head, _, body = text.partition(b"\n")
    for k in range(trials):
        data = place / ("x.csv" if k % 2 == 0 else "x.parquet")
        data.write_bytes(head + b"\n" + body * 300 if k % 2 == 0 else bench.parquet.read_bytes())
        running = bench.start("read", data, "--json")
        time.sleep(bench.random.uniform(0.1, 2.5))
        if k % 4 < 2:
            os.truncate(data, data.stat().st_size // bench.random.randint(2, 50))
        else:
            with open(data, "ab") as file:
                file.write(b"1,2,3\n\x00" * 50)
        found += _finished(running, 0, 2, 3)
        data.unlink()
    return trials, found, ""


def folder_taken_away(bench: Bench, trials: int = 3) -> Result:
    """The output folder vanishes while the work is done."""
    found = []
    for _ in range(trials):
        place = bench.place("vanishing")
        running = bench.start("identify", bench.csv, "-q", "-o", place / "s.json")
        time.sleep(bench.random.uniform(0.5, 1.5))
        shutil.rmtree(place, ignore_errors=True)
        found += _finished(running, 0, 2)
    return trials, found, ""


def cut_studies(bench: Bench, trials: int = 12) -> Result:
    """A study cut short anywhere is refused in a sentence, and so is one with a changed record."""
    found = []
    place = bench.place("cut")
    for _ in range(trials):
        (place / "s.json").write_bytes(bench.study_bytes[:bench.random.randrange(len(bench.study_bytes) - 2)])
        found += judge(bench.run("report", place / "s.json"), 3)
    (place / "s.json").write_bytes(bench.study_bytes)
    (place / "loop.csv").write_bytes(bench.csv.read_bytes() + b"\n")
    found += judge(bench.run("report", "s.json", "--data", "loop.csv", cwd=place), 3)
    return trials + 1, found, ""


def _finished(running: subprocess.Popen[bytes], *codes: int) -> list[str]:
    from fault_bench import LIMIT_S, Done

    try:
        out, err = running.communicate(timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        running.kill()
        return ["a command hung"]
    return judge(Done([str(a) for a in running.args[3:]], running.returncode, out, err.decode("utf-8", "replace")),
                 *codes)


FAULTS = {"stdout full": full_stdout, "device as -o": device_as_output, "file size limit": file_size_limit,
          "disk of 8 kB": small_disk, "read-only disk": read_only_disk, "permission denied": forbidden,
          "file changed while read": changed_while_read, "output folder vanishes": folder_taken_away,
          "study cut short": cut_studies}
