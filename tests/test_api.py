"""The Python interface: names, DataFrames in and out, round trips, short texts, pictures, messages, threads.

Curves of a file, and the lines of docs/python.md, are in benchmarks/long.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import study_factory
from quick_loops import identified_once
from threadpoolctl import threadpool_info, threadpool_limits

import stictionid as st
from stictionid.api.messages import in_python
from stictionid.api.progress import Bar, teller
from stictionid.api.tables import candidates
from stictionid.api.threads import ASKED, one_thread
from stictionid.errors import DataError, UsageError
from stictionid.model.closed_loop import preset, simulate
from stictionid.record.study import study_from_json, to_json
from stictionid.record.swing import Share

ROOT = Path(__file__).parent.parent
SAMPLE = ROOT / "sample_data" / "foptd_scanned.parquet"


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    return pd.read_parquet(SAMPLE)


@pytest.fixture(scope="module")
def loop(frame: pd.DataFrame) -> st.Loop:
    return st.Loop.from_dataframe(frame, name="FIC1", units={"process_value": "m³/h"})


@pytest.fixture(scope="module")
def half(frame: pd.DataFrame) -> st.Loop:
    return st.Loop.from_dataframe(frame[:500], name="FIC1", units={"process_value": "m³/h"})


@pytest.fixture(scope="module")
def study(half: st.Loop) -> st.Study:
    return st.identify(half, base_only=True)


def test_dir_shows_the_public_names_alone() -> None:
    assert dir(st) == ["Loop", "Study", "add", "compare", "diagnose", "identify", "read_loop", "remove", "report"]
    assert all(hasattr(st, name) for name in dir(st))
    names = {path.stem for path in (ROOT / "stictionid" / "api").glob("*.py")}
    assert not names & {name for name in dir(st) if name.islower()}


def spoilt(frame: pd.DataFrame) -> pd.DataFrame:
    """Rows out of order, twice, without a number, without a time, and a long gap."""
    stamps = pd.Timestamp("2026-03-04 08:00", tz="Europe/Berlin") + pd.to_timedelta(frame["time_s"], unit="s")
    rows = pd.DataFrame({"when": stamps, "FIC1.SP": frame["SP"], "FIC1.PV": frame["PV"], "FIC1.OP": frame["OP"]})
    rows = pd.concat([rows.iloc[:400], rows.iloc[430:]], ignore_index=True)
    rows.loc[100, "FIC1.PV"] = np.nan
    rows.loc[200, "when"] = pd.NaT
    rows = pd.concat([rows, rows.iloc[[300]]], ignore_index=True)
    return pd.concat([rows.iloc[50:], rows.iloc[:50]])


def test_curves_have_one_row_for_each_input_row(frame: pd.DataFrame) -> None:
    rows = spoilt(frame[:560])
    loop = st.Loop.from_dataframe(rows, time="when")
    assert loop.name == "FIC1" and len(loop.record.starts) == 2
    study = st.identify(loop, base_only=True, intervals=False)
    found = study.curves(loop)
    assert len(found) == len(rows) == 531
    assert found.index.equals(pd.Index(rows["when"])) and found.index.dtype == rows["when"].dtype
    unused = found.drop(columns=["model", "residual", "innovation"]).isna().all(axis=1).to_numpy()
    bad = rows["FIC1.PV"].isna() | rows["when"].isna()
    assert unused[bad].all() and unused.sum() == bad.sum() + 1  # one of the two equal rows is left out, too
    for column, name in (("process_value", "FIC1.PV"), ("output", "FIC1.OP"), ("setpoint", "FIC1.SP")):
        assert (found[column].to_numpy()[~unused] == rows[name].to_numpy()[~unused]).all()
    left = found["residual"].dropna()
    assert np.sqrt((left**2).mean()) == pytest.approx(study.steps[-1].error.rmse, rel=1e-6)
    assert np.allclose((found["process_value"] - found["model"]).dropna(), left)


def test_an_index_of_dates_and_a_step_are_times(frame: pd.DataFrame, loop: st.Loop) -> None:
    dated = frame.drop(columns="time_s").set_axis(pd.date_range("2026-01-01", periods=len(frame), freq="1s"))
    found = st.Loop.from_dataframe(dated)
    assert (found.process_value == loop.process_value).all() and found.record.origin.start == "2026-01-01T00:00:00"
    stepped = st.Loop.from_dataframe(frame.drop(columns="time_s"), step_s=2.0)
    assert stepped.step_s == 2.0 and stepped.samples == len(frame)


def test_a_numbered_column_and_a_tag_column_can_be_named(frame: pd.DataFrame) -> None:
    numbered = frame[["time_s", "PV", "OP"]].set_axis(["t", 7, 8], axis=1)
    found = st.Loop.from_dataframe(numbered, process_value=7, output=8, time="t", extra=())  # type: ignore[arg-type]
    assert found.setpoint is None and found.samples == len(frame)


def test_a_missing_column_is_named_with_those_there(frame: pd.DataFrame) -> None:
    with pytest.raises(UsageError, match="no column 'FLOW' for process_value") as caught:
        st.Loop.from_dataframe(frame, process_value="FLOW")
    assert "time_s, SP, PV, OP, ZT" in caught.value.__notes__[0]
    with pytest.raises(DataError, match="no time column") as caught:
        st.Loop.from_dataframe(frame.drop(columns="time_s"))
    assert "step_s" in caught.value.hint and "--" not in caught.value.hint


def test_a_dataframe_is_read_as_a_file_of_the_same_cells(frame: pd.DataFrame, loop: st.Loop) -> None:
    words = frame.astype({"PV": object})
    words.loc[5, "PV"] = "Bad"
    found = st.Loop.from_dataframe(words)
    assert not found.used[5] and found.used.sum() == len(frame) - 1
    assert [f.code for f in found.findings if "text" in f.code] == ["state-as-text"]
    for text in (frame.astype(str), frame.astype("string"), frame.astype(str).astype("category"),
                 frame.astype(str).apply(lambda column: column.str.replace(".", ","))):
        found = st.Loop.from_dataframe(text)
        assert (found.process_value == loop.process_value).all() and found.step_s == loop.step_s


def test_of_columns_with_one_name_the_number_chooses(frame: pd.DataFrame, loop: st.Loop) -> None:
    twice = pd.concat([frame[["time_s", "SP", "PV"]], -frame["PV"], frame["OP"]], axis=1)
    for name in (None, "PV"):
        with pytest.raises(DataError, match="'PV'") as caught:
            st.Loop.from_dataframe(twice, process_value=name)
        assert "process_value=3 or process_value=4" in caught.value.__notes__[0]
    found = st.Loop.from_dataframe(twice, process_value=4, time=1)  # type: ignore[arg-type]
    assert (found.process_value == -loop.process_value).all()
    assert found.rows is not None and found.rows.time.equals(frame["time_s"])


def test_a_constant_output_is_told_in_the_words_of_python(frame: pd.DataFrame) -> None:
    study = st.identify(frame.assign(OP=40.0))
    assert "with start and end" in study.verdict.reason and "--start" in study.record.verdict.reason


@pytest.mark.parametrize(("call", "said", "give"), [
    (lambda f: st.identify(f, law=3), "law is 3", "chen"),
    (lambda f: st.identify(f, seed="a"), "seed is 'a'", "seed=0"),
    (lambda f: st.identify(f, effects=3), "effects is 3", "extra-lag"),
    (lambda f: st.identify(f, plant=2), "plant is 2", "gain"),
    (lambda f: st.identify(f, scan_s="1 s"), "scan_s is '1 s'", "1.0"),
    (lambda f: st.identify(3), "int is no loop", "path"),
    (lambda f: st.diagnose("study.json"), "study is 'study.json'", "st.Study.load"),
    (lambda f: st.add(None, "extra-lag"), "study is None", "st.identify"),
    (lambda f: st.compare("a"), "study is 'a'", "load"),
    (lambda f: st.report(["a.json"], "a.html"), "study is 'a.json'", "load"),
    (lambda f: st.read_loop(3), "path is 3", "csv"),
    (lambda f: st.Loop.from_dataframe("a.csv"), "str is no DataFrame", "st.read_loop"),
    (lambda f: st.Loop.from_dataframe(f, step_s="a"), "step_s is 'a'", "step_s=1.0"),
    (lambda f: st.Loop.from_dataframe(f, extra=3), "extra is 3", "TI101")])
def test_an_argument_of_a_wrong_kind_is_a_usage_error(call: Any, said: str, give: str, frame: pd.DataFrame) -> None:
    with pytest.raises(UsageError, match=re.escape(said)) as caught:
        call(frame)
    assert give in caught.value.hint


def test_help_names_units_and_kinds_of_loops() -> None:
    for verb in (st.identify, st.diagnose, st.add, st.remove, st.compare):
        assert "Loop | pd.DataFrame | str" in str(inspect.signature(verb))
    text = inspect.getdoc(st.identify) or ""
    assert all(unit in text for unit in ("% of travel", "unit of PV per %", "in s"))


def test_times_with_a_zone_are_shown_in_it(frame: pd.DataFrame) -> None:
    for zone, offset in (("Europe/Berlin", "+01:00"), ("UTC", "+00:00")):
        index = pd.date_range("2026-03-04 08:00", periods=len(frame), freq="1s", tz=zone)
        shown = repr(st.Loop.from_dataframe(frame.drop(columns="time_s").set_axis(index)))
        assert f"from 2026-03-04T08:00:00{offset} ({zone})" in shown
    assert "from 2026-03-04T08:00:00 to" in repr(st.Loop.from_dataframe(
        frame.drop(columns="time_s").set_axis(index.tz_localize(None))))


@pytest.mark.parametrize("kind", ["good", "searched", "doubtful", "abstained", "hostile"])
def test_the_short_texts_are_short_and_safe(kind: str) -> None:
    record = getattr(study_factory, kind)().study
    study = st.Study(record)
    lines = repr(study).splitlines()
    assert 2 < len(lines) < 12 and max(map(len, lines)) <= 400 and str(study) == repr(study)
    assert record.verdict.stiction in lines[1]
    page = study._repr_html_()
    assert "<script" not in page and page.count("<div>") == 1
    assert st.Study(study_from_json(to_json(record))) == study
    assert len(study.candidates) == len(record.candidates) and len(study.tree) == len(record.tree)
    assert repr(study.tree) and len(study.summary()) >= 2


def test_the_tables_hold_the_numbers_of_the_record(study: st.Study) -> None:
    e = study.estimate
    assert e is not None and e.S_interval is not None
    table = study.summary()
    assert table.loc["S", ["value", "low", "high"]].tolist() == [e.S, *e.S_interval]
    assert table.loc["verdict", "value"] == "stiction" and "missing" not in table.index
    assert max(map(len, table.to_string().splitlines())) <= 80
    last = study.parameters.set_index("name")
    assert last.loc["time_constant_s", "value"] == e.time_constants_s[0] and last["effect"].isna().all()
    record = study_factory.searched().study
    assert candidates(record.candidates)["gain_beyond_noise"].tolist() == [c.gain_beyond_noise
                                                                           for c in record.candidates]


def test_a_study_is_frozen(study: st.Study) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        study.record = None  # type: ignore[misc,assignment]
    for thing, name in ((study, "verdict"), (study.plot, "fit"), (study.loop, "name")):
        with pytest.raises(dataclasses.FrozenInstanceError, match=f"cannot assign to field '{name}'"):
            setattr(thing, name, 1)


def test_the_verbs_return_new_studies(study: st.Study, half: st.Loop, tmp_path: Path) -> None:
    before = to_json(study.record)
    told: list[float] = []
    more = st.add(study, "extra-lag", half, progress=lambda text, share: told.append(share))
    assert [s.added for s in more.steps] == [None, "extra-lag"] and told
    assert more.summary().loc["effect", "value"] == "extra-lag" and "missing" not in more.summary().index
    less = st.remove(more, "extra-lag", half)
    assert less.steps[-1].effects == () and less.loop is half and more.steps[-1].effects == ("extra-lag",)
    with pytest.raises(UsageError, match="the model has no effect travel-limit"):
        st.remove(study, "travel-limit")
    assert st.diagnose(study).adequate and to_json(study.record) == before
    compared = st.compare(study, half)
    assert compared.adequate and not compared.record.validates and len(repr(compared).splitlines()) < 12
    assert len(compared.findings) == len(compared.record.findings)
    page = st.report([study, more], tmp_path / "loop.html").read_text()
    assert page.count("<article") == 2 and "<figure" in page
    assert more.plot.ladder().get_xlabel() == "error, m³/h"


def test_another_loop_is_refused_and_validates(study: st.Study) -> None:
    setting = dataclasses.replace(preset("foptd"), S=4.0, J=2.0, noise_sd=0.05, duration_s=500.0,
                                  controller=dataclasses.replace(preset("foptd").controller, scan_s=1.0))
    other = st.Loop(simulate(setting, seed=3).loop)
    for call in (study.curves, lambda o: st.diagnose(study, o), study.plot.fit):
        with pytest.raises(DataError, match="is not the record of the study"):
            call(other)
    assert st.compare(study, other).record.validates


def test_pictures_draw_on_the_axes_given_and_leave_no_state(study: st.Study, half: st.Loop) -> None:
    import matplotlib
    from matplotlib.figure import Figure

    before = dict(matplotlib.rcParams)
    for name in ("fit", "residual", "valve", "contributions"):
        ax = Figure().subplots()
        assert getattr(study.plot, name)(half, ax) is ax and ax.lines
    assert study.plot.cost_map().figure.axes and study.plot.residual().lines
    assert "0 %" in " ".join(line.get_label() for line in study.plot.contributions().lines)
    assert dict(matplotlib.rcParams) == before
    with pytest.raises(DataError, match="no added effect"):
        study.plot.ladder()
    code = ("import sys, stictionid as st\nfrom matplotlib.figure import Figure\n"
            f"st.Study.load({str(ROOT / 'tests/golden/study_schema_1.json')!r}).plot.cost_map()\n"
            "assert 'matplotlib.pyplot' not in sys.modules")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_parts_of_y_add_up(half: st.Loop, study: st.Study) -> None:
    from stictionid.model.parts import parts_of
    from stictionid.model.restore import rebuild_model

    parts = parts_of(*rebuild_model(half.record, study.steps[-1].model))
    assert sum(p.share for p in parts) == pytest.approx(1.0, abs=1e-9)
    total = sum(p.curve for p in parts)
    assert np.allclose(np.asarray(total)[60:], half.process_value[60:])
    left = next(p for p in parts if p.name == Share.NOISE)
    assert left.share == pytest.approx(study.steps[-1].error.rmse**2 / half.process_value.var(), rel=0.2)


def messages() -> Iterator[tuple[str, str]]:
    """Constant parts of every error that the package raises outside the command line."""
    for path in sorted((ROOT / "stictionid").rglob("*.py")):
        if path.relative_to(ROOT / "stictionid").parts[0] in ("cli", "batch", "__main__.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and re.fullmatch(r"(Usage|Data|Model)Error|CannotTell|Finding",
                                                           getattr(node.func, "id", "")):
                for part in ast.walk(node):
                    if isinstance(part, ast.Constant) and isinstance(part.value, str):
                        yield path.name, part.value


def test_no_message_of_the_package_names_a_flag_in_python() -> None:
    said = list(messages())
    flags = [text for _, text in said if re.search(r"--[a-z]", text)]
    assert len(flags) > 60
    assert [(name, in_python(text)) for name, text in said
            if re.search(r"(?<![\w-])--[a-z]| -o\b|stictionid (read|identify|diagnose|add|remove|compare|report)\b",
                         in_python(text))] == []
    assert in_python("give --step SECONDS, or --span-op 4,20 or --order 2; stictionid identify") \
        == "give step_s SECONDS, or span_op=(4, 20) or order=2; st.identify"


def test_blas_has_one_thread_unless_asked_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    # The BLAS of scipy is loaded by the first verb. Loaded here, it has two threads before, like that of numpy.
    import scipy.linalg.cython_blas  # noqa: F401

    def threads() -> set[int]:
        return {lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"}

    limited = one_thread(threads)
    with threadpool_limits(2, user_api="blas"):
        for name in ASKED:
            monkeypatch.delenv(name, raising=False)
        assert threads() == {2} and limited() == {1} and threads() == {2}
        monkeypatch.setenv("OMP_NUM_THREADS", "2")
        assert limited() == {2}


def test_a_bar_appears_in_a_notebook_after_a_second_and_goes() -> None:
    shown: list[object] = []

    class Handle:
        def update(self, content: dict[str, str], raw: bool) -> None:
            shown.append(content["text/plain"])

    def display(content: dict[str, str], raw: bool, display_id: bool) -> Handle:
        shown.append(content["text/plain"])
        return Handle()

    clock = iter([0.0, 0.5, 1.5, 1.6, 2.0, 3.0])
    bar = Bar(display, lambda: next(clock))
    for text, share in (("a", 0.1), ("b", 0.2), ("c", 0.3), ("d", 0.4), ("done", 1.0)):
        bar(text, share)
    assert shown == ["20 % b", "40 % d", ""]
    assert not isinstance(teller(None), Bar)


@pytest.mark.parametrize("page", ["README.md"])
def test_the_lines_of_a_page_run_as_written(page: str, frame: pd.DataFrame, tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch,
                                            capsys: pytest.CaptureFixture[str]) -> None:
    block = re.search(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)
    assert block and len(block[1].splitlines()) <= 10
    # A loop with no hidden effect is quick; the walk of the README finds the one of its loop.
    frame[:500].to_csv(tmp_path / "loop.csv", index=False)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    with identified_once():
        exec(block[1], names)
    assert names["found"].adequate and names["found"].missing == ()  # type: ignore[attr-defined]
    assert "stiction" in capsys.readouterr().out
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG") and "<figure" in Path("loop.html").read_text()
    assert st.Study.load("study.json") == names["found"]


def test_a_loop_gives_its_signals_as_a_frame_that_reads_to_the_same_loop(frame: pd.DataFrame, loop: st.Loop) -> None:
    found = loop.to_dataframe()
    assert found.index.name == "time_s" and len(found) == len(loop.output)
    assert found.index.to_numpy() == pytest.approx(frame["time_s"] - frame["time_s"][0])
    for column, name in (("setpoint", "SP"), ("process_value", "PV"), ("output", "OP")):
        np.testing.assert_array_equal(found[column], frame[name])
    again = st.Loop.from_dataframe(found.reset_index())
    for signal in ("setpoint", "process_value", "output"):
        np.testing.assert_array_equal(getattr(again, signal), getattr(loop, signal))


def test_a_frame_of_a_loop_keeps_its_gaps(frame: pd.DataFrame) -> None:
    loop = st.Loop.from_dataframe(spoilt(frame[:700]), time="when")
    found = loop.to_dataframe()
    assert found["process_value"].isna().any() or not loop.used.all()
    steps = np.diff(found.index.to_numpy())
    assert (steps > 1.5).sum() == len(loop.record.starts) - 1 and steps.min() > 0.0
