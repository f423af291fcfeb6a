"""Plan of a batch: the loops that it finds, their file names, and refusals of ambiguous input."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from batch_files import long_table, records, write_csv, write_dataset, write_wide

from stictionid.batch.plan.loop_lists import read_list
from stictionid.batch.plan.tasks import key_for, plan
from stictionid.batch.task import FAILED, OK, Task, Work
from stictionid.batch.work.worker import attempt
from stictionid.errors import DataError, UsageError
from stictionid.historian import ReadOptions

SCREEN = Work("screen")


@pytest.fixture(scope="module")
def loops():
    return records(3)


def names(paths, **more) -> list[str]:
    return sorted(t.loop for t in plan([str(p) for p in paths], SCREEN, **more).tasks)


def read_back(task: Task):
    """The loop a worker would read for a task."""
    from stictionid.batch.work import worker

    return worker.read_task(task, worker.fingerprint_of(task)).loop


def same(loop, truth) -> bool:
    return bool(np.allclose(loop.output, truth.output) and np.allclose(loop.process_value, truth.process_value))


def lay_out(folder: Path, layout: str, loops) -> Path:
    """The loops written as one of the layouts that a batch knows."""
    import pyarrow.parquet as pq

    place = folder / layout
    if layout == "files":
        place.mkdir()
        for name, loop in loops.items():
            write_csv(place / f"{name}.csv", loop)
    elif layout == "wide":
        place = write_wide(folder / "wide.csv", loops)
    elif layout in ("area", "tag"):
        write_dataset(place, loops, by=layout)
    elif layout == "long parquet":
        place = folder / "long.parquet"
        pq.write_table(long_table(loops), place)
    elif layout == "wide parquet":
        import pyarrow as pa
        from batch_files import columns

        place = folder / "wide.parquet"
        signals = {f"{n}.{r}": v for n, loop in loops.items() for r, v in columns(loop).items()}
        pq.write_table(pa.table({"t": next(iter(loops.values())).time_s, **signals}), place)
    elif layout == "long csv":
        from pyarrow import csv

        place = folder / "long.csv"
        csv.write_csv(long_table(loops), place)
    elif layout == "loop column":
        import pyarrow as pa
        import pyarrow.dataset as ds
        from batch_files import columns

        parts = [pa.table({"loop": [n] * loop.samples, "t": loop.time_s, **columns(loop)}) for n, loop in loops.items()]
        ds.write_dataset(pa.concat_tables(parts), place, format="parquet",
                         partitioning=ds.partitioning(pa.schema([("loop", pa.string())]), flavor="hive"))
    elif layout == "file per tag":
        from batch_files import columns

        place.mkdir()
        for name, loop in loops.items():
            for role, values in columns(loop).items():
                start = np.datetime64("2024-03-01T00:00:00")
                lines = ["time,value"] + [f"{start + int(t)},{float(v)!r}" for t, v in zip(loop.time_s, values,
                                                                                           strict=True)]
                (place / f"{name}.{role}.csv").write_text("\n".join(lines) + "\n")
    return place


LAYOUTS = ("files", "wide", "area", "tag", "long parquet", "wide parquet", "long csv", "loop column", "file per tag")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_loops(layout, tmp_path, loops) -> None:
    todo = plan([str(lay_out(tmp_path, layout, loops))], SCREEN)
    assert sorted(t.loop for t in todo.tasks) == sorted(loops)
    assert todo.skipped == ()
    for task in todo.tasks:
        read = read_back(task)
        assert same(read, loops[task.loop]), task
        assert read.setpoint is not None
        assert read.origin.sha256, "without a fingerprint nothing can be resumed"


def test_a_dataset_is_read_by_its_loop_and_not_whole(tmp_path, loops) -> None:
    """Push-down: the rows of other tags never become a table, and files of other tags are not opened at all."""
    from stictionid.historian.dataset import open_dataset, rows_of

    folder = write_dataset(tmp_path / "d", loops, by="tag")
    (folder / "tag=FIC102.PV" / "part-0.parquet").write_bytes(b"PAR1 is all that is left of it")
    task = next(t for t in plan([str(folder)], SCREEN).tasks if t.loop == "FIC100")
    source, table = rows_of(open_dataset(folder), task.select)
    assert table.rows == 3 * loops["FIC100"].samples
    assert source.sha256 == rows_of(open_dataset(folder), task.select)[0].sha256


def test_the_fingerprint_of_a_loop_ignores_other_loops(tmp_path, loops) -> None:
    from stictionid.historian.dataset import open_dataset, rows_of

    folder = write_dataset(tmp_path / "d", loops)
    task = plan([str(folder)], SCREEN).tasks[0]
    before = rows_of(open_dataset(folder), task.select)[0].sha256
    write_dataset(folder, {**loops, "FIC900": loops["FIC102"]})
    assert rows_of(open_dataset(folder), task.select)[0].sha256 == before
    write_dataset(folder, {**loops, task.loop: records(1, seed=9)["FIC100"]})
    assert rows_of(open_dataset(folder), task.select)[0].sha256 != before


def test_foreign_files_are_skipped_with_their_reason_and_damaged_ones_fail(tmp_path, loops) -> None:
    for name, loop in loops.items():
        write_csv(tmp_path / f"{name}.csv", loop)
    (tmp_path / "manual.pdf").write_bytes(b"%PDF")
    (tmp_path / "README.txt").write_text("Exported by night shift.\n")
    (tmp_path / "trend.csv").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(128, 256)))
    (tmp_path / "FIC300.csv").mkdir()
    (tmp_path / "prices.csv").write_text("item,price\n1,2\n3,4\n")
    (tmp_path / "FIC200.csv").write_text("")
    (tmp_path / "FIC201.parquet").write_bytes(b"PAR1 cut off")
    (tmp_path / "FIC202.txt").write_text("")
    (tmp_path / "FIC203.csv.gz").write_bytes(gzip.compress(b"time,PV,OP\n" * 99)[:40])
    (tmp_path / "FIC200.parquet").write_bytes(b"")
    todo = plan([str(tmp_path)], SCREEN)
    assert {Path(s.file).name for s in todo.skipped} == {"manual.pdf", "README.txt", "prices.csv", "trend.csv",
                                                             "FIC300.csv"}
    assert all(s.reason and s.hint for s in todo.skipped)
    bad = {t.loop: t for t in todo.tasks if t.problem}
    assert set(bad) == {"FIC200.csv", "FIC200.parquet", "FIC201", "FIC202", "FIC203"}
    for name, said in (("FIC200.csv", "is empty"), ("FIC202", "is empty"), ("FIC203", "damaged gzip")):
        assert attempt(bad[name], SCREEN).status == FAILED and said in attempt(bad[name], SCREEN).message
    assert plan([str(tmp_path / "FIC202.txt")], SCREEN).tasks[0].problem


def test_results_of_a_batch_are_no_data(tmp_path, loops) -> None:
    write_csv(tmp_path / "FIC100.csv", loops["FIC100"])
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "batch.json").write_text("{}")
    write_csv(tmp_path / "out" / "FIC101.csv", loops["FIC101"])
    assert names([tmp_path]) == ["FIC100"]


def test_patterns_and_absent_paths(tmp_path, loops) -> None:
    for name, loop in loops.items():
        write_csv(tmp_path / f"{name}.csv", loop)
    assert names([tmp_path / "*1.csv"]) == ["FIC101"]
    with pytest.raises(UsageError, match="does not exist"):
        plan([str(tmp_path / "none.csv")], SCREEN)
    with pytest.raises(UsageError, match="no file fits"):
        plan([str(tmp_path / "*.dat")], SCREEN)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="no loop"):
        plan([str(tmp_path / "empty")], SCREEN)


def test_two_loops_of_one_name_are_refused_by_name(tmp_path, loops) -> None:
    for unit in ("u1", "u2"):
        (tmp_path / unit).mkdir()
        write_csv(tmp_path / unit / "FIC100.csv", loops["FIC100"])
    with pytest.raises(UsageError, match=r"two loops are called 'FIC100'.*u1.*u2"):
        plan([str(tmp_path)], SCREEN)


def test_one_loop_of_many(tmp_path, loops) -> None:
    assert names([write_wide(tmp_path / "w.csv", loops)], reading=ReadOptions(loop="fic_101")) == ["FIC101"]
    with pytest.raises(UsageError, match="no loop 'TIC1'") as refusal:
        names([tmp_path / "w.csv"], reading=ReadOptions(loop="TIC1"))
    assert "FIC101" in refusal.value.hint


def test_tags_said_by_hand_find_one_loop_of_a_dataset(tmp_path, loops) -> None:
    said = ReadOptions(pv="FIC101.PV", op="FIC101.OP")
    (task,) = plan([str(write_dataset(tmp_path / "d", loops))], SCREEN, reading=said).tasks
    assert task.loop == "FIC101" and same(read_back(task), loops["FIC101"]) and read_back(task).setpoint is None


# The loop list --------------------------------------------------------------------------------------------------


def test_a_loop_list_names_tags_and_spans(tmp_path, loops) -> None:
    data = write_dataset(tmp_path / "d", loops)
    listed = tmp_path / "list.csv"
    listed.write_text('loop,sp,pv,op,position,span_op,span_pv\n'
                      'Feed flow,FIC100.SP,FIC100.PV,FIC100.OP,,"0,50",\n'
                      "No setpoint,,FIC101.PV,FIC101.OP,,,\n"
                      "Gone,FIC102.SP,FIC102.PVX,FIC102.OP,,,\n")
    todo = plan([str(data)], SCREEN, loops=listed)
    feed, bare, gone = todo.tasks
    assert (feed.loop, bare.loop, gone.loop) == ("Feed flow", "No setpoint", "Gone")
    assert read_back(feed).output == pytest.approx(2.0 * loops["FIC100"].output)
    assert read_back(bare).setpoint is None
    out = attempt(gone, SCREEN)
    assert out.status == FAILED and "FIC102.PVX" in out.message and "FIC102.PV" in out.message


@pytest.mark.parametrize("layout", ["wide", "wide parquet", "long csv", "file per tag"])
def test_a_loop_list_works_with_every_layout(layout, tmp_path, loops) -> None:
    place = lay_out(tmp_path, layout, loops)
    listed = tmp_path / "list.csv"
    listed.write_text("loop,pv,op\nA,FIC100.PV,FIC100.OP\n")
    (task,) = plan([str(place)], SCREEN, loops=listed).tasks
    assert same(read_back(task), loops["FIC100"])


@pytest.mark.parametrize(("text", "said"), [
    ("loop,pv\nA,B\n", "no column 'op'"), ("loop,pv,op,colour\n", "unknown column 'colour'"), ("", "no column"),
    ("loop,pv,op\nA,,C\n", "line 2: no pv"), ("loop,pv,op\nA,B,C\nA,D,E\n", "two loops 'A', in lines 2 and 3"),
    ("loop,pv,op,span_op\nA,B,C,wide\n", "'wide' is no range"), ("loop,pv,op\n", "no loops")])
def test_a_bad_loop_list_is_refused_with_line_and_column(text, said, tmp_path) -> None:
    (tmp_path / "list.csv").write_text(text)
    with pytest.raises((DataError, UsageError), match=said):
        read_list(tmp_path / "list.csv")


def test_a_list_of_which_nothing_is_there_is_refused(tmp_path, loops) -> None:
    (tmp_path / "list.csv").write_text("loop,pv,op\nA,X.PV,X.OP\n")
    with pytest.raises(UsageError, match="none of the 1 loops"):
        plan([str(write_wide(tmp_path / "w.csv", loops))], SCREEN, loops=tmp_path / "list.csv")


# Names ------------------------------------------------------------------------------------------------------------

HOSTILE = ["../../etc/passwd", "/abs", "..", ".", "", " ", "a/b", "a\\b", "CON", "nul.txt", "fic101", "FIC101 ",
           "x" * 400, "名前", "a\0b", "=1+1", "-rf", "~", "a\nb", "\ud800", "LPT1", ".hidden", "FIC101"]


def test_no_name_of_a_loop_leaves_the_folder_or_meets_another() -> None:
    keys = [key_for(name) for name in HOSTILE]
    assert len({k.casefold() for k in keys}) == len(HOSTILE)
    for key in keys:
        assert key == Path(key).name and not key.startswith((".", "-", "~")) and len(key) <= 100
        assert all(c.isascii() and (c.isalnum() or c in "._-") for c in key), key
    assert key_for("FIC101") == "FIC101"


def test_a_task_that_works_gives_a_study_under_its_own_name(tmp_path, loops) -> None:
    import json

    (task,) = plan([str(write_csv(tmp_path / "FIC100.csv", loops["FIC100"]))], SCREEN).tasks
    out = attempt(task, SCREEN)
    study = json.loads(out.text or "")
    assert out.status == OK and study["data"]["name"] == "FIC100" and study["verdict"]["stiction"] == "stiction"
    assert study["command"].startswith("stictionid batch ") and "--jobs" not in study["command"]


@pytest.mark.parametrize("layout", ["tag", "area", "loop column", "wide", "long parquet", "file per tag"])
def test_the_data_behind_a_study_are_found_again(layout, tmp_path, loops) -> None:
    """`report` and `diagnose` re-read the loop by what its study remembers, from whatever layout it came."""
    from stictionid.record.study import study_from_json
    from stictionid.reports.pictures.curves import gather

    todo = plan([str(lay_out(tmp_path, layout, loops))], SCREEN)
    task = next(t for t in todo.tasks if t.loop == "FIC100")
    case = gather(study_from_json(attempt(task, SCREEN).text or ""))
    assert case.loop is not None, case.missing
    assert same(case.loop, loops["FIC100"])
