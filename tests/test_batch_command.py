"""`stictionid batch` through real processes: output, exit codes, and a kill in the middle."""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from batch_files import Inline, records, write_csv
from commands import HANGS_S

sys.path.insert(0, str(Path(__file__).parent / "faults"))

from fault_bench import listen

ME = [sys.executable, "-m", "stictionid", "batch"]
WHAT = ["--level", "screen"]
RESULTS = ("summary.csv", "summary.parquet", "summary.md", "summary.html")
LOOPS = 6
linux = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for children in /proc")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    for name, loop in records(LOOPS).items():
        write_csv(folder / f"{name}.csv", loop)
    return folder


def batch(*arguments: object, **more) -> subprocess.CompletedProcess:
    return subprocess.run([*ME, *map(str, arguments)], capture_output=True, text=True, timeout=HANGS_S, **more)


def start(site, out, *arguments: str) -> subprocess.Popen:
    return subprocess.Popen([*ME, str(site), "-o", str(out), *WHAT, "--json", *arguments], stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True, start_new_session=True,
                            preexec_fn=listen)


def results(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*"))
            if p.is_file() and p.name != "timing.csv"}


def first_loops(process: subprocess.Popen, count: int) -> list[dict]:
    """The first progress lines of a running batch."""
    lines: list[dict] = []
    while len(lines) < count:
        line = process.stderr.readline()
        assert line, "the batch ended too early"
        if line.startswith("{"):
            lines.append(json.loads(line))
    return lines


def children(pid: int) -> list[int]:
    return [int(c) for task in Path(f"/proc/{pid}/task").iterdir() for c in (task / "children").read_text().split()]


def gone(pids: list[int], within_s: float = HANGS_S) -> bool:
    until = time.monotonic() + within_s
    while time.monotonic() < until:
        if not any(_alive(p) for p in pids):
            return True
        time.sleep(0.1)
    return False


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture(scope="module")
def clean(site, tmp_path_factory):
    out = tmp_path_factory.mktemp("clean") / "out"
    done = batch(site, "-o", out, *WHAT, "--jobs", 1, "--json")
    assert done.returncode == 0, done.stderr
    return done, results(out)


def test_json_alone_on_stdout_and_progress_a_line_each(clean) -> None:
    done, made = clean
    told = json.loads(done.stdout)
    assert (told["schema"], told["loops"], told["failed"], len(told["rows"])) == ("stictionid.batch/1", LOOPS, 0, LOOPS)
    lines = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]
    assert [line["done"] for line in lines] == list(range(1, LOOPS + 1))
    assert {line["loop"] for line in lines} == {row["loop"] for row in told["rows"]}
    assert lines[-1]["left_s"] == 0 and all(line["total"] == LOOPS for line in lines)
    assert set(RESULTS) < set(made)


@linux
def test_kill_9_loses_only_loops_in_flight_and_resume_makes_it_whole(site, clean, tmp_path, monkeypatch,
                                                                     capsys) -> None:
    process = start(site, tmp_path / "out", "--jobs", "1")
    seen = first_loops(process, 2)
    # A worker that is killed does not stop the batch.
    os.kill(int(seen[-1]["worker"].rpartition(":")[2]), signal.SIGKILL)
    seen += first_loops(process, 2)
    workers = children(process.pid)
    process.kill()
    process.wait()
    process.stdout.close(), process.stderr.close()
    assert gone(workers), "workers outlive a killed parent"
    left = results(tmp_path / "out")
    assert not set(RESULTS) & set(left)
    for line in seen:
        name = f"studies/{line['loop']}.json"
        assert left[name] == clean[1][name]
    assert not [name for name in left if name.endswith(".part")]
    assert here(monkeypatch, site, "-o", tmp_path / "out", *WHAT, "--resume", "--json") == 0
    again = capsys.readouterr()
    assert json.loads(again.out)["failed"] == 0
    assert results(tmp_path / "out") == clean[1]
    kept = {line["loop"] for line in map(json.loads, (x for x in again.err.splitlines() if x[:1] == "{"))
            if line["kept"]}
    assert {line["loop"] for line in seen} <= kept


@linux
@pytest.mark.parametrize("sign", [signal.SIGINT])
def test_stopped_it_keeps_what_is_done_and_says_how_to_go_on(sign, site, clean, tmp_path, monkeypatch) -> None:
    """One that is terminated, and resumed as it says, is in benchmarks/long."""
    process = start(site, tmp_path / "out", "--jobs", "1")
    first_loops(process, 2)
    workers = children(process.pid)
    # As a terminal does it, Ctrl-C goes to all processes.
    os.killpg(process.pid, sign) if sign == signal.SIGINT else process.send_signal(sign)
    _, err = process.communicate(timeout=HANGS_S)
    assert process.returncode == 130 and "Traceback" not in err, err
    assert gone(workers)
    line = next(x for x in err.splitlines() if "go on with: " in x)
    studies = {n for n in results(tmp_path / "out") if n.startswith("studies/")}
    rows = (tmp_path / "out" / "summary.csv").read_text().splitlines()[1:]
    assert 2 <= len(rows) == len(studies) < LOOPS
    words = shlex.split(line.partition("go on with: stictionid batch ")[2])
    assert "--resume" in words
    if sign == signal.SIGTERM:
        assert here(monkeypatch, *words) == 0
        assert results(tmp_path / "out") == clean[1]


