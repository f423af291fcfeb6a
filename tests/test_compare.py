"""Compare: clean loops show no fault, faults show where they are, a second record validates the model of the first.

Coloured noise, which is no fault, is in benchmarks/long.
"""

from __future__ import annotations

import json
from dataclasses import replace
from html import escape
from pathlib import Path

import commands
import numpy as np
import pytest
import study_factory
from quick_loops import PLAIN

from stictionid.comparison import compare
from stictionid.comparison.cells import split
from stictionid.comparison.model_run import correlation_of, prepare
from stictionid.comparison.side_by_side import side_by_side
from stictionid.comparison.validate import transferred
from stictionid.errors import DataError
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.segments import bind_model
from stictionid.model.spec import Spec
from stictionid.numerics.autoregression import chi_square_z
from stictionid.record.loop import Loop
from stictionid.reports.pages.comparison import MOST_SUSPECTS, rows_of, sentences, write_beside, write_comparison
from stictionid.reports.pictures.comparison_pictures import comparison_pictures, overview
from stictionid.verbs.identify import identify

MOVES = ((0.0, 3.0), (200.0, -4.0), (450.0, 5.0), (700.0, -3.0))


def setting(**more) -> Setting:
    base = Setting(Plant(2.0, 6.0, 3.0), Controller(0.15, 6.0, scan_s=1.0), S=4.0, J=2.5, duration_s=900.0,
                   setpoint_moves=MOVES, noise_sd=0.06)
    return replace(base, **more)


@pytest.fixture(scope="module")
def clean():
    loop = simulate(setting(), seed=11).loop
    return loop, identify(loop, options=PLAIN)


@pytest.fixture(scope="module")
def stepped():
    loop = simulate(setting(effects=(("travel-limit", {"upper": 51.5}),)), seed=12).loop
    return loop, identify(loop, options=PLAIN)


def test_errors_are_called_dependent_only_where_they_are(clean) -> None:
    found = compare(*clean)
    for share, hang in ((1.0, False), (0.5, True)):
        made = replace(found, error=replace(found.error, effective_rows=share * found.error.rows))
        assert ("hang together" in " ".join(sentences(made))) == hang
        assert ("as good as independent ones" in dict(rows_of(made))) == hang


def test_a_clean_loop_shows_no_fault_and_its_errors_agree(clean) -> None:
    found = compare(*clean)
    assert found.adequate and found.findings == ()
    assert found.error.rmse == pytest.approx(0.06, rel=0.06)
    assert found.error.rmse_one_step == pytest.approx(found.error.rmse)
    assert found.error.skill is not None and 0.5 < found.error.skill < 1.0
    assert {"time", "phase", "direction", "output", "value", "cycle", "setpoint"} <= set(found.tables)
    for cells in found.tables.values():
        assert sum(c.share for c in cells) <= 1.0 + 1e-9 and not any(c.fails for c in cells)


def test_a_second_record_validates_and_a_different_valve_does_not(clean) -> None:
    loop, study = clean
    again = compare(loop, study, simulate(setting(), seed=99).loop)
    assert again.validates and again.adequate and again.error.rmse < 1.5 * 0.06
    assert {f.code for f in again.notes} == {"validated"} and again.error.rmse_holdout is None
    other = compare(loop, study, simulate(setting(S=5.5), seed=98).loop)
    assert not other.adequate and other.error.rmse > 2.0 * again.error.rmse
    assert other.ground.evaluated.values["S"] == again.ground.evaluated.values["S"]


