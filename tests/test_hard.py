"""A small sample of tests/fuzz and tests/faults, and a test for every defect that those found."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from commands import HANGS_S

ROOT = Path(__file__).resolve().parents[1]
for place in ("tests/faults", "benchmarks"):
    sys.path.insert(0, str(ROOT / place))

import fault_numbers  # noqa: E402
import hard  # noqa: E402
import hard_results  # noqa: E402

from stictionid.errors import CannotTell, DataError, UsageError  # noqa: E402


def run(*arguments: object, stdin: str | None = None, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    with open(stdin or os.devnull, "rb") as source:
        return subprocess.run([sys.executable, "-m", "stictionid", *map(str, arguments)], stdin=source,
                              capture_output=True, text=True, cwd=cwd, timeout=HANGS_S,
                              env={**os.environ, "PYTHONPATH": str(ROOT)})


def refused(done: subprocess.CompletedProcess[str], code: int, words: str) -> None:
    assert done.returncode == code and words in done.stderr and "Traceback" not in done.stderr, done.stderr


# --- numbers

@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("name", "as_file"), [
    ("NaN in PV", False), ("one PV of 1e300", False),
    *((name, as_file) for name in ("OP of 1e-300", "PV is minus OP", "PV is noise", "both zero", "OP of two levels",
                                   "denormal PV") for as_file in (False, True))])
def test_numbers_that_break_arithmetic_end_in_a_reason(name: str, as_file: bool) -> None:
    """Files with a few bad cells are read without them and identified whole: benchmarks/long."""
    make, may = fault_numbers.CASES[name]
    outcome = fault_numbers.outcome_of(*make(*_good(), np.random.default_rng(0)), as_file=as_file)
    assert fault_numbers.fits(outcome, fault_numbers.ANY if as_file and may == fault_numbers.REFUSED else may), outcome


def _good() -> fault_numbers.Pair:
    if not _GOOD:
        _GOOD.append(fault_numbers.good_loop())
    return _GOOD[0]


_GOOD: list[fault_numbers.Pair] = []


def test_pv_that_is_op_in_another_unit_is_an_abstention() -> None:
    from stictionid.record.loop import Loop
    from stictionid.record.oscillation import find_range
    from stictionid.record.preconditions import check

    u, y = _good()
    same = Loop(output=u, process_value=32 - 1.8 * u, step_s=1.0, name="x")
    with pytest.raises(CannotTell, match="one signal was given twice") as told:
        check(same, find_range(same))
    assert told.value.code == "identical-signals"
    other = Loop(output=u, process_value=y, step_s=1.0, name="x")
    check(other, find_range(other))


def test_numbers_no_single_precision_holds_are_counted_and_left_out(tmp_path: Path) -> None:
    from stictionid.historian import read

    u, y = (values[:200].tolist() for values in _good())
    y[10:13] = [1e39, -2e300, 1e39]
    file = tmp_path / "x.csv"
    file.write_text("t,PV,OP\n" + "\n".join(f"{k},{a!r},{b!r}" for k, (a, b) in enumerate(zip(y, u, strict=True))))
    reading = read(file)
    said = next(f.statement for f in reading.findings if f.code == "state-as-text")
    assert "3 cells" in said and "beyond 1e+38" in said
    assert np.abs(reading.loop.process_value[reading.loop.used]).max() < 100


# --- limits and inputs without an end

@pytest.mark.parametrize(("options", "words"), [
    (("--duration", "1e7"), "integration steps"), (("--dead-time", "1e11"), "integration steps"),
    (("--step", "1e-6"), "samples are more"), (("--scan", "1e-300"), "too short"), (("--kc", "nan"), "is no number"),
    (("--gain", "1e300"), "above its limit"), (("--quantise", "1e-300"), "finer than"),
    (("--effect", "extra-lag:second_time_constant_s=1e-9"), "too short")])
def test_simulations_nobody_waits_for_are_refused(options: tuple[str, str], words: str, tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from stictionid.cli.app import app

    error = CliRunner().invoke(app, ["simulate", "-o", str(tmp_path / "x.csv"), *options]).exception
    assert isinstance(error, UsageError) and words in error.message and error.hint
    assert not list(tmp_path.iterdir())


def test_the_longest_simulation_is_let_in() -> None:
    from dataclasses import replace

    from stictionid.model.closed_loop import MOST_STEPS, check_setting, preset

    longest = MOST_STEPS * 0.05
    check_setting(replace(preset("foptd"), duration_s=longest))
    with pytest.raises(UsageError, match="20,000,000"):
        check_setting(replace(preset("foptd"), duration_s=longest + 1))


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no /dev/zero here")
def test_inputs_without_an_end_are_refused_or_bounded(tmp_path: Path) -> None:
    refused(run("range", "/dev/zero"), 2, "is a device")
    refused(run("range", "-", stdin="/dev/zero"), 3, "a line longer than")
    study = json.loads((ROOT / "tests" / "golden" / "study_schema_1.json").read_text())
    study["data"]["file"] = "/dev/zero"
    (tmp_path / "s.json").write_text(json.dumps(study))
    done = run("report", tmp_path / "s.json")
    assert done.returncode == 0 and "were not found" in done.stderr
    refused(run("report", tmp_path / "s.json", "--data", "/dev/zero"), 2, "its end can't be known")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFOs here")
def test_a_fifo_is_read_to_its_end_and_not_beyond_the_limit(tmp_path: Path) -> None:
    from stictionid.historian import ReadOptions, read

    u, y = (values[:200].tolist() for values in _good())
    text = "t,PV,OP\n" + "".join(f"{k},{a!r},{b!r}\n" for k, (a, b) in enumerate(zip(y, u, strict=True)))
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    for options, fails in ((ReadOptions(), False), (ReadOptions(limit=("unpacked=1000",)), True)):
        writer = threading.Thread(target=_feed, args=(fifo, text))
        writer.start()
        if fails:
            with pytest.raises(DataError, match="more than the limit"):
                read(fifo, options=options)
        else:
            assert read(fifo, options=options).loop.samples == 200
        writer.join(10)


def _feed(fifo: Path, text: str) -> None:
    with contextlib.suppress(BrokenPipeError):
        fifo.write_text(text)


def test_small_files_have_a_largest_size(tmp_path: Path) -> None:
    from stictionid.batch.plan.loop_lists import read_list
    from stictionid.system.files import MOST_TEXT_BYTES, text_of

    big = tmp_path / "big.json"
    with open(big, "wb") as file:
        file.truncate(MOST_TEXT_BYTES + 1)
    refused(run("report", big), 3, "larger than 64 MiB")
    with pytest.raises(DataError, match="larger than 64 MiB"):
        read_list(big)
    os.truncate(big, MOST_TEXT_BYTES)
    assert len(text_of(big, "the study", hint="")) == MOST_TEXT_BYTES


@pytest.mark.parametrize("option", [
    ("--separator", "ab"), ("--decimal", ";"), ("--zone", "Mars/Base"), ("--encoding", "rot13"), ("--start", "soon"),
    ("--shape", "round"), ("--time-format", "stardate"), ("--limit", "rows"), ("--span-pv", "5,1"),
    ("--mode-map", "1=BOSS"), ("--header", "-1"), ("--step", "0")])
def test_options_are_checked_before_a_file_is_looked_for(option: tuple[str, str]) -> None:
    from stictionid.cli.common.reading import OPTIONS, collect
    from stictionid.historian import read

    defaults = {name: default for name, _, default in OPTIONS}
    name = {"--step": "step_s"}.get(option[0], option[0].lstrip("-").replace("-", "_"))
    value = {"limit": [option[1]], "mode_map": [option[1]], "header": -1, "step_s": 0.0}.get(name, option[1])
    with pytest.raises(UsageError) as told:
        read("there/is/no/such.csv", options=collect(defaults | {name: value}))
    assert "does not exist" not in told.value.message


@pytest.mark.parametrize("words", [
    ("identify", "none.csv", "--with", "nope"), ("identify", "none.csv", "--law", "nope"), ("add", "nope", "none.json"),
    ("diagnose", "none.json", "-o", "/proc/none/x.json"), ("compare", "none.json", "-o", "x.gif"),
    ("report", "none.json", "-o", "x.md", "--figures", "gif"), ("batch", "none", "-o", "x", "--zone", "Mars/Base")])
def test_so_are_the_options_of_every_command(words: tuple[str, ...], tmp_path: Path, monkeypatch) -> None:
    from typer.testing import CliRunner

    from stictionid.cli.app import app

    monkeypatch.chdir(tmp_path)
    error = CliRunner().invoke(app, list(words)).exception
    assert isinstance(error, UsageError) and "none.json" not in error.message and "none.csv" not in error.message
    assert not list(tmp_path.iterdir())


# --- names, studies, results

@pytest.mark.parametrize(("path", "value", "words"), [
    (("substeps",), 10**9, "substeps is 1000000000"), (("substeps",), 0, "substeps is 0"),
    (("values", "dead_time_s"), 1e300, "dead_time_s is 1e+300"), (("values", "time_constant_s"), -5, "is -5"),
    (("values", "initial_residual_force"), 1e14, "not a number from -1"), (("effects",), ["extra-lag"] * 50, "twice"),
    (("segments",), [["a"]], "segments are"), (("process",), "foo", "'foo'"), (("law",), "../../x", "unknown law"),
    (("taps",), [0.1] * 10**5, "number of taps"), (("taps",), ["a"], "is 'a'"), (("period_s",), 0, "period_s is 0"),
    (("values",), [1, 2], "can't be rebuilt")])
def test_a_model_that_no_search_writes_is_refused_before_compiled_code_runs_it(path, value, words: str) -> None:
    """A dead time of 1e300 s in a study edited by hand once ended the process with a segmentation fault."""
    from stictionid.model.restore import rerun
    from stictionid.record.loop import Loop

    u, y = _good()
    model = {"law": "chen", "process": "first-order", "effects": [], "between": "hold", "substeps": 1,
             "increments": False, "taps": [], "fixed": {}, "s_max": 6.0, "period_s": 100.0,
             "values": {"S": 4.0, "J": 2.0, "initial_residual_force": 0.5, "time_constant_s": 5.0, "dead_time_s": 5.0}}
    loop = Loop(output=u, process_value=y, step_s=1.0)
    assert np.isfinite(rerun(loop, model).model[100:]).all()
    at = model
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    with pytest.raises(DataError) as told:
        rerun(loop, model)
    assert words in told.value.message and told.value.hint


@pytest.mark.parametrize("options", [{"fixed": {"dead_time_s": 1e9}}, {"method": "arx", "delay": 5000}])
def test_a_dead_time_beyond_the_record_is_refused(options: dict) -> None:
    from stictionid.record.loop import Loop
    from stictionid.verbs.identify import Options, identify

    u, y = _good()
    with pytest.raises(UsageError, match="more than half the record"):
        identify(Loop(output=u, process_value=y, step_s=1.0), options=Options(**options))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("tags", "words"), [
    ({}, "needs a further tag"), ({"FEED": None, "B": 1.0}, "no further tag 'NONE'"), ({"FEED": 7.0}, "does not vary"),
    ({"FEED": 0.0}, "does not vary"), ({"FEED": np.nan}, "does not vary")])
def test_a_further_tag_that_is_not_there_or_rests_is_refused_and_no_other_taken(tags: dict, words: str) -> None:
    from stictionid.record.loop import Loop
    from stictionid.verbs.identify import Options, identify

    u, y = _good()
    extras = {tag: y.copy() if level is None else np.full(y.size, level) for tag, level in tags.items()}
    effect = "measured-disturbance" + (":NONE" if "NONE" in words else ":FEED" if tags else "")
    with pytest.raises(UsageError, match=words):
        identify(Loop(output=u, process_value=y, step_s=1.0, extras=extras), options=Options(effects=(effect,)))


def test_a_further_tag_beyond_any_measurement_is_refused_like_the_signals() -> None:
    from stictionid.record.loop import Loop

    u, y = _good()
    with pytest.raises(DataError, match="the further tag FEED goes beyond 1e"):
        Loop(output=u, process_value=y, step_s=1.0, extras={"FEED": y * 1e300})
    assert Loop(output=u, process_value=y, step_s=1.0, extras={"A": y * np.nan, "B": y}).moving_extras == ("B",)


def test_nothing_is_written_over_what_it_is_made_from_not_even_with_force(tmp_path: Path) -> None:
    export, study = tmp_path / "loop.csv", tmp_path / "s.json"
    export.write_bytes((ROOT / "sample_data" / "foptd.csv").read_bytes())
    study.write_bytes((ROOT / "tests" / "golden" / "study_schema_1.json").read_bytes())
    (tmp_path / "link.csv").symlink_to(export)
    before = export.read_bytes(), study.read_bytes()
    for words in (("identify", export, "-o", export), ("identify", export, "-o", tmp_path / "link.csv"),
                  ("report", study, "-o", study), ("report", study, "--data", export, "-o", export)):
        done = _invoked(*words, "--force")
        assert isinstance(done, UsageError) and "itself" in done.message
    assert before == (export.read_bytes(), study.read_bytes())


def _invoked(*words: object) -> BaseException | None:
    from typer.testing import CliRunner

    from stictionid.cli.app import app

    return CliRunner().invoke(app, [str(word) for word in words]).exception


def test_links_that_lead_in_a_ring_do_not_stop_a_batch(tmp_path: Path) -> None:
    from stictionid.batch.plan.sources import look

    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.csv").write_text("t,PV,OP\n0,1,2\n")
    (tmp_path / "a" / "back").symlink_to("..")
    (tmp_path / "me").symlink_to("me")
    assert look([str(tmp_path)]).inside == {tmp_path: (tmp_path / "a" / "x.csv",)}


def test_rows_of_one_time_are_said_to_be_that_and_not_too_short_a_window(tmp_path: Path) -> None:
    from stictionid.historian import read

    file = tmp_path / "x.csv"
    file.write_text("t,PV,OP\n" + "".join(f"5,{k % 7},{k % 5}\n" for k in range(50)))
    with pytest.raises(DataError, match=r"1 usable row, fewer than 4 \(49 of 50 rows are left out as 'duplicate'\)"):
        read(file)

def test_a_record_shorter_than_a_period_is_compared_and_drawn(tmp_path: Path) -> None:
    from stictionid.comparison import compare
    from stictionid.historian import read_loop
    from stictionid.record.study import study_from_json
    from stictionid.reports.pictures.comparison_pictures import comparison_pictures

    u, y = (values[:14].tolist() for values in _good())
    file = tmp_path / "short.csv"
    file.write_text("t,PV,OP\n" + "".join(f"{k},{a!r},{b!r}\n" for k, (a, b) in enumerate(zip(y, u, strict=True))))
    study = study_from_json((ROOT / "tests" / "golden" / "study_schema_1.json").read_text())
    assert comparison_pictures(compare(read_loop(file), study, read_loop(file)))


def test_what_a_killed_writer_left_goes_when_the_batch_goes_on(tmp_path: Path) -> None:
    from stictionid.batch.work.store import Store

    store = Store(tmp_path / "out")
    store.begin()
    store.close()
    (store.studies / ".FIC101.json.abc.part").write_text("{")
    (store.folder / ".summary.csv.abc.part").write_text("")
    (store.studies / "FIC101.json").write_text("{}")
    other = Store(tmp_path / "out")
    other.begin()
    assert [p.name for p in other.studies.iterdir()] == ["FIC101.json"] and not list(other.folder.glob(".*.part"))
    (other.studies / ".FIC102.json.abc.part").write_text("{")
    with pytest.raises(UsageError, match="another batch"):
        store.begin()
    assert list(other.studies.glob(".*.part")), "a batch that has no claim must leave another's work alone"
    other.close()


def test_results_are_only_added_to_and_the_table_adds_them_up(tmp_path: Path) -> None:
    file, other = tmp_path / "a.json", tmp_path / "b.json"
    for where, seed in ((file, 1), (other, 2)):
        hard_results.add("fuzz", "c0de", {"seed": seed, "seconds": 1, "doors": {"x": [5, 4, seed - 1]}, "failing": []},
                         where)
    assert hard_results.merge(hard_results.runs(other), file) == 1
    assert hard_results.merge(hard_results.runs(other), file) == 0
    hard_results.add("kills", "c0de", {"parents": 1, "workers": 2, "all": 3, "rounds": 4, "failures": 0}, file)
    text = hard.table(hard_results.runs(file))
    assert "19 at 1 doors (10 read, 8 refused)" in text and "6 at random times" in text and "4 of 4" in text
    assert not list(tmp_path.glob("*.part"))


def test_the_fingerprint_follows_the_code(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "stictionid").mkdir()
    (tmp_path / "stictionid" / "a.py").write_text("x = 1\n")
    monkeypatch.setattr(hard_results, "ROOT", tmp_path)
    marks = []
    for text in ("x = 1\n", "x = 2\n", "x = 1\n"):
        (tmp_path / "stictionid" / "a.py").write_text(text)
        hard_results.code.cache_clear()
        marks.append(hard_results.code())
    hard_results.code.cache_clear()
    assert marks[0] == marks[2] != marks[1]


def test_the_docs_show_the_table_of_the_results() -> None:
    shown = (ROOT / "docs" / "robustness.md").read_text(encoding="utf-8")
    assert hard.table(hard_results.runs()) in shown, "docs/robustness.md is older than docs/hard_results.json"
