"""The methods side by side: each on loops with known answers, its limits, ranking of laws, step tests.

Laws ranked on the command line, and a step test as the fixed plant, are in benchmarks/long.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import naive_methods as naive
import numpy as np
import pytest
from commands import run
from quick_loops import asked_only
from real_nodes import PERIOD_S, SAMPLES, model_on, recorded, true_values

import stictionid.methods as method_room
from stictionid.errors import DataError, UsageError
from stictionid.fit.context import Run
from stictionid.fit.points.fitted import as_it_stands
from stictionid.methods import catalogue
from stictionid.methods.contract import SPELLING
from stictionid.methods.option_check import check_options
from stictionid.model.closed_loop import preset, simulate, with_stiction
from stictionid.model.restore import rerun
from stictionid.model.spec import Spec
from stictionid.numerics.armax import Regression, armax, stabilise_polynomial
from stictionid.numerics.ellipse import fit_ellipse
from stictionid.process.step_test import fit_step
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.study import study_from_json, to_json
from stictionid.record.write import write_loop
from stictionid.verbs.identify import Options, identify
from stictionid.verdict.law_ranking import rank

S, J = 4.0, 2.5


def loop_of(law: str = "chen", noise: float = 0.03, J: float = J) -> Loop:
    """A scanned first-order loop with setpoint moves: every method has something to work with."""
    base = with_stiction(preset("foptd"), S, J)
    return simulate(replace(base, law=law, noise_sd=noise, duration_s=600,
                            controller=replace(base.controller, scan_s=1.0),
                            setpoint_moves=((0.0, 5.0), (250.0, -6.0), (430.0, 4.0))), seed=3).loop


@pytest.fixture(scope="module")
def loop() -> Loop:
    return loop_of()


# --- the catalogue


@pytest.mark.parametrize("name", catalogue())
def test_every_method_says_what_it_does_and_what_it_cannot(name: str) -> None:
    method = catalogue()[name]
    assert method.name == name and method.options <= set(SPELLING) and set(method.gives) <= {"S", "J"}
    assert all((method.summary, method.equation, method.source, method.checked, method.cannot))


@asked_only("extra-lag")
@pytest.mark.parametrize("name", catalogue())
def test_every_method_gives_a_study_that_survives_json_and_is_the_same_for_a_seed(name: str, loop: Loop) -> None:
    study = identify(loop, options=Options(method=name))
    assert study_from_json(to_json(study)) == study
    assert to_json(identify(loop, options=Options(method=name))) == to_json(study)
    assert study.verdict.reason
    if study.estimate is not None:
        curves = rerun(loop, study.steps[-1].model)
        error = float(np.sqrt(np.mean(curves.residual[50:] ** 2)))
        assert error == pytest.approx(study.steps[-1].error.rmse, rel=0.1)


def test_a_new_method_is_one_new_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loop: Loop) -> None:
    (tmp_path / "guess.py").write_text(
        "from stictionid.methods.contract import Method, Outcome\n"
        "def _run(run):\n"
        "    fit = run.with_valve(4.0, 2.5)\n"
        "    return Outcome((run.step(fit, None),), (fit,))\n"
        "METHOD = Method(name='guess', summary='s', equation='e', source='s', checked='c', cannot='c', run=_run,\n"
        "                options=frozenset())\n")
    monkeypatch.setattr(method_room, "__path__", [*method_room.__path__, str(tmp_path)])
    assert "guess" in catalogue()
    estimate = identify(loop, options=Options(method="guess")).estimate
    assert estimate is not None and (estimate.S, estimate.J) == (4.0, 2.5)
    assert estimate.gain == pytest.approx(3.0, rel=0.02) and estimate.dead_time_s == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize(("options", "said"), [
    (Options(method="auto", order=2), "--order"), (Options(method="auto", delay=3), "--delay"),
    (Options(method="ellipse", order=2), "--order"), (Options(method="one-parameter", law="kano"), "--law kano"),
    (Options(method="one-parameter", law="all"), "--law all"), (Options(method="arx", base_only=True), "--base-only"),
    (Options(method="arx", effects=("extra-lag",)), "--with"), (Options(method="jelali", between="hold"), "--between"),
    (Options(method="polynomial", fixed={"gain": 3.0}), "fixed plant"), (Options(law="karnopp"), "simulates only"),
    (Options(method="elipse"), "elipse"),
])
def test_options_that_do_not_apply_are_refused_with_a_sentence(options: Options, said: str) -> None:
    with pytest.raises(UsageError) as refusal:
        check_options(options)
    assert said in refusal.value.message and refusal.value.hint


# --- each method


def after_a_jump(loop: Loop) -> Loop:
    """The record from the sample after the first jump: u_v(0) = u(0) holds there for a valve with f_d = 0."""
    jump = int(np.flatnonzero(np.abs(np.diff(loop.position)) > 1.0)[0]) + 1
    return loop.cut(jump, loop.samples)


def test_one_parameter_finds_a_valve_with_one_parameter() -> None:
    e = identify(after_a_jump(loop_of("stenman")), options=Options(method="one-parameter")).estimate
    assert e is not None and e.law == "stenman" and e.J == e.S and pytest.approx(S, rel=0.03) == e.S


def test_jelali_finds_stickband_and_jump_where_its_start_is_right() -> None:
    study = identify(after_a_jump(loop_of("he", noise=0.0, J=S)), options=Options(method="jelali", law="he"))
    e = study.estimate
    assert e is not None and pytest.approx(S, rel=0.08) == e.S and pytest.approx(S, rel=0.05) == e.J
    assert {"relay", "ellipse"} == set(study.steps[-1].model["start"]["guesses"])


def test_the_ellipse_gives_a_stickband_and_says_that_it_gives_no_jump() -> None:
    truth = with_stiction(preset("foptd"), 5.0, 3.0)
    study = identify(simulate(truth).loop, options=Options(method="ellipse"))
    e = study.estimate
    assert e is not None and pytest.approx(5.0, rel=0.1) == e.S
    assert e.J == 0.0 and e.J_interval == (0.0, e.S)
    assert [f.code for f in study.steps[-1].findings] == ["jump-not-given"]
    assert not next(p for p in study.steps[-1].parameters if p.name == "J").identifiable


def test_the_ellipse_needs_an_oscillation() -> None:
    moves = tuple((60.0 * k, (-1.0) ** k * 4.0) for k in range(10))
    base = with_stiction(preset("foptd"), 0.5, 0.0)
    still = simulate(replace(base, setpoint_moves=(*moves, (620.0, 2.0)), duration_s=700), seed=1).loop
    short = replace(still.cut(0, 150), setpoint=None)
    study = identify(short, options=Options(method="ellipse"))
    assert study.estimate is None and study.verdict.stiction == "undecided"


def test_the_polynomial_cannot_see_stiction_and_shows_why() -> None:
    study = identify(simulate(with_stiction(preset("foptd"), 5.0, 3.0)).loop, options=Options(method="polynomial"))
    seen = study.verdict.evidence.further
    assert study.estimate is None and study.verdict.stiction == "undecided" and "no memory" in study.verdict.reason
    assert seen["rmse_sticking"] < 0.3 * seen["rmse_polynomial"]
    assert seen["rmse_polynomial"] <= seen["rmse_straight_line"] * 1.001
    assert len(seen["gamma"]) == 3


# --- ellipse and ARMAX


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2, 2.9])
def test_ellipse_against_its_twin_on_an_exact_ellipse(angle: float) -> None:
    t, m, n = np.linspace(0.0, 6.0, 40), 3.0, 0.8
    x = 52.0 + m * np.cos(t) * np.cos(angle) - n * np.sin(t) * np.sin(angle)
    y = -7.0 + 100.0 * (m * np.cos(t) * np.sin(angle) + n * np.sin(t) * np.cos(angle))
    found = fit_ellipse(x, y)
    assert found is not None
    printed = 2 * m * n / np.sqrt(m**2 * np.sin(angle) ** 2 + n**2 * np.cos(angle) ** 2)
    centred = naive.chord_along_x(naive.conic_through(x - 52.0, (y + 7.0) / 100.0))
    assert found.width == pytest.approx(printed, rel=1e-6) and found.width == pytest.approx(centred, rel=1e-6)
    assert found.centre == pytest.approx((52.0, -7.0), rel=1e-6)
    assert found.extent == pytest.approx(2 * np.hypot(m * np.cos(angle), n * np.sin(angle)), rel=1e-6)


def test_points_that_make_no_ellipse() -> None:
    x = np.linspace(0.0, 1.0, 20)
    assert fit_ellipse(x, 2.0 * x + 1.0) is None
    assert fit_ellipse(x, np.full(20, 3.0)) is None
    assert fit_ellipse(x[:4], x[:4] ** 2) is None


A, B, C, DELAY = np.array([-1.5, 0.56]), np.array([0.5, 0.3]), np.array([0.7]), 3


def armax_record(seed: int, n: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = np.repeat(rng.standard_normal(n // 20), 20)
    return naive.simulate_armax(A, B, C, DELAY, x, 0.3 * rng.standard_normal(n)), x


def test_armax_recovers_its_noise_polynomial() -> None:
    errors = []
    for seed in range(8):
        y, x = armax_record(seed)
        fit = armax(Regression(y, x), order=2, delay=DELAY, noise_order=1)
        errors.append((fit.c[0] - C[0], *(fit.a - A), *(fit.b[:, 0] - B)))
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02 and np.abs(errors).max() < 0.08


def test_armax_errors_are_those_of_its_twin_and_a_gap_changes_little() -> None:
    y, x = armax_record(1)
    fit = armax(Regression(y, x), order=2, delay=DELAY, noise_order=1)
    first = y.size - fit.rows
    twin = naive.one_step_errors(y, x, fit.a, fit.b[:, 0], fit.c, fit.constant, DELAY, first)
    assert np.abs(twin - fit.residual).max() < 1e-9 and fit.sse == pytest.approx(float(twin @ twin))
    good = np.ones(y.size, bool)
    good[400:430] = False
    y = y.copy()
    y[400:430] = 1e6
    holey = armax(Regression(y, x, good=good), order=2, delay=DELAY, noise_order=1)
    assert holey.c == pytest.approx(fit.c, abs=0.05) and holey.a == pytest.approx(fit.a, abs=0.02)


def test_armax_chooses_its_order_and_delay() -> None:
    y, x = armax_record(2)
    regression = Regression(y, x)
    fits = [armax(regression, order=n, delay=d, first=20) for n in (1, 2) for d in (1, 2, 3, 4)]
    best = min(fits, key=lambda f: f.aic)
    assert (best.a.size, best.delay) == (2, DELAY)


def test_a_noise_polynomial_outside_the_unit_circle_is_mirrored() -> None:
    assert stabilise_polynomial(np.array([2.0])) == pytest.approx([0.5])
    assert stabilise_polynomial(np.array([0.5])) == pytest.approx([0.5])
    assert np.abs(np.roots([1.0, *stabilise_polynomial(np.array([-2.5, 1.0]))])).max() <= 0.98


# --- all laws


def test_laws_are_alike_where_the_signed_ranks_of_the_twin_show_no_difference() -> None:
    """Two models of one record, the second with another stickband; squared errors are compared in quarter periods."""
    record, alike = recorded(4.0 * np.random.default_rng(0).standard_normal(SAMPLES)), []
    model = model_on(record, Spec())
    context = Run(record, find_range(record), Options(), law="chen", rng=np.random.default_rng(0),
                  tell=lambda text, share: None)
    for S in (2.4, 3.4, 3.8, 4.0, 5.0):
        fits = [as_it_stands(model, model.vector(true_values() | more)) for more in ({}, {"S": S})]
        errors = [fit.best.rmse for fit in fits]
        assert errors[1] > 1.02 * errors[0]  # (laws within a hundredth are alike whatever the test says)
        difference = fits[1].best.residual ** 2 - fits[0].best.residual ** 2
        counted = fits[0].best.counted > 0
        blocks = [(difference[k:k + 15], counted[k:k + 15]) for k in range(0, SAMPLES, 15)]
        means = np.array([d[c].sum() / c.sum() for d, c in blocks if c.any()])
        errors_of_sum = np.sqrt(means.size * (means.size + 1) * (2 * means.size + 1) / 6)
        said = bool(abs(naive.signed_rank_sum(means)) < 1.96 * errors_of_sum)
        named = zip(("chen", "he"), fits, strict=True)
        ranking = rank({name: (context.step(fit, None), fit) for name, fit in named}, period=int(PERIOD_S))
        assert (ranking.alike == ("chen", "he")) is said
        alike.append(said)
    assert set(alike) == {True, False}


def ranks(folder: Path, laws: set[str]) -> None:
    """The command ranks these laws on a record of He's, and says what it kept and why."""
    write_loop(loop_of("he"), folder / "he.csv")
    done = run("identify", "he.csv", "--law", "all", "--base-only", "--no-intervals", "-o", "study.json", cwd=folder)
    assert done.returncode == 0, done.stderr
    study = json.loads((folder / "study.json").read_text())
    names = [law["law"] for law in study["laws"]]
    assert names[0] in ("he", "he-wang") and set(names) == laws
    held = [law["rmse_holdout"] for law in study["laws"]]
    assert held == sorted(held)
    assert study["estimate"]["law"] in ("he", "he-wang") and study["estimate"]["S"] == pytest.approx(S, rel=0.02)
    finding = next(f for f in study["steps"][-1]["findings"] if f["code"].startswith("laws-"))
    assert "S moves from" in finding["statement"] and "chen" not in finding["evidence"]["alike"]
    assert "laws, best first" in done.stdout and "kept" in done.stdout and finding["statement"] in done.stderr
    assert max(map(len, done.stdout.splitlines())) <= 80