def here(monkeypatch, *arguments: object) -> int:
    """The command in this process, which does the work of the workers, too; its exit code."""
    from stictionid.cli import main

    monkeypatch.setattr("stictionid.batch.work.crew.crew_for", lambda jobs, scheduler: Inline())
    monkeypatch.setattr(sys, "argv", ["stictionid", "batch", *map(str, arguments)])
    with pytest.raises(SystemExit) as done:
        main()
    return int(done.value.code or 0)


def test_failed_loops_are_exit_4_with_strict_only(site, tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "FIC1.csv").write_bytes((site / "FIC100.csv").read_bytes())
    (tmp_path / "in" / "FIC2.csv").write_text("")
    (tmp_path / "in" / "x.doc").write_text("x")
    arguments = (tmp_path / "in", "-o", tmp_path / "out", *WHAT, "--jobs", 1)
    assert here(monkeypatch, *arguments) == 0
    shown = capsys.readouterr()
    assert "1 failed; 1 file skipped" in shown.out and "1 file skipped" in shown.err and "FIC2" in shown.err
    assert here(monkeypatch, *arguments, "--strict", "--resume") == 4


def test_skipped_files_are_rows_and_the_period_is_that_of_the_report(site, tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "FIC1.csv").write_bytes((site / "FIC100.csv").read_bytes())
    (tmp_path / "in" / "=x.doc").write_text("x")
    (tmp_path / "in" / "prices.csv").write_text("item,price\n1,2\n3,4\n")
    arguments = (tmp_path / "in", "-o", tmp_path / "out", *WHAT, "--jobs", 1)
    assert here(monkeypatch, *arguments, "--strict", "--pages") == 4
    shown = capsys.readouterr().out
    assert "1 loop: 1 studied, 0 abstained, 0 failed; 2 files skipped" in shown
    rows = list(csv.DictReader((tmp_path / "out" / "summary.csv").open()))
    assert [(r["loop"], r["status"]) for r in rows] == [("FIC1", "ok"), ("'=x.doc", "skipped"),
                                                        ("prices.csv", "skipped")]
    assert "neither text, Parquet" in rows[1]["message"] and "export it as CSV" in rows[1]["message"]
    assert "no column for" in rows[2]["message"] and "--pv" in rows[2]["message"]
    page = (tmp_path / "out" / "summary.html").read_text()
    assert "prices.csv" in page and 'href=""' not in page
    study = json.loads((tmp_path / "out" / "studies" / "FIC1.json").read_text())
    assert float(rows[0]["period_median_s"]) == study["range"]["period_median_s"]
    # The period shown is the number of the report.
    report = (tmp_path / "out" / "pages" / "FIC1.html").read_text()
    period = re.search(r"Oscillation period</dt><dd class=\"value\">([\d.]+) s", report)
    assert period and re.search(rf"\|\s*{re.escape(period[1])} \|", shown), shown
    assert f"| {period[1]} |" in (tmp_path / "out" / "summary.md").read_text()
    # The file that can be read now is skipped no more, and the other stays.
    (tmp_path / "in" / "prices.csv").write_bytes((site / "FIC100.csv").read_bytes())
    assert here(monkeypatch, *arguments, "--resume", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["loops"], told["ok"], [Path(s["file"]).name for s in told["skipped"]]) == (2, 2, ["=x.doc"])


def test_the_level_study_makes_the_page_of_every_loop(site, tmp_path, monkeypatch) -> None:
    short = tmp_path / "FIC1.csv"
    short.write_text("".join((site / "FIC100.csv").read_text().splitlines(keepends=True)[:60]))
    assert here(monkeypatch, short, "-o", tmp_path / "out", "--level", "study", "--jobs", 1, "-q") == 0
    assert "Can&#x27;t tell" in (tmp_path / "out" / "pages" / "FIC1.html").read_text()


def test_what_can_not_be_begun_is_refused_before_anything_is_touched(site, tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "batch.json").write_text('{"schema": "stictionid.batch/1", "version": "0.0.1"}')
    (tmp_path / "old" / "summary.csv").write_text("loop\n")
    (tmp_path / "empty").mkdir()
    for arguments, code, said in (
        ([site, "-o", tmp_path / "old"], 2, "0.0.1"), ([tmp_path / "none", "-o", tmp_path / "o"], 2, "does not exist"),
        ([tmp_path / "empty", "-o", tmp_path / "o"], 3, "no loop"),
        ([site, "-o", tmp_path / "o", "--level", "all"], 2, "unknown level"),
        ([site, "-o", tmp_path / "o", "--law", "chan"], 2, "chan"),
        ([site, "-o", tmp_path / "o", "--level", "screen", "--method", "arx"], 2, "no meaning"),
    ):
        assert here(monkeypatch, *arguments) == code
        shown = capsys.readouterr()
        assert said in shown.err and "Traceback" not in shown.err and shown.out == "", shown.err
    assert not (tmp_path / "o").exists()
    assert (tmp_path / "old" / "summary.csv").read_text() == "loop\n"
