"""Diagnoses at length: beside a random walk, in changes of y, and with nothing but coloured noise."""

from __future__ import annotations

from dataclasses import replace

import pytest
from loops_with_effects import small
from test_diagnose import HELD, setting, with_a_step
from test_same_model import assert_same

from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify
from stictionid.verbs.remove import remove


def hidden(name: str, seed: int = 21, **values: float) -> tuple[Loop, Study]:
    loop = simulate(setting(effects=((name, values),)), seed=seed).loop
    return loop, identify(loop, options=HELD)


def test_a_valve_effect_beside_a_random_walk_is_found_in_changes_of_y() -> None:
    """The free run strays nine times as far as the noise: by itself every effect is fitted to that."""
    effects = (("asymmetric-stiction", {"jump_up": 1.4, "jump_down": 2.8}),
               ("random-walk-disturbance", {"innovation_sd": 0.08}))
    loop = replace(simulate(setting(effects=effects), seed=1).loop, position=None)
    after = diagnose(loop, identify(loop, options=HELD), apply=True)
    assert set(after.missing) == {"asymmetric-stiction", "random-walk-disturbance"}
    # White noise of 0.06 on a walk of 0.08 a sample leaves one-step errors of 0.112.
    assert after.steps[-1].error.rmse_one_step == pytest.approx(0.112, rel=0.05)
    assert after.estimate is not None and pytest.approx(4.0, rel=0.02) == after.estimate.S


def test_where_y_strays_as_far_as_it_moves_its_changes_show_the_valve_and_what_is_missing() -> None:
    """No level is explained beside a stop and a walk: it was an abstention, though every slip stands in the changes."""
    noise = 0.063
    loop = simulate(Setting(Plant(2.45, 6.3, 2.2), Controller(0.45, 6.3, scan_s=1.0), S=3.06, J=2.16, duration_s=800.0,
                            setpoint_moves=((0.0, 0.0), (150.0, 2.0), (350.0, -3.0), (550.0, 2.0)), noise_sd=noise,
                            effects=(("travel-limit", {"upper": 50.0}),
                                     ("random-walk-disturbance", {"innovation_sd": noise}))), seed=6).loop
    study = identify(loop)
    assert [step.added for step in study.steps] == [None, "random-walk-disturbance"]
    assert study.steps[0].error.fit_percent < 0.0
    found = diagnose(loop, study, apply=True)
    assert found.missing == ("travel-limit",)
    assert found.estimate is not None and pytest.approx(3.06, rel=0.05) == found.estimate.S
    assert found.steps[-1].error.rmse_one_step < 1.05 * 1.618 * noise  # what a walk as strong as the noise leaves


def test_a_noise_model_stays_where_no_physics_does_better() -> None:
    loop = simulate(setting(effects=(("coloured-noise", {"root": 0.8, "innovation_sd": 0.05}),), noise_sd=0.0),
                    seed=5).loop
    study = add(loop, identify(loop, options=HELD), "coloured-noise")
    after = diagnose(loop, study)
    assert after.steps == study.steps and after.missing == () and after.completed
    assert all(c.effect == "coloured-noise" or not c.accepted for c in after.candidates)


def test_a_scanned_command_taken_for_a_moving_one_is_put_right_before_anything_is_named() -> None:
    loop = simulate(setting(), seed=13).loop
    study = identify(loop, options=Options(base_only=True, between="corner"))
    after = diagnose(loop, study)
    assert after.missing == () and after.steps[-1].model["between"] == "hold"
    assert after.steps[-1].error.rmse <= 1.05 * 0.06 < 0.95 * study.steps[-1].error.rmse


def test_a_noise_model_that_imitates_physics_gives_way_to_it() -> None:
    loop, study = hidden("sinusoidal-disturbance", period_s=37.0, amplitude=0.5)
    noisy = add(loop, study, "coloured-noise")
    assert noisy.completed
    after = diagnose(loop, noisy)
    assert after.missing == ("sinusoidal-disturbance",) and not after.adequate
    assert [s.added for s in after.steps] == [None]
    assert "gave-way" in {f.code for f in after.steps[-1].findings}


def test_a_moving_command_taken_for_a_held_one_is_put_right_once_what_hid_it_is_in() -> None:
    moving = setting(controller=Controller(0.15, 6.0), effects=(("step-disturbance", {"time_s": 500.0, "size": 1.2}),))
    loop = simulate(moving, seed=21).loop
    study = identify(loop, options=HELD)
    assert study.steps[-1].model["between"] == "hold"
    after = add(loop, study, "step-disturbance@output")
    assert after.steps[-1].model["between"] == "corner" and after.steps[-1].error.rmse <= 1.05 * 0.06
    held = add(*hidden("step-disturbance", time_s=500.0, size=1.2), "step-disturbance@output")
    assert held.steps[-1].model["between"] == "hold"


def test_coloured_noise_is_named_noise_and_its_root_comes_back() -> None:
    loop = simulate(setting(effects=(("coloured-noise", {"root": 0.8, "innovation_sd": 0.05}),), noise_sd=0.0),
                    seed=5).loop
    after = diagnose(loop, identify(loop, options=HELD), apply=True)
    assert after.missing == ("coloured-noise",)
    assert after.steps[-1].error.rmse_one_step == pytest.approx(0.05, rel=0.06)
    root = next(p.value for p in after.steps[-1].parameters if p.effect == "coloured-noise" and p.name == "root")
    assert root == pytest.approx(0.8, abs=0.15)


def test_a_study_without_a_tree_is_searched_all_the_same() -> None:
    _, loop = small("sinusoidal-disturbance")
    before = identify(loop)
    after, again = (diagnose(loop, study, apply=True) for study in (before, replace(before, tree=(), evaluations=None)))
    assert again.missing == after.missing == ("sinusoidal-disturbance",)
    assert again.estimate is not None and after.estimate is not None
    assert pytest.approx(after.estimate.S, rel=0.01) == again.estimate.S


def test_a_superfluous_effect_removed_by_hand_leaves_the_model_that_was_asked_without_it() -> None:
    loop, study = with_a_step()
    wrong = add(loop, study, "sinusoidal-disturbance")
    kept, pruned = (add(loop, wrong, "step-disturbance@output", prune=prune) for prune in (False, True))
    assert_same(remove(loop, kept, "sinusoidal-disturbance"), pruned)
