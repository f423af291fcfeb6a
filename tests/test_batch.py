"""Batch: retries, resuming, the store, the summary made from it, and the executors.

A worker that dies, and a batch in several processes, are in benchmarks/long.
"""

from __future__ import annotations

import csv
import io
import json
import os
import time
from concurrent.futures import Future
from html import escape
from pathlib import Path

import numpy as np
import pytest
from batch_files import Inline, records, write_csv, write_wide
from commands import HANGS_S

from stictionid.batch.plan.tasks import plan
from stictionid.batch.summary.page import page_of, write_summary
from stictionid.batch.summary.rows import COLUMNS, RULE, rank_key, rows_of
from stictionid.batch.task import ABSTAINED, FAILED, OK, Task, TaskOutcome, Work
from stictionid.batch.work import store as store_room
from stictionid.batch.work.crew import Processes, crew_for
from stictionid.batch.work.drive import drive
from stictionid.batch.work.store import Store
from stictionid.batch.work.worker import attempt
from stictionid.errors import DataError, UsageError
from stictionid.historian import ReadOptions
from stictionid.options import Options
from stictionid.system.csv_safety import harmless

SCREEN = Work("screen")
RESULTS = ("summary.csv", "summary.parquet", "summary.md", "summary.html")


def run(todo, folder: Path, *, crew=None, work=SCREEN, resume=False, attempt=attempt, tell=None) -> Store:
    """A whole batch into a folder."""
    store = Store(folder)
    store.begin()
    crew = crew or Inline()
    try:
        drive(todo.tasks, work, crew, store, resume=resume, attempt=attempt, tell=tell)
        write_summary(store)
    finally:
        crew.shutdown()
        store.close()
    return store


def content(folder: Path) -> dict[str, bytes]:
    """Every file of a batch by its name, without what may differ."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*"))
            if p.is_file() and p.name != "timing.csv"}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with four loops and a damaged one."""
    folder = tmp_path_factory.mktemp("site")
    for name, loop in records(4).items():
        write_csv(folder / f"{name}.csv", loop)
    (folder / "FIC900.csv").write_text("")
    return folder


@pytest.fixture(scope="module")
def todo(site):
    return plan([str(site)], SCREEN)


@pytest.fixture(scope="module")
def clean(todo, tmp_path_factory):
    """What an undisturbed batch of the site leaves."""
    return content(run(todo, tmp_path_factory.mktemp("clean") / "out").folder)


def test_on_a_cluster_nobody_is_blamed_for_a_neighbours_death(todo, clean, tmp_path) -> None:
    """Dask gives up all calls that waited for the workers one call has killed."""

    class Killed(Exception):
        pass

    class Neighbours(Inline):
        room, sure = 4, False

        def submit(self, fn, /, task, work):
            self.flying = {**getattr(self, "flying", {}), task.loop: Future()}
            if task.loop == "FIC103":  # the last of four: all have been handed in
                for name, future in self.flying.items():
                    future.set_exception(Killed(name))
                self.flying = {}
                return future
            if getattr(self, "second", False) or task.loop == "FIC900":
                self.flying.pop(task.loop)
                self.second = True
                return super().submit(fn, task, work)
            return self.flying[task.loop]

        def dead(self, error):
            return isinstance(error, Killed)

    rows = {row["loop"]: row["status"] for row in rows_of(run(todo, tmp_path / "out", crew=Neighbours()))}
    assert rows == {"FIC100": OK, "FIC101": OK, "FIC102": OK, "FIC103": FAILED, "FIC900": FAILED}


def test_when_no_work_can_be_handed_out_what_is_done_is_kept(todo, tmp_path) -> None:
    class Closing(Inline):
        count = 0

        def submit(self, fn, /, *args):
            self.count += 1
            if self.count > 2:
                raise RuntimeError("cannot schedule new futures after shutdown")
            return super().submit(fn, *args)

    store = Store(tmp_path / "out")
    store.begin()
    with pytest.raises(UsageError, match="no more work can be handed out"):
        drive(todo.tasks, SCREEN, Closing(), store)
    assert len(rows_of(store)) == 2
    store.close()


# Resuming ---------------------------------------------------------------------------------------------------------


