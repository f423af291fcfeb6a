"""Diagnoses at length: beside a random walk, in changes of y, and with nothing but coloured noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import test_diagnose
from loops_with_effects import small
from quick_loops import asked_only
from test_diagnose import HELD, diagnosed, setting, step_is_named, with_a_step
from test_same_model import assert_same

from stictionid.fit.noise.whiteness import noise_alone
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.record.loop import Loop
from stictionid.record.study import Study, to_json
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify
from stictionid.verbs.remove import remove


def hidden(name: str, seed: int = 21, **values: float) -> tuple[Loop, Study]:
    loop = simulate(setting(effects=((name, values),)), seed=seed).loop
    return loop, identify(loop, options=HELD)


@pytest.mark.xfail(strict=True, reason="S comes out at 4.19 % beside the right effects; true is 4 %")
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
    found = diagnose(loop, identify(loop), apply=True)
    assert set(found.steps[-1].effects) == {"travel-limit", "random-walk-disturbance"}
    assert found.estimate is not None and pytest.approx(3.06, rel=0.05) == found.estimate.S
    assert found.steps[-1].error.rmse_one_step < 1.05 * 1.618 * noise  # what a walk as strong as the noise leaves


def test_a_noise_model_stays_where_no_physics_does_better() -> None:
    loop = simulate(setting(effects=(("coloured-noise", {"root": 0.8, "innovation_sd": 0.05}),), noise_sd=0.0),
                    seed=5).loop
    study = add(loop, identify(loop, options=HELD), "coloured-noise")
    after = diagnose(loop, study)
    assert after.steps == study.steps and after.missing == () and after.completed
    assert all(c.effect == "coloured-noise" or not c.accepted for c in after.candidates)


@pytest.mark.xfail(strict=True, reason="the command stays a moving one, and the free run leaves 3.7 times the noise; "
                                       "true is a held command, which leaves the noise")
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
    last = diagnose(loop, noisy, apply=True)
    assert last.steps[-1].effects == ("sinusoidal-disturbance",) and last.adequate
    assert "gave-way" in {f.code for f in last.steps[-1].findings}
    assert last.estimate is not None
    assert pytest.approx(4.0, rel=0.01) == last.estimate.S and pytest.approx(2.5, rel=0.02) == last.estimate.J


@pytest.mark.xfail(strict=True, reason="the command stays a held one and leaves 1.09 times the noise; true is a "
                                       "moving command, which leaves the noise")
def test_a_moving_command_taken_for_a_held_one_is_put_right_once_what_hid_it_is_in() -> None:
    moving = setting(controller=Controller(0.15, 6.0), effects=(("step-disturbance", {"time_s": 500.0, "size": 1.2}),))
    loop = simulate(moving, seed=21).loop
    study = identify(loop, options=HELD)
    assert study.steps[-1].model["between"] == "hold"
    after = add(loop, study, "step-disturbance@output")
    assert after.steps[-1].model["between"] == "corner" and after.steps[-1].error.rmse <= 1.05 * 0.06


def test_a_held_command_stays_held_once_what_hid_it_is_in() -> None:
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

# Fixtures of tests/.
stepped, folder = test_diagnose.stepped, test_diagnose.folder


@pytest.fixture(scope="module")
def searched(stepped: tuple[Loop, Study]) -> Study:
    """The study of the loop with a step after a search for all effects."""
    return diagnose(*stepped)


def test_a_superfluous_effect_is_named_and_left_out_on_request(stepped: tuple[Loop, Study]) -> None:
    """Its removal afterwards is in benchmarks/long."""
    loop, study = stepped
    wrong = add(loop, study, "sinusoidal-disturbance")
    answer = next(f for f in wrong.steps[-1].findings if f.code == "not-supported")
    assert wrong.steps[-1].supported is False and answer.severity == "warning"
    assert "BIC beyond noise" in answer.statement and answer.evidence["gain_beyond_noise"] < answer.evidence["margin"]
    kept = add(loop, wrong, "step-disturbance@output")
    assert kept.steps[-1].supported is True and study.steps[0].supported is None
    assert kept.steps[-1].added == "step-disturbance" and kept.steps[-1].variant == "output"
    assert "superfluous" in {f.code for f in kept.steps[-1].findings}
    pruned = add(loop, wrong, "step-disturbance@output", prune=True)
    assert pruned.steps[-1].model["effects"] == ["step-disturbance@output"]
    assert [f.statement for f in pruned.steps[-1].findings if f.code == "gave-way"] == [
        "left out: sinusoidal-disturbance, needless beside step-disturbance"]
    # The ladder does not show what was left out, and the hint of the warning can be followed.
    assert [step.added for step in pruned.steps] == [None, "step-disturbance"]
    hint = next(f.statement for f in kept.steps[-1].findings if f.code == "superfluous")
    assert "stictionid remove sinusoidal-disturbance" in hint


def test_a_hidden_step_is_named_among_all_effects_and_each_of_them_has_its_reason(
        searched: Study) -> None:
    step_is_named(searched, 12)


def test_a_policy_with_a_small_budget_leaves_effects_unasked_and_says_so(folder: Path, searched: Study) -> None:
    assert searched.missing == ("step-disturbance",) and not searched.unasked
    (folder / "small.toml").write_text("budget = 1\n")
    small = diagnosed(folder, "base.json", "--policy", "small.toml")
    assert small["missing"] == [] and len(small["unasked"]) > 10
    assert 0 < small["evaluations"] < (searched.evaluations or 0)

# Fixtures of tests/.
stepped = test_diagnose.stepped


def test_the_same_seed_gives_the_same_study_whatever_the_jobs(stepped: tuple[Loop, Study]) -> None:
    with asked_only("step-disturbance", "extra-lag"):
        alone, shared = (to_json(diagnose(*stepped, jobs=jobs)) for jobs in (1, 2))
    assert '"extra-lag"' in alone and alone == shared


def test_noise_alone_is_told_from_what_valve_process_or_a_disturbance_leave() -> None:
    """In 19 records of noise alone out of 20, and in one of 10 whose innovations hold an effect worth 50 in BIC."""
    loop = simulate(setting(duration_s=1500.0), seed=5).loop
    model = Model(loop, Spec(), s_max=10.0, period_s=60.0)
    position, taps, good = model.loop.position, np.array([-0.8]), np.arange(loop.samples) > 60
    assert position is not None
    rng = np.random.default_rng(8)
    white = rng.normal(size=(120, loop.samples))
    passed = np.mean([noise_alone(model, taps, position, e, good) for e in white])
    assert passed >= 0.95
    slip = np.abs(np.diff(position, prepend=position[0])) > 0.5
    after = np.convolve(slip, np.ones(3))[:slip.size] > 0
    lagged = np.roll(position - position.mean(), 7) / position.std()
    size = np.sqrt(np.expm1((50.0 + np.log(loop.samples)) / loop.samples))
    for left in (size * lagged, 2.0 * after * rng.normal(size=loop.samples),
                 size * np.sqrt(2.0) * np.sin(0.31 * np.arange(loop.samples))):
        assert np.mean([noise_alone(model, taps, position, e + left, good) for e in white[:25]]) <= 0.1
    # A noise that remembers for long may be a disturbance.
    assert noise_alone(model, np.zeros(0), position, white[0], good)
    assert not noise_alone(model, np.array([-0.97]), position, white[0], good)
