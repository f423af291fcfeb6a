"""One quantity, one number, one name: every output of a study prints its errors, its noise and its gains alike.

Six more loops, one with a stop and one with a sine among them, are in benchmarks/long.
"""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from commands import run
from printed_numbers import numbers_in, qualifiers, wrong_numbers
from quick_loops import WORDS, asked_only
from rich.console import Console

from stictionid.cli.common.terminal import print_case
from stictionid.record.study import Study, study_from_json
from stictionid.reports.pictures.curves import gather

_WIDE = {"COLUMNS": "400"}
_KINDS = ("html", "json", "md")
_VALVE = ("--S", 4, "--J", 2.5, "--noise", 0.05, "--scan", 1)
LOOPS = {
    "stop": (*_VALVE, "--seed", 3, "--duration", 500, "--setpoint", "0:4", "--setpoint", "250:-5",
             "--effect", "travel-limit:upper=52"),
    "sine": (*_VALVE, "--seed", 12, "--duration", 600, "--setpoint", "0:5", "--setpoint", "300:-6",
             "--effect", "sinusoidal-disturbance:period_s=61,amplitude=1"),
    "sticking": WORDS}
# The catalogue asked for: the effect of the loops here, and others of its kinds.
ASKED = ("travel-limit", "extra-lag", "step-disturbance", "slip-overshoot")


def outputs(folder: Path, *more: str) -> dict[str, tuple[Study, str]]:
    """Every output of the study before and after `diagnose --apply`, beside the study it shows, for `loop.csv`.

    `more` are options of `identify`.
    """
    shown = {}
    for stage, words in (("base", ("identify", "loop.csv", "-o", "base.json", "-q", *more)),
                         ("found", ("diagnose", "base.json", "--apply", "-o", "found.json", "-q"))):
        out = run(*words, cwd=folder, env=_WIDE)
        assert out.returncode == 0, out.stderr
        study = study_from_json((folder / f"{stage}.json").read_text(encoding="utf-8"))
        shown[f"{stage}, command"] = study, out.stdout
        for kind in _KINDS:
            out = run("report", f"{stage}.json", "-o", f"{stage}-page.{kind}", "-q", cwd=folder)
            assert out.returncode == 0, out.stderr
            shown[f"{stage}, {kind}"] = study, (folder / f"{stage}-page.{kind}").read_text(encoding="utf-8")
        stream = io.StringIO()
        print_case(gather(study), Console(file=stream, width=400, color_system=None))
        shown[f"{stage}, terminal"] = study, stream.getvalue()
    return shown


def outputs_of(name: str, folder: Path, *more: str) -> dict[str, tuple[Study, str]]:
    """The outputs of one simulated loop."""
    out = run("simulate", *LOOPS[name], "-o", "loop.csv", cwd=folder)
    assert out.returncode == 0, out.stderr
    return outputs(folder, *more)


@pytest.fixture(scope="module", params=["sticking"])
def shown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Study, str]]:
    with asked_only(*ASKED):
        return outputs_of(request.param, tmp_path_factory.mktemp("one-number"), "--base-only")


def test_every_output_prints_the_numbers_of_its_study(shown: dict[str, tuple[Study, str]]) -> None:
    wrong = {name: found for name, (study, text) in shown.items() if (found := wrong_numbers(study, text))}
    assert not wrong
    # The reader sees a number in each of them: the screen of a search that finds nothing has one.
    assert all(numbers_in(study, text) >= 1 for study, text in shown.values())


def test_all_steps_of_a_study_have_one_noise(shown: dict[str, tuple[Study, str]]) -> None:
    for study, _ in shown.values():
        noises = {step.error.noise_sd for step in study.steps}
        assert len(noises) == 1
        (noise,) = noises
        assert noise is not None and study.adequate is (study.steps[-1].error.rmse <= 1.05 * noise)


def test_each_effect_has_one_row_and_those_of_the_model_are_never_rejected(
        shown: dict[str, tuple[Study, str]]) -> None:
    study, _ = shown["found, json"]
    names = [c.effect for c in study.candidates]
    assert len(names) == len(set(names)) and all(c.delta_bic == c.gain_beyond_noise or c.delta_bic is None
                                                 for c in study.candidates)
    assert tuple(c.effect for c in study.candidates[:len(study.missing)]) == study.missing
    have = [c for c in study.candidates if c.effect in study.steps[-1].effects]
    assert {s.added for s in study.steps[1:]} <= {c.effect for c in have}
    assert all(not c.rejected_because for c in have)
    assert all(c.rejected_because for c in study.candidates if c.effect not in study.steps[-1].effects)


def test_the_slip_jump_in_percent_of_travel_is_called_no_share(shown: dict[str, tuple[Study, str]]) -> None:
    for study, text in shown.values():
        jump = next(p for p in study.steps[-1].parameters if p.name == "J")
        assert (jump.unit, jump.meaning) == ("%", "slip jump") and "as a share of S" not in text


def test_the_map_of_the_cost_marks_the_estimate_of_its_step(shown: dict[str, tuple[Study, str]]) -> None:
    study, _ = shown["base, json"]
    m, e = study.cost_map, study.estimate
    assert m is not None and e is not None
    least = min((v, S, J) for row, S in zip(m.rmse, m.S, strict=True)
                for v, J in zip(row, m.J, strict=True) if v is not None)
    assert e.S in m.S and e.J in m.J
    assert least[1:] == pytest.approx((e.S, e.J), rel=0.02)


@pytest.mark.parametrize("kind", ["command", "html", "json", "md", "terminal"])
def test_a_number_that_is_not_the_studys_is_found(shown: dict[str, tuple[Study, str]], kind: str) -> None:
    """A page with one digit changed, and pages with a second error, noise and gain, do not pass."""
    study, text = shown[f"found, {kind}"]
    error = study.steps[-1].error
    assert error.noise_sd is not None
    # The error as this page prints it.
    for digits in (4, 3):
        printed = f"{error.rmse:.{digits}g}"
        if printed in text:
            break
    changed = text.replace(printed, printed[:-1] + str((int(printed[-1]) + 5) % 10))
    assert changed != text and wrong_numbers(study, changed)
    if kind != "json":
        start, end = text.rfind("</body>"), "</p>"
        for more in (f"The free-run error is {2.3 * error.rmse:.4g}.",
                     f"The irreducible noise {2 * error.noise_sd:.4g}.",
                     "It is 31.7 times the irreducible noise.", "It gains 77123 BIC beyond noise."):
            page = f"{text[:start]}<p>{more}{end}{text[start:]}" if kind == "html" else f"{text}\n\n{more}\n"
            assert wrong_numbers(study, page), more
        assert wrong_numbers(study, f"{text}\n\nThe error, held out, is {2.3 * error.rmse:.4g}.\n") \
            == wrong_numbers(study, text)


def test_the_glossary_lists_the_qualifiers() -> None:
    assert {"quick fit", "beside its noise model", "over its parent"} <= set(qualifiers())
