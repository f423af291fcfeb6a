"""One quantity, one number, one name: the outputs of more loops, and those of `add`, `remove` and `compare`."""

from __future__ import annotations

from pathlib import Path

import pytest
import test_one_number
from commands import run
from printed_numbers import wrong_numbers
from quick_loops import asked_only
from test_one_number import ASKED, outputs, outputs_of

from stictionid.record.study import Study, study_from_json

_WIDE = {"COLUMNS": "400"}
_LOOPS = {
    "drift": ("gain-drift:drift=-30", "--duration", "900"), "stop": ("travel-limit:upper=52", "--duration", "900"),
    "walk": ("random-walk-disturbance:innovation_sd=0.05", "--duration", "900"),
    "coloured": ("coloured-noise:root=0.8,innovation_sd=0.05", "--noise", "0", "--duration", "900"),
    "characteristic": ("valve-characteristic:log_rangeability=3.5", "--duration", "900")}


def _simulated(folder: Path, effect: str, *more: str) -> None:
    noise = () if "--noise" in more else ("--noise", "0.05")
    out = run("simulate", "--S", 4, "--J", 2.5, *noise, "--scan", 1, "--seed", 1, "--setpoint", "0:5", "--setpoint",
              "450:-6", "--effect", effect, *more, "-o", "loop.csv", cwd=folder)
    assert out.returncode == 0, out.stderr


@pytest.fixture(scope="module", params=["sine", "stop"])
def shown(request: pytest.FixtureRequest,
          tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Study, str]]:
    """The outputs of the loop with a sine and of the one with a stop, for the tests of tests/."""
    if request.param == "sine":
        return outputs_of("sine", tmp_path_factory.mktemp("sine"))
    with asked_only(*ASKED):
        return outputs_of("stop", tmp_path_factory.mktemp("stop"), "--base-only")


test_outputs_print_the_numbers_of_their_study = \
    test_one_number.test_every_output_prints_the_numbers_of_its_study
test_all_steps_of_a_study_have_one_noise = test_one_number.test_all_steps_of_a_study_have_one_noise
test_each_effect_has_one_row_and_those_of_the_model_are_never_rejected = \
    test_one_number.test_each_effect_has_one_row_and_those_of_the_model_are_never_rejected
test_the_slip_jump_in_percent_of_travel_is_called_no_share = \
    test_one_number.test_the_slip_jump_in_percent_of_travel_is_called_no_share
test_the_map_of_the_cost_marks_the_estimate_of_its_step = \
    test_one_number.test_the_map_of_the_cost_marks_the_estimate_of_its_step
test_a_number_that_is_not_the_studys_is_found = test_one_number.test_a_number_that_is_not_the_studys_is_found


@pytest.mark.parametrize("name", sorted(set(_LOOPS) - {"stop"}))
def test_every_output_prints_the_numbers_of_its_study(name: str, tmp_path: Path) -> None:
    _simulated(tmp_path, *_LOOPS[name])
    wrong = {where: found for where, (study, text) in outputs(tmp_path).items()
             if (found := wrong_numbers(study, text))}
    assert not wrong


def test_add_remove_and_compare_print_the_numbers_of_their_study(tmp_path: Path) -> None:
    _simulated(tmp_path, *_LOOPS["stop"])
    assert run("identify", "loop.csv", "-o", "s.json", "-q", cwd=tmp_path).returncode == 0
    for words in (("diagnose", "s.json"), ("add", "travel-limit", "s.json"), ("compare", "s.json"),
                  ("remove", "travel-limit", "s.json")):
        out = run(*words, "-q", cwd=tmp_path, env=_WIDE)
        assert out.returncode == 0, out.stderr
        study = study_from_json((tmp_path / "s.json").read_text(encoding="utf-8"))
        assert len({step.error.noise_sd for step in study.steps}) == 1
        if words[0] != "remove":  # (its finding tells the error of the model before)
            assert not wrong_numbers(study, out.stdout), words