# --- step tests


def step_record(gain: float = 2.286, T: float = 180.0, L: float = 36.67, *, n: int = 1500, size: float = 5.0,
                noise: float = 0.02) -> Loop:
    t = np.arange(n, dtype=float)
    y = naive.first_order_step(t, gain, T, L, 50.0, size, 40.0) + noise * np.random.default_rng(0).standard_normal(n)
    return Loop(output=np.where(t >= 50.0, 50.0 + size, 50.0), process_value=y)


@pytest.mark.parametrize(("gain", "T", "L"), [(2.286, 180.0, 36.67), (-3.0, 5.0, 5.0), (0.5, 40.0, 0.0)])
def test_a_step_test_gives_gain_time_constant_and_dead_time(gain: float, T: float, L: float) -> None:
    found = fit_step(step_record(gain, T, L))
    assert found.gain == pytest.approx(gain, rel=0.005) and found.time_constant_s == pytest.approx(T, rel=0.02)
    assert found.dead_time_s == pytest.approx(L, abs=0.5) and found.rmse == pytest.approx(0.02, rel=0.1)


def test_a_step_test_uses_the_measured_position_where_there_is_one() -> None:
    short = step_record(size=4.0)
    asked = replace(short, output=np.where(short.output > 50, 56.0, 50.0), position=short.output)
    assert fit_step(asked).gain == pytest.approx(2.286, rel=0.005) and fit_step(asked).from_position
    assert fit_step(replace(asked, position=None)).gain == pytest.approx(2.286 * 4 / 6, rel=0.005)


