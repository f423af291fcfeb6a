"""Fault injection: clock jumps, of the machine or in the data. No result may depend on when or where a file is read."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from datetime import datetime, timedelta
from pathlib import Path

from fault_bench import Bench, Done, Result, judge

# Every question for the time of day is answered years off, in turn before and after; what only runs on stays true.
_JUMPING = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <sys/time.h>
#include <time.h>
static long jump(void) {
    static const long days[] = {0, 400, -4000, 3, -3, 9000, -1};
    static unsigned asked;
    return days[__sync_fetch_and_add(&asked, 1u) % 7] * 86400L;
}
int clock_gettime(clockid_t which, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(which, now);
    if (!failed && which == CLOCK_REALTIME) now->tv_sec += jump();
    return failed;
}
int gettimeofday(struct timeval *now, void *zone) {
    struct timespec t;
    int failed = clock_gettime(CLOCK_REALTIME, &t);
    if (!failed && now) { now->tv_sec = t.tv_sec; now->tv_usec = t.tv_nsec / 1000; }
    return failed;
}
time_t time(time_t *into) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    if (into) *into = t.tv_sec;
    return t.tv_sec;
}
"""
_YEAR_S = 365 * 86400
# How far files are moved in time: 30 years back, and ahead.
_MOVED_S = (-30 * _YEAR_S, 30 * _YEAR_S)
ZONES = ("Europe/Berlin", "America/New_York", "Australia/Lord_Howe", "UTC", "Pacific/Apia")
_PRODUCTS = ("summary.csv", "summary.md", "summary.parquet")


def odd_times(bench: Bench) -> Result:
    """Files from the future and from before 1970, as after a jump of the clock."""
    found = []
    for stamp in (0, -86400, 4102444800, 32503680000):
        data = bench.place("clock") / "x.csv"
        data.write_bytes(bench.csv.read_bytes())
        os.utime(data, (stamp, stamp))
        found += judge(bench.run("range", data), 0)
    return 4, found, ""


def jumping_clock(bench: Bench) -> Path | None:
    """A library that makes the time of day jump in every program it is loaded into; None without a C compiler."""
    library, compiler = bench.folder / "jumping.so", shutil.which("cc") or shutil.which("gcc")
    if compiler and not library.exists():
        source = bench.folder / "jumping.c"
        source.write_text(_JUMPING)
        subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(source), "-ldl"], check=False,
                       capture_output=True)
    return library if library.exists() else None


def clock_jumps(bench: Bench) -> Result:
    """The time of day jumps by years within each command: the same bytes as with a clock that runs."""
    library = jumping_clock(bench)
    if library is None:
        return 0, [], "no C compiler to make a jumping clock with"
    jumping: dict[str, str | None] = {"LD_PRELOAD": str(library)}
    found, made = _seen_to_jump(bench, jumping), {}
    commands = [("simulate", "--S", 4, "--J", 2, "--duration", 120, "--seed", 5, "-o", "x.csv"),
                ("identify", bench.csv, "-q", "--json", "-o", "s.json"), ("range", bench.csv, "--json"),
                ("report", bench.study, "-q", "-o", "r.html"), ("report", bench.study, "-q", "-o", "r.md"),
                ("batch", bench.csv, "-q", "--level", "screen", "--jobs", 2, "-o", bench.folder / "jumped-site")]
    for env in (None, jumping):
        place = bench.place("jumped")
        shutil.rmtree(bench.folder / "jumped-site", ignore_errors=True)
        outs = []
        for arguments in commands:
            done = bench.run(*arguments, env=env, cwd=place)
            found += judge(done, 0)
            outs.append(done.out)
        files = [*place.iterdir(), *(bench.folder / "jumped-site").glob("s*/*.json")]
        made[env is None] = (outs, {f.name: f.read_bytes() for f in files})
    if made[True] != made[False]:
        found.append("a jumping clock changes what is written")
    return len(commands), found, ""


def _seen_to_jump(bench: Bench, env: dict[str, str | None]) -> list[str]:
    import sys

    from fault_bench import surroundings

    code = "import time; print(max(time.time() for _ in range(9)) - min(time.time() for _ in range(9)))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=surroundings(env)).stdout
    return [] if float(said) > 300 * 86400 else [f"the clock was not made to jump: {said}"]


