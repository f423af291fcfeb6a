"""A small sample of tests/faults: the same faults, injected for real, a few trials each.

Devices, interruptions, a full stdout and names that are no Unicode are in benchmarks/long.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import commands
import pytest

FAULTS = Path(__file__).parent / "faults"
sys.path.insert(0, str(FAULTS))

pytestmark = pytest.mark.skipif(os.name != "posix", reason="faults are made with POSIX calls")
if os.name == "posix":
    import fault_clock
    import fault_files
    import fault_signals
    import fault_surroundings
    from fault_bench import Bench, judge, whole_or_absent


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    class MadeHere(Bench):
        """A bench whose files are made in this process."""

        def must(self, *arguments: object) -> None:
            done = commands.run(*arguments, cwd=self.folder)
            assert done.returncode == 0, done.stderr

    return MadeHere(tmp_path_factory.mktemp("bench"), seed=1)


def test_a_disk_that_fills_up_leaves_nothing_behind(bench: Bench) -> None:
    import resource

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1500, 1500))

    place = bench.place("limited")
    for arguments in (("simulate", "-o", place / "x.csv"), ("report", bench.study, "-o", place / "r.md")):
        done = bench.run(*arguments, before=limit)
        assert not judge(done, 2) and "no room left" in done.err
    assert not list(place.iterdir())


def test_permissions_are_refused_in_a_sentence(bench: Bench) -> None:
    if not fault_files.permissions_count(bench):
        pytest.skip("this user passes over permissions")
    place = bench.place("forbidden")
    place.chmod(0o555)
    secret = bench.folder / "secret.csv"
    secret.write_bytes(bench.csv.read_bytes())
    secret.chmod(0)
    for arguments in (("range", secret), ("report", bench.study, "-o", place / "r.html")):
        assert not judge(bench.run(*arguments, before=fault_files.common), 2)
    place.chmod(0o755)


@pytest.mark.parametrize(("which", "trials"), [("kill", 1)])
def test_interrupted_at_random_times_studies_are_whole_or_absent(bench: Bench, which: str, trials: int) -> None:
    _, problems, _ = getattr(fault_signals, which)(bench, trials=trials)
    assert not problems


def test_an_interruption_while_libraries_load_is_quiet(bench: Bench) -> None:
    for delay in (0.05, 0.15):
        running = bench.start("identify", bench.csv, "-q", "-o", "early.json")
        fault_signals.begun(running.pid)
        fault_signals.time.sleep(delay)
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=commands.HANGS_S)
        assert running.returncode == 130 and b"Traceback" not in err, err
    assert not whole_or_absent(bench.folder)


def test_a_reader_that_leaves_is_no_error_for_tables_either(bench: Bench) -> None:
    command = f"{sys.executable} -m stictionid laws | head -c 1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=bench.folder,
                          timeout=commands.HANGS_S)
    assert done.returncode == 0 and not done.stderr


@pytest.mark.parametrize("closed", [">&-", ">&- 2>&- <&-"])
def test_closed_streams_are_no_defect(bench: Bench, closed: str) -> None:
    done = subprocess.run(["sh", "-c", f"exec {sys.executable} -m stictionid range {bench.csv} -q {closed}"],
                          capture_output=True, cwd=bench.folder, timeout=commands.HANGS_S)
    assert done.returncode == 0 and b"Traceback" not in done.stderr


def test_odd_surroundings_change_no_byte(bench: Bench) -> None:
    odd = fault_surroundings.SURROUNDINGS["C without UTF-8, Kolkata"]
    here, there = (bench.run("report", bench.study, "-q", "--json", env=env) for env in (None, odd))
    assert here.code == there.code == 0 and here.out == there.out


def test_where_a_local_export_is_read_changes_no_sample(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    from stictionid.historian import ReadOptions, read_loop

    seen: dict[str, set[bytes]] = {}
    for zone in ("Europe/Berlin", "Australia/Lord_Howe"):
        monkeypatch.setenv("TZ", zone)
        time.tzset()
        for name, (file, options) in fault_clock.local_exports(bench).items():
            loop = read_loop(file, options=ReadOptions(zone=options[1] if options else None))
            held = (loop.process_value.tobytes(), loop.output.tobytes(), loop.starts, loop.origin.start, loop.step_s)
            seen.setdefault(name, set()).add(repr(held).encode())
    monkeypatch.undo()
    time.tzset()
    assert len(seen) == 5 and all(len(held) == 1 for held in seen.values())