@pytest.mark.parametrize(("record", "said"), [
    (step_record(size=0.0), "there is no step"), (step_record(n=300), "ends 2"), (step_record(noise=40.0), "explains"),
    (step_record(n=15), "15 usable"), (simulate(preset("foptd")).loop, "not an open-loop step"),
    (replace(step_record(), process_value=np.full(1500, 40.0)), "does not answer"),
])
def test_a_step_test_that_holds_none_is_refused_with_the_value(record: Loop, said: str) -> None:
    with pytest.raises(DataError) as refusal:
        fit_step(record)
    assert said in refusal.value.message and refusal.value.hint


def test_a_step_test_is_refused_where_it_is_none_or_not_needed(tmp_path: Path, loop: Loop) -> None:
    """S and J beside the plant of a step test are in benchmarks/long."""
    write_loop(step_record(3.0, 5.0, 5.0, n=250), tmp_path / "step.csv")
    write_loop(loop.cut(0, 400), tmp_path / "loop.csv")
    for extra, code in ((["--step-test", "loop.csv"], 3), (["--step-test", "step.csv", "--gain", 3], 2),
                        (["--step-test", "step.csv", "--method", "arx"], 2)):
        refused = run("identify", "loop.csv", *extra, "-q", cwd=tmp_path)
        assert refused.returncode == code and refused.stderr.startswith("stictionid: "), refused.stderr