def resume_by_content(bench: Bench) -> Result:
    """--resume after jumps of the clock: what is the same is kept whatever its time, what changed is done again
    although its size and time are what they were."""
    data, site = bench.place("resumed"), bench.folder / "resumed-site"
    shutil.rmtree(site, ignore_errors=True)
    text = bench.csv.read_bytes()
    for name in ("a.csv", "b.csv"):
        (data / name).write_bytes(text)
    words = ("batch", data, "--level", "screen", "--jobs", 1, "-o", site, "--resume", "--json")
    found = judge(bench.run(*words), 0)
    want = {name: (site / name).read_bytes() for name in _PRODUCTS}
    for moved in _MOVED_S:
        for file in [*data.iterdir(), *(f for f in site.rglob("*") if f.is_file())]:
            at = file.stat().st_mtime + moved
            os.utime(file, (at, at))
        done = bench.run(*words)
        found += judge(done, 0) + _kept(done, 2, f"files moved by {moved / _YEAR_S:g} years")
        found += [f"{name} differs after a jump" for name in _PRODUCTS if (site / name).read_bytes() != want[name]]
    before = (data / "b.csv").stat()
    changed = text[:-2] + (b"1" if text[-2:-1] != b"1" else b"2") + text[-1:]
    (data / "b.csv").write_bytes(changed)
    os.utime(data / "b.csv", ns=(before.st_atime_ns, before.st_mtime_ns))
    if (data / "b.csv").stat().st_size != before.st_size:
        found.append("the changed file should have its old size")
    done = bench.run(*words)
    return 4, found + judge(done, 0) + _kept(done, 1, "one file changed under its old size and time"), ""


def _kept(done: Done, want: int, what: str) -> list[str]:
    lines = [json.loads(line) for line in done.err.splitlines() if line.startswith("{")]
    kept = sum(line.get("kept", False) for line in lines if line.get("event") == "loop")
    return [] if kept == want else [f"{what}: {kept} of 2 loops were kept, not {want}"]


def local_exports(bench: Bench) -> dict[str, tuple[Path, tuple[str, ...]]]:
    """One record with clock stamps of Berlin: over the doubled hour, over the missing one, and in plain UTC.

    The clock goes back or ahead in the middle of it; name: file and the options it is read with.
    """
    header, *rows = bench.csv.read_text(encoding="utf-8").split("\n")
    header, rows = "timestamp," + header.partition(",")[2], [row.partition(",")[2] for row in rows if row]
    middle, made = len(rows) // 2, {}
    place = bench.place("saving")
    for name, begin, shift_h in (("autumn", datetime(2024, 10, 27, 3), -1), ("spring", datetime(2024, 3, 31, 2), 1),
                                 ("utc", datetime(2024, 3, 31, 1), 0)):
        stamps = [begin + timedelta(seconds=k - middle) + timedelta(hours=shift_h * (k >= middle))
                  for k in range(len(rows))]
        file = place / f"{name}.csv"
        mark = "Z" if name == "utc" else ""
        file.write_text("\n".join([header, *(f"{s:%Y-%m-%d %H:%M:%S}{mark},{row}" for s, row in
                                             zip(stamps, rows, strict=True))]) + "\n", encoding="utf-8")
        if name == "utc":
            made[name] = file, ()
        else:
            made[f"{name}, zone said"], made[f"{name}, no zone"] = (file, ("--zone", "Europe/Berlin")), (file, ())
    return made


def daylight_saving(bench: Bench, zones: tuple[str, ...] = ZONES) -> Result:
    """Exports in local time over both changes of the clock: the same study bytes wherever they are read, and with the
    zone said the same answer as in UTC."""
    found, trials = [], 0
    answers: dict[str, list[object]] = {}
    for name, (file, options) in local_exports(bench).items():
        seen = set()
        for zone in zones:
            done = bench.run("identify", file, *options, "-q", "--json", env={"TZ": zone})
            trials += 1
            # An hour that is not there leaves two halves, which may be too short to tell anything.
            found += judge(done, *((0, 3) if name == "spring, no zone" else (0,)))
            seen.add(done.out)
        if len(seen) != 1:
            found.append(f"{name}: {len(seen)} different studies in {len(zones)} time zones")
        study = json.loads(done.out)
        estimate = study["estimate"] or {}
        answers[name] = [study["data"]["rows_used"], estimate.get("S"), estimate.get("J"),
                         study["verdict"]["stiction"], study["data"]["step_s"]]
        if ", no zone" in name:
            # Twice the same hour can be told without a zone; an hour that is not there may as well be a gap.
            codes = {finding["code"] for finding in study["data"]["findings"]}
            if not codes & {"clock-fold", "gaps"}:
                found.append(f"{name}: nothing is said of the change of the clock, only {sorted(codes)}")
    found += [f"{name}: {answers[name]} and in UTC {answers['utc']}" for name in answers
              if "zone said" in name and answers[name] != answers["utc"]]
    return trials, found, ""


FAULTS = {"files with odd times": odd_times, "clock jumps while it runs": clock_jumps,
          "clock jumps between batch and --resume": resume_by_content,
          "daylight saving, exports in local time": daylight_saving}