def test_resume_does_only_what_is_not_there_or_no_longer_fits(site, tmp_path) -> None:
    for name in ("FIC100", "FIC101", "FIC102"):
        (tmp_path / f"{name}.csv").write_bytes((site / f"{name}.csv").read_bytes())
    todo = plan([str(tmp_path)], SCREEN)
    out = tmp_path / "out"
    run(todo, out)
    first = content(out)
    seen: dict[str, bool] = {}

    def tell(tally, task, out):
        if task is not None:
            seen[task.loop] = out.kept

    run(todo, out, resume=True, tell=tell)
    assert seen == dict.fromkeys(("FIC100", "FIC101", "FIC102"), True) and content(out) == first

    # Times of files say nothing: moved by years all is kept, other bytes of the same size and time are done again.
    for file in tmp_path.rglob("*"):
        os.utime(file, (file.stat().st_mtime - 1e8,) * 2)
    run(todo, out, resume=True, tell=tell)
    assert all(seen.values()) and content(out) == first
    changed = tmp_path / "FIC102.csv"
    before, text = changed.stat(), changed.read_bytes()
    changed.write_bytes(text[:-2] + (b"1" if text[-2:-1] != b"1" else b"2") + text[-1:])
    os.utime(changed, ns=(before.st_atime_ns, before.st_mtime_ns))
    run(todo, out, resume=True, tell=tell)
    assert seen == {"FIC100": True, "FIC101": True, "FIC102": False} and changed.stat().st_size == before.st_size

    (out / "studies" / "FIC100.json").write_text("{ half a study")
    (tmp_path / "FIC101.csv").write_bytes((site / "FIC103.csv").read_bytes())
    run(todo, out, resume=True, tell=tell)
    assert seen == {"FIC100": False, "FIC101": False, "FIC102": True}

    work = Work("screen", Options(seed=1))
    run(plan([str(tmp_path)], work), out, work=work, resume=True, tell=tell)
    assert not any(seen.values()), "another seed makes another study"


def test_a_study_of_another_version_is_done_again_and_left_out_of_the_summary(todo, tmp_path, monkeypatch) -> None:
    out = tmp_path / "out"
    run(todo, out)
    study = out / "studies" / "FIC100.json"
    made = json.loads(study.read_text())
    made["created_by"]["version"] = "0.0.1"
    study.write_text(json.dumps(made))
    store = Store(out)
    assert "FIC100" not in {row["loop"] for row in rows_of(store)}
    assert store.standing(next(t for t in todo.tasks if t.loop == "FIC100"))[0] is None


# Deaths -----------------------------------------------------------------------------------------------------------


def test_a_defect_is_a_failed_loop_with_its_traceback(todo, tmp_path, monkeypatch) -> None:
    from stictionid.batch.work import worker

    monkeypatch.setattr(worker, "read_task", lambda task, sha256: 1 / 0)
    store = run(todo, tmp_path / "out")
    record = json.loads((store.failures / "FIC100.json").read_text())
    assert "ZeroDivisionError" in record["message"] and "Traceback" in record["detail"]


