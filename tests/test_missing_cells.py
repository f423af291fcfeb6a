"""Records in which PV is missing in a pattern of rows beside a complete OP: read as they are, S and J as without gaps.

The whole table of patterns and loops is `benchmarks/missing_cells.py`.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import missing_cells
import numpy as np
import pytest
from quick_loops import asked_only

from stictionid.cli import main
from stictionid.fit.context import increment_error
from stictionid.fit.starts.basins import basins
from stictionid.historian import read, read_loop
from stictionid.model.closed_loop import simulate
from stictionid.model.segments import bind_model
from stictionid.model.spec import INTEGRATOR, Spec
from stictionid.numerics.autoregression import (
    autocovariance,
    autoregression,
    filter_residual,
    irreducible_error,
    link_samples,
    pace_of,
)
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import SAMPLES_PER_PERIOD, check
from stictionid.record.segments import chosen
from stictionid.record.write import write_loop
from stictionid.typing import BoolArray, FloatArray
from stictionid.verbs.identify import Options, identify

PATTERNS = tuple(missing_cells.patterns(20))
SETTING = replace(missing_cells.LOOPS["first-order"], duration_s=900.0)


@pytest.fixture(scope="module")
def loop() -> Loop:
    return simulate(SETTING, seed=4).loop


@pytest.fixture(scope="module")
def intact(loop: Loop, tmp_path_factory: pytest.TempPathFactory) -> missing_cells.Told:
    path = tmp_path_factory.mktemp("intact") / "none.csv"
    with asked_only("extra-lag"):
        return missing_cells.told(missing_cells.write(loop, np.zeros(loop.samples, bool), path))


def without(loop: Loop, pattern: str) -> Loop:
    gone = missing_cells.patterns(loop.samples)[pattern]
    return replace(loop, process_value=np.where(gone, np.nan, loop.process_value), used=~gone)


@pytest.mark.parametrize("suffix", ["csv", "tsv", "parquet"])
def test_a_loop_with_missing_pv_is_written_and_read_again(loop: Loop, suffix: str, tmp_path: Path) -> None:
    spoiled = without(loop, "blocks")
    write_loop(replace(spoiled, extras={"TI7": np.where(spoiled.used, 20.5, np.inf)}), tmp_path / f"loop.{suffix}")
    again = read_loop(tmp_path / f"loop.{suffix}")
    np.testing.assert_array_equal(again.process_value, spoiled.process_value)
    np.testing.assert_array_equal(again.output, spoiled.output)


def coloured(rows: int, root: float, seed: int = 0) -> FloatArray:
    out = np.random.default_rng(seed).standard_normal(rows)
    for k in range(1, rows):
        out[k] += root * out[k - 1]
    return out


# --- reading

@pytest.mark.parametrize("word", ["", "Bad"])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_pv_is_read_as_it_is_beside_op(loop, tmp_path, pattern, word):
    gone = missing_cells.patterns(loop.samples)[pattern]
    reading = read(missing_cells.write(loop, gone, tmp_path / "a.csv", word))
    there = np.flatnonzero(~gone)
    inside = slice(there[0], there[-1] + 1)
    assert reading.loop.starts == (0,) and reading.loop.step_s == loop.step_s
    np.testing.assert_array_equal(reading.loop.output, loop.output[inside])
    np.testing.assert_array_equal(reading.loop.used, ~gone[inside])
    np.testing.assert_array_equal(reading.loop.process_value[reading.loop.used], loop.process_value[there])
    assert reading.rows["in"] == sum(v for k, v in reading.rows.items() if k != "in") == loop.samples
    codes = {f.code for f in reading.findings}
    assert not codes & {"compressed", "averaged", "coarse-process-value", "gaps"}
    if gone[inside].any():
        assert reading.samples["total"] - reading.samples["used"] == gone[inside].sum()
        assert codes & {"process-value-missing", "filled-samples"}


def test_a_slower_pv_keeps_the_stamps_of_op(loop, tmp_path):
    """One tag after the other, PV every third second, OP every second."""
    lines = ["Tag,Time,Value"]
    for k in range(loop.samples):
        stamp = f"2024-05-31 {k // 3600 + 14:02d}:{k // 60 % 60:02d}:{k % 60:02d}"
        lines += [f"FIC1.PV,{stamp},{float(loop.process_value[k])!r}"] if k % 3 == 0 else []
        lines += [f"FIC1.SP,{stamp},{float(loop.setpoint[k])!r}", f"FIC1.OP,{stamp},{float(loop.output[k])!r}"]
    path = tmp_path / "long.csv"
    path.write_text("\n".join(lines) + "\n")
    reading = read(path)
    assert reading.loop.step_s == 1.0 and reading.loop.samples == loop.samples - (loop.samples - 1) % 3
    np.testing.assert_array_equal(np.flatnonzero(reading.loop.used) % 3, 0)
    np.testing.assert_array_equal(reading.loop.process_value[::3], loop.process_value[:reading.loop.samples:3])
    assert "resampled" not in reading.rows


def test_a_cleaned_record_reads_as_it_was(loop, tmp_path):
    from stictionid.historian.checks.clean import write_clean

    reading = read(missing_cells.write(loop, missing_cells.patterns(loop.samples)["two-of-3"], tmp_path / "a.csv"))
    write_clean(reading, str(tmp_path / "clean.csv"))
    again = read_loop(tmp_path / "clean.csv")
    for name in ("output", "process_value", "used", "driven", "setpoint"):
        np.testing.assert_array_equal(getattr(again, name), getattr(reading.loop, name))


# --- the noise from one PV to the next

def test_no_links_without_a_gap_and_none_across_a_long_one():
    good = np.ones(100, bool)
    good[:7] = False
    assert link_samples(good) is None and pace_of(good) == 1.0
    good[40:80] = False
    links = link_samples(good)
    assert links is not None and links.pace == 1.0 and links.before[80] == -1 and links.before[81] == 80
    assert link_samples(np.r_[good[:40], good[80:]], (0, 40)) is None


@pytest.mark.parametrize("k", [2, 3, 10])
def test_a_regular_pattern_has_the_noise_of_the_decimated_record(k):
    noise, good = coloured(4000, 0.9), np.arange(4000) % k == 1
    few = noise[good]
    np.testing.assert_allclose(autocovariance(np.where(good, noise, np.nan), good, 6),
                               autocovariance(few, np.ones(few.size, bool), 6))
    assert pace_of(good) == k
    taps = autoregression(noise, good, 8)
    assert taps[0] == pytest.approx(-(0.9**k), abs=0.06)
    polynomial = np.concatenate([[1.0], taps])
    white, sure = filter_residual(np.where(good, noise, np.nan), good, polynomial)
    np.testing.assert_allclose(white[sure], np.convolve(few, polynomial)[taps.size:few.size])
    assert not sure[~good].any() and sure.sum() == few.size - taps.size


def test_the_floor_of_a_decimated_record_and_none_where_pv_has_no_rule():
    rng = np.random.default_rng(1)
    position = np.repeat(rng.standard_normal(500), 8)
    y = np.zeros(4000)
    for k in range(1, 4000):
        y[k] = 0.9 * y[k - 1] + 0.1 * position[k - 1]
    y += 0.01 * rng.standard_normal(y.size)
    whole = irreducible_error(y, position, np.ones(y.size, bool), 0)
    assert whole == pytest.approx(0.01, rel=0.1)
    for k in (2, 3, 5):
        assert irreducible_error(y, position, np.arange(y.size) % k > 0, 0) == pytest.approx(whole, rel=0.1)
        assert irreducible_error(y, position, np.arange(y.size) % k == 0, 0) == pytest.approx(whole, rel=0.1)
    assert irreducible_error(y, position, rng.random(y.size) < 0.4, 0) is None


@pytest.mark.parametrize("pattern", PATTERNS)
def test_models_have_a_cost_and_a_noise_on_every_pattern(loop, pattern):
    """Changes of y and an autoregression need one PV after another, which no row of most patterns has."""
    piece = without(loop, pattern)
    for spec in (Spec(), Spec(taps=(-1.1, 0.3)), Spec(process=INTEGRATOR, increments=True, taps=(-0.2,))):
        model = bind_model(piece, spec, s_max=8.0, period_s=130.0)
        values = model.values(np.full((1, model.space.size), 0.5))
        e = model.evaluate(values[:, 0])
        assert model.weight.sum() > 0.8 * (piece.used.sum() - model.skip)
        assert np.isfinite(e.sse) and e.sse == pytest.approx(model.costs_of(values)[0], rel=1e-2)
        assert increment_error(e) > 0.0
        assert np.isfinite(autoregression(np.nan_to_num(e.residual), e.counted > 0, 8)).all()


@pytest.mark.parametrize("pattern", ["every-2nd", "4-of-5", "random-half"])
def test_the_valve_is_found_before_the_process(loop, pattern):
    """No difference equation goes from one PV to the next; the right basin is among the starts all the same."""
    model = bind_model(without(loop, pattern), Spec(), s_max=find_range(loop).s_max, period_s=130.0)
    S = model.values(basins(model, np.random.default_rng(0)))[0]
    assert np.abs(S - SETTING.S).min() < 0.05 * SETTING.S


# --- answers

@pytest.mark.parametrize("pattern", ["blocks"])
def test_the_answer_is_that_of_the_intact_record(loop, intact, tmp_path, pattern):
    file = missing_cells.write(loop, missing_cells.patterns(loop.samples)[pattern], tmp_path / "a.csv", "Bad")
    with asked_only("extra-lag"):
        found = missing_cells.told(file)
    assert found.study is not None and found.study.estimate is not None, found.reason
    assert found.passes(intact), found.against(intact)
    assert found.study.verdict.stiction == "stiction"


def test_too_few_pv_in_a_period_is_said_as_it_is(loop, tmp_path):
    path = missing_cells.write(loop, missing_cells.patterns(loop.samples)["19-of-20"], tmp_path / "a.csv")
    study = identify(read_loop(path))
    assert study.estimate is None and study.verdict.evidence.code == "too-slow-sampling"
    said = re.search(r"only every 20 s: that is ([\d.]+) samples in a period of ([\d.]+) s", study.verdict.reason)
    assert said is not None, study.verdict.reason
    per, period = map(float, said.groups())
    assert per < SAMPLES_PER_PERIOD and per == pytest.approx(period / 20.0, abs=0.05)
    whole = find_range(loop).period_median_s
    assert whole is not None and 0.5 < period / whole < 2.0


@pytest.mark.parametrize("method", ["arx", "jelali", "one-parameter", "polynomial"])
def test_a_difference_equation_says_what_it_lacks(loop, tmp_path, method):
    path = missing_cells.write(loop, missing_cells.patterns(loop.samples)["every-2nd"], tmp_path / "a.csv")
    study = identify(read_loop(path), options=Options(method=method))
    assert study.estimate is None and study.verdict.evidence.code == "pv-too-sparse"
    assert "only 0 samples" in study.verdict.reason and "--method auto" in study.verdict.reason


def test_a_stretch_without_pv_is_run_through_and_one_in_manual_is_not(loop):
    period = find_range(loop).period_median_s
    assert period is not None
    gone = np.zeros(loop.samples, bool)
    gone[300:300 + int(1.2 * period)] = True
    manual = replace(loop, used=~gone)
    missed = replace(manual, process_value=np.where(gone, np.nan, loop.process_value))
    assert chosen(missed)[0].starts == (0,)
    assert len(chosen(manual)[0].starts) == 2
    check(missed, find_range(missed))


# --- commands

def command(*arguments: object, monkeypatch: pytest.MonkeyPatch) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    monkeypatch.setattr(sys, "argv", ["stictionid", *map(str, arguments)])
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main()
    assert "Traceback" not in err.getvalue(), err.getvalue()
    return int(ended.value.code or 0), out.getvalue(), err.getvalue()


def masked_file(loop: Loop, gone: BoolArray, path: Path) -> Path:
    return missing_cells.write(loop, gone, path, "Bad")


@pytest.mark.parametrize(("pattern", "code"), [("19-of-20", 3)])
def test_the_main_road_of_commands(loop, tmp_path, monkeypatch, pattern, code):
    """A record with one PV of three, which has an answer, is in benchmarks/long."""
    file = masked_file(loop, missing_cells.patterns(loop.samples)[pattern], tmp_path / "a.csv")
    study = tmp_path / "study.json"
    assert command("identify", file, "--base-only", "--no-intervals", "-o", study, monkeypatch=monkeypatch)[0] == code
    assert command("diagnose", study, file, "--apply", "--budget", 5_000, monkeypatch=monkeypatch)[0] == code
    compared = command("compare", study, file, "--json", monkeypatch=monkeypatch)
    assert compared[0] == code and (code or json.loads(compared[1])["adequate"])
    assert command("report", study, "-o", tmp_path / "a.html", monkeypatch=monkeypatch)[0] == 0
    assert command("range", file, monkeypatch=monkeypatch)[0] == 0


def test_the_benchmark_counts_answers_inside_the_intact_interval(intact) -> None:
    e, known = intact.study.estimate, replace(SETTING, S=intact.study.estimate.S, J=2.0 * intact.study.estimate.J)
    assert intact.within(intact, known) == ([1.0, 1.0], [1.0, 1.0], [1.0, 1.0], [1.0, 0.0])
    half = 0.5 * (e.S_interval[1] - e.S_interval[0])
    far = replace(e, S=2.0 * e.S, S_interval=(2.0 * e.S - np.sqrt(2.0) * half, 2.0 * e.S + np.sqrt(2.0) * half))
    moved = replace(intact, study=replace(intact.study, estimate=far))
    # Twice the variance: the two differ by an error as large as the intact one's, of which 90 % is in its interval.
    assert moved.within(intact, known) == ([0.0, 1.0], [pytest.approx(0.9, abs=1e-3), 1.0], [0.0, 1.0], [0.0, 0.0])
    assert replace(intact, study=replace(intact.study, estimate=None)).within(intact, known) is None