def test_what_belongs_to_the_record_is_refitted_and_what_belongs_to_the_plant_is_held() -> None:
    wave, step = "sinusoidal-disturbance", "step-disturbance@output"

    def record(phase: float, amplitude: float, *, size: float = 0.0, time_s: float = 1.0) -> Loop:
        return simulate(setting(effects=((wave, {"period_s": 37.0, "amplitude": amplitude, "phase": phase}),
                                         ("step-disturbance", {"time_s": time_s, "size": size}))), seed=5).loop

    first = record(0.0, 1.0, size=1.5, time_s=300.0)
    model = bind_model(first, Spec(effects=(wave, step), between="hold"), s_max=8.0, period_s=40.0)
    force = (first.output[0] - 50.0) / 3.25  # the valve begins at rest, loaded by the first command
    values = model.vector({"S": 4.0, "J": 2.5, "initial_residual_force": force, "time_constant_s": 6.0,
                           "dead_time_s": 3.0, f"{wave}:period_s": 37.0, f"{step}:time_s": 300.0})
    assert model.evaluate(values).rmse < 0.08
    description = model.describe(values)
    moved, evaluated, notes = transferred(record(2.0, 1.0, size=1.5, time_s=610.0), description, first)
    assert evaluated.rmse < 0.08 and moved.named(values)[f"{wave}:period_s"] == 37.0
    assert "phase of sinusoidal-disturbance" in notes[-1].statement and "time_s of step" in notes[-1].statement
    # A step that the other record does not have is left out; a wave of another size is said.
    gone, evaluated, notes = transferred(record(2.0, 2.0), description, first)
    assert gone.spec.effects == (wave,) and evaluated.rmse < 0.08
    assert {"left-out", "validated", "other-size"} == {n.code for n in notes}


def test_an_abstained_study_is_refused() -> None:
    dead = Loop(output=np.full(300, 40.0), process_value=np.random.default_rng(0).standard_normal(300))
    with pytest.raises(DataError):
        compare(dead, identify(dead))


def test_the_correlation_of_an_autoregression_is_the_known_one() -> None:
    np.testing.assert_allclose(correlation_of(np.array([-0.8]), 6), 0.8 ** np.arange(7), atol=1e-9)
    assert correlation_of(np.empty(0), 3).tolist() == [1.0, 0.0, 0.0, 0.0]


def test_z_values_of_white_noise_are_those_of_chance(clean) -> None:
    """Random cells of a clean residual: z values with mean 0 and spread 1, or thresholds mean nothing."""
    loop, study = clean
    ground = compare(loop, study).ground
    ground = prepare(ground.loop, ground.model, ground.found, ground.evaluated)
    rng = np.random.default_rng(0)
    cells = [split(ground, {"part": rng.random(loop.samples) < 0.2})[0] for _ in range(300)]
    for name in ("z_energy", "z_mean", "z_one_step"):
        z = np.array([getattr(c, name) for c in cells])
        assert abs(z.mean()) < 0.25 and 0.6 < z.std() < 1.3, name
    draws = rng.chisquare(20, 4000)
    assert np.mean([chi_square_z(x, 20) > 2.326 for x in draws]) == pytest.approx(0.01, abs=0.006)


def test_a_fault_shows_where_it_is(stepped) -> None:
    found = compare(*stepped)
    assert not found.adequate
    by_code = {f.code: f for f in found.findings}
    for f in found.findings:
        assert f.statement and f.suggests and f.evidence and any(c.isdigit() for c in f.statement)
    assert "travel-limit" in by_code["error-by-output"].suggests or "travel-limit" in by_code["error-by-value"].suggests
    worst = max(found.tables["value"], key=lambda c: c.rms)
    assert worst.fails and worst.energy_share > 2.0 * worst.share