def test_workers_see_one_core_and_end_with_their_parent(monkeypatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    crew = Processes(1)
    try:
        assert crew.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "1"
        assert crew.submit(os.getenv, "NUMBA_NUM_THREADS").result() == "1"
        pid = crew.submit(os.getpid).result()
    finally:
        crew.shutdown(wait=False)
    until = time.monotonic() + HANGS_S
    while Path(f"/proc/{pid}").exists() and time.monotonic() < until:
        time.sleep(0.1)
    assert not Path(f"/proc/{pid}").exists()


# The store --------------------------------------------------------------------------------------------------------


def test_a_loop_has_one_answer_at_any_time(tmp_path) -> None:
    store = Store(tmp_path / "out")
    store.begin()
    task = Task("A", "file", "a.csv", ReadOptions(), "A", "c")
    study = json.dumps({"created_by": {"version": store_room.__version__}, "data": {"name": "A"}, "verdict": {}})
    store.keep(task, TaskOutcome("A", OK, study))
    assert [r["status"] for r in rows_of(store)] == [OK]
    store.keep(task, TaskOutcome("A", FAILED, message="no"))
    assert [(r["status"], r["message"]) for r in rows_of(store)] == [(FAILED, "no")]
    assert (store.studies / "A.json").exists(), "an older study is not thrown away"
    store.keep(task, TaskOutcome("A", OK, study))
    assert [r["status"] for r in rows_of(store)] == [OK]
    store.close()


def test_a_full_disk_is_one_sentence_and_what_was_done_stays(todo, tmp_path, monkeypatch) -> None:
    store = Store(tmp_path / "out")
    store.begin()
    real, written = store_room.write_whole, []

    def full(path, *args, **kwargs):
        if len(written) == 2:
            raise UsageError(f"no room left while writing {path}")
        written.append(path)
        return real(path, *args, **kwargs)

    monkeypatch.setattr(store_room, "write_whole", full)
    with pytest.raises(UsageError, match="no room left"):
        drive(todo.tasks, SCREEN, Inline(), store)
    assert len(rows_of(store)) == 2
    store.close()


def test_folders_that_are_not_ours_are_left_alone(tmp_path) -> None:
    with pytest.raises(UsageError, match="is a file"):
        (tmp_path / "f").write_text("x")
        Store(tmp_path / "f").check()
    with pytest.raises(UsageError, match="did not write"):
        (tmp_path / "d").mkdir()
        (tmp_path / "d" / "thesis.tex").write_text("x")
        Store(tmp_path / "d").check()
    Store(tmp_path / "d").check(force=True)
    mark = tmp_path / "d" / "batch.json"
    mark.write_text('{"schema": "stictionid.batch/1", "version": "0.0.1"}')
    with pytest.raises(UsageError, match=r"written by stictionid 0\.0\.1"):
        Store(tmp_path / "d").check()
    mark.write_text('{"schema": "stictionid.batch/9", "version": "9.0"}')
    with pytest.raises(DataError, match="newer"):
        Store(tmp_path / "d").check(force=True)
    mark.write_text("}")
    with pytest.raises(UsageError, match="damaged"):
        Store(tmp_path / "d").check()


def test_two_batches_do_not_share_a_folder(tmp_path) -> None:
    pytest.importorskip("fcntl")
    first, second = Store(tmp_path / "out"), Store(tmp_path / "out")
    first.begin()
    with pytest.raises(UsageError, match="another batch"):
        second.begin()
    first.close()
    second.begin()
    second.close()


# The summary ------------------------------------------------------------------------------------------------------


def test_the_summary_is_the_studies(todo, clean, tmp_path) -> None:
    import pyarrow.parquet as pq

    table = list(csv.DictReader(io.StringIO(clean["summary.csv"].decode())))
    assert list(table[0]) == list(COLUMNS)
    assert {row["loop"] for row in table} == {t.loop for t in todo.tasks}
    parquet = pq.read_table(io.BytesIO(clean["summary.parquet"])).to_pylist()
    for text, typed in zip(table, parquet, strict=True):
        assert text["loop"] == typed["loop"]
        if typed["status"] == FAILED:
            assert typed["verdict"] is None and "empty" in typed["message"]
            continue
        study = json.loads(clean[typed["study"]])
        assert typed["verdict"] == study["verdict"]["stiction"]
        assert typed["period_s"] == study["range"]["period_s"] == float(text["period_s"])
        assert typed["confidence"] == study["verdict"]["confidence"]
    page, words = clean["summary.html"].decode(), clean["summary.md"].decode()
    assert all(t.loop in page and t.loop in words for t in todo.tasks)
    assert 'href="studies/FIC100.json"' in page and 'href="failures/FIC900.json"' in page
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")


def test_the_worst_loop_comes_first() -> None:
    def row(loop, status="ok", verdict=None, S=None, J=None, share=None):
        return {"loop": loop, "status": status, "verdict": verdict, "S": S, "J": J, "friction_share": share}

    rows = [row("a", FAILED), row("b", verdict="no stiction", S=9.0), row("c", verdict="undecided", S=1.0),
            row("d", verdict="stiction", S=1.0, J=0.5), row("e", verdict="stiction", S=5.0, J=0.1),
            row("f", verdict="stiction", S=1.0, J=0.9), row("g", verdict="stiction", share=0.3)]
    assert "".join(r["loop"] for r in sorted(rows, key=rank_key)) == "efdgcba"
    # The band of S stands above the share, and the share above S; a loop without an answer stands behind all answers.
    rows = [row("h", verdict="stiction", S=4.9, share=0.2), row("i", verdict="stiction", S=3.0, share=0.9),
            row("j", verdict="stiction", S=6.0, share=0.1), row("k", ABSTAINED, "undecided"),
            row("l", verdict="no stiction", S=0.1)]
    assert "".join(r["loop"] for r in sorted(rows, key=rank_key)) == "jihlk"
    page = page_of([{**dict.fromkeys(COLUMNS), "rhythm": None, **r, "adequate": "no"} for r in rows])
    assert escape(RULE) in page and "severe from 5 %" in RULE and page.count("<td>not adequate</td>") == len(rows)


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1+cmd", "@SUM(A1)", "\t=1", "\r=1", " =1", "a\n=1"])
def test_no_cell_of_the_summary_is_a_formula(text) -> None:
    (cell,) = next(csv.reader(io.StringIO(f'"{harmless(text)}"')))
    assert not cell.lstrip().startswith(("=", "+", "-", "@")) and "\n" not in cell


def test_a_hostile_loop_name_does_no_harm_anywhere(tmp_path) -> None:
    name = '=HYPERLINK("x")|<script>alert(1)</script>`../../x'
    loop = records(1)["FIC100"]
    (tmp_path / "list.csv").write_text('loop,pv,op\n"' + name.replace('"', '""') + '",FIC100.PV,FIC100.OP\n')
    data = write_wide(tmp_path / "w.csv", {"FIC100": loop})
    out = run(plan([str(data)], SCREEN, loops=tmp_path / "list.csv"), tmp_path / "a" / "out").folder
    assert {p.name for p in (tmp_path / "a").rglob("*") if p.is_file()} == {
        "batch.json", *RESULTS, "timing.csv", next((out / "studies").iterdir()).name}
    for table in ("summary.csv", "timing.csv"):
        rows = list(csv.DictReader(io.StringIO((out / table).read_text())))
        assert rows[0]["loop"] == "'" + name
    assert "<script>alert" not in (out / "summary.html").read_text() + (out / "summary.md").read_text()


# Crews and caches -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense", "tcp://127.0.0.1:0", "tcp://nowhere.invalid:8786"])
def test_a_scheduler_out_of_reach_is_told(address) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(UsageError, match=address.partition("//")[2] or address):
        crew_for(1, address)


def test_without_dask_the_option_says_what_to_install(monkeypatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match="not installed") as refusal:
        crew_for(1, "tcp://127.0.0.1:8786")
    assert "pip install distributed" in refusal.value.hint


def test_one_worker_fills_an_empty_cache_while_the_others_wait(tmp_path, monkeypatch) -> None:
    """Four threads stand for four processes: the lock is the file's, not the process's."""
    import threading

    from stictionid.batch.work import warm

    pytest.importorskip("fcntl")
    monkeypatch.setattr(warm, "cache_folder", lambda: tmp_path)
    inside, most, firsts = [0], [0], []

    class Never(set):
        def __contains__(self, level):
            return False

    monkeypatch.setattr(warm, "turns_taken", Never())

    def start() -> None:
        with warm.first_turn("screen") as first:
            firsts.append(first)
            if first:
                inside[0] += 1
                most[0] = max(most[0], inside[0])
                time.sleep(0.2)
                inside[0] -= 1

    threads = [threading.Thread(target=start) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(firsts) == [False, False, False, True] and most == [1]


def test_the_lock_lies_where_numba_keeps_the_kernels() -> None:
    from stictionid.batch.work import warm
    from stictionid.numerics.cross_products import products

    products(np.ones((4, 1)), (0,), np.ones((4, 2)), np.array([0]), np.array([4]))
    folder = warm.cache_folder()
    assert folder is None or any(folder.glob("*.products_kernel-*.nbi"))


def test_a_change_of_any_source_file_is_a_new_first_turn(tmp_path, monkeypatch) -> None:
    from stictionid.batch.work import warm

    pytest.importorskip("fcntl")
    source = tmp_path / "package" / "laws" / "law.py"
    source.parent.mkdir(parents=True)
    source.write_text("x = 1\n")
    monkeypatch.setattr(warm, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(warm, "__file__", str(tmp_path / "package" / "batch" / "work" / "warm.py"))

    def first() -> bool:
        monkeypatch.setattr(warm, "turns_taken", set())
        with warm.first_turn("screen") as turn:
            return turn

    assert (first(), first()) == (True, False)
    os.utime(source, (1.0, 1.0))
    assert (first(), first()) == (True, False)


def test_without_a_writable_cache_everybody_just_works(tmp_path, monkeypatch) -> None:
    from stictionid.batch.work import warm

    monkeypatch.setattr(warm, "cache_folder", lambda: None)
    monkeypatch.setattr(warm, "turns_taken", set())
    with warm.first_turn("screen") as first:
        assert first is False


def test_every_loop_may_have_a_page_that_the_summary_links_to(site, tmp_path) -> None:
    work = Work("screen", Options(), pages=True)
    store = run(plan([str(site)], work), tmp_path / "out", work=work)
    made = {p.stem for p in store.pages.glob("*.html")}
    assert made == {p.stem for p in store.studies.glob("*.json")} and made
    summary = (store.folder / "summary.html").read_text()
    for name in made:
        assert f'href="pages/{name}.html"' in summary
        page = (store.pages / f"{name}.html").read_text()
        assert "stictionid report" in page and "<svg" in page and "<script src" not in page
    lost = next(iter(store.pages.glob("*.html")))
    text = lost.read_bytes()
    lost.unlink()
    run(plan([str(site)], work), tmp_path / "out", work=work, resume=True)
    assert lost.read_bytes() == text, "a study without its page is done again"
    run(plan([str(site)], SCREEN), tmp_path / "out", resume=True)