def test_pictures_and_pages_are_written_whole(stepped, tmp_path: Path) -> None:
    found = compare(*stepped)
    drawn = comparison_pictures(found)
    assert {"fit", "by_time", "by_phase", "by_output", "over_cycle", "over_op", "correlation"} <= set(drawn)
    assert all(p.alt and p.caption for p in drawn.values())
    page = write_comparison(found, "a <loop>", tmp_path / "c.html")
    text = page[0].read_text()
    assert text.count("<details>") == len(drawn) - 1 and "a &lt;loop&gt;" in text and "<loop>" not in text
    # The picture that the reader came for stands open, before the suspects and every fold.
    assert text.index(escape(drawn["fit"].title)) < text.index('class="pic desk"') < text.index('id="who"')
    assert text.index('id="who"') < text.index("<details>") and f"<summary>{drawn['fit'].title}" not in text
    square = len(overview(found)) + sum(not p.wide for p in drawn.values())
    wide = sum(p.wide for p in drawn.values())
    assert text.count('class="pic"') == square + 1
    assert text.count('class="pic desk"') == text.count('class="pic phone"') == wide > 0
    # Other effects are suspected in benchmarks/long.
    assert "travel-limit" in [s.effect for s in found.suspects[:2]]
    assert found.suspects[0].gain_expected and "% of the" in found.suspects[0].speaks_for
    assert all(f"<b>{s.effect}</b>" in text for s in found.suspects[:MOST_SUSPECTS])
    written = write_comparison(found, "a loop", tmp_path / "c.md")
    assert len(written) == len(drawn) + 1 and all(p.stat().st_size for p in written)


def test_the_command_prints_findings_json_and_series(clean, tmp_path: Path) -> None:
    def run(*arguments: object):
        return commands.run(*arguments, cwd=tmp_path)

    made = run("simulate", "--preset", "foptd", "--S", 4, "--J", 2, "--noise", 0.05, "--scan", 1, "-o", "a.csv")
    assert made.returncode == 0, made.stderr
    assert run("identify", "a.csv", "--base-only", "-o", "s.json").returncode == 0
    shown = run("compare", "s.json", "-o", "c.md")
    assert shown.returncode == 0 and "free-run error" in shown.stdout and (tmp_path / "c.md").is_file()
    assert max(map(len, shown.stdout.splitlines())) <= 80
    result = json.loads(run("compare", "s.json", "--json", "--series").stdout)
    assert {"error", "findings", "adequate", "adequate_reason", "series"} <= set(result)
    assert len(result["series"]["residual"]) == 1000
    assert json.loads(run("compare", "s.json", "--json").stdout)["series"] is None
    for arguments, code in ((("compare", "s.json", "gone.csv"), 2), (("compare", "s.json", "-o", "c.txt"), 2),
                            (("compare", "a.csv"), 3)):
        refused = run(*arguments)
        assert refused.returncode == code and "Traceback" not in refused.stderr and refused.stdout == ""


def test_two_studies_stand_side_by_side(tmp_path: Path) -> None:
    good, worse = study_factory.good(), study_factory.good()
    worse = replace(worse, study=replace(worse.study, steps=worse.study.steps[:1]), curves=worse.curves[:1])
    found = side_by_side(worse.study, good.study)
    assert found.same_record and found.better == 1 and "second model explains the record better" in found.statement
    lag = next(p for p in found.parameters if p.effect == "extra-lag")
    assert lag.values == (None, 2.11) and lag.agree is None
    assert all(p.agree for p in found.parameters if p.name in ("S", "J"))
    other = replace(good.study, data=replace(good.study.data, sha256="0" * 64), steps=tuple(
        replace(s, parameters=tuple(replace(p, value=9.0, interval=(8.9, 9.1)) for p in s.parameters))
        for s in good.study.steps))
    found = side_by_side(good.study, other)
    assert not found.same_record and found.better is None and "S, J" in found.statement
    write_beside((worse, good), side_by_side(worse.study, good.study), tmp_path / "b.html")
    page = (tmp_path / "b.html").read_text(encoding="utf-8")
    assert "second model explains the record better" in page and page.count("<table>") == 2 and "<figure" in page
    write_beside((worse, good), found, tmp_path / "b.md")
    assert "| S | 5.012 (4.961 to 5.058) | 9.000 (8.900 to 9.100) | % | differ |" in (tmp_path / "b.md").read_text()
