"""Diagnose and add: hidden effects are named first, the base is put right first, clean loops are left alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import commands
import numpy as np
import pytest

from stictionid.effects import catalogue
from stictionid.effects import get as get_effect
from stictionid.effects.contract import Context
from stictionid.errors import DataError, UsageError
from stictionid.fit.cross_validation import Held
from stictionid.fit.noise.completion import complete, own_taps, quick
from stictionid.fit.noise.whiteness import noise_alone, passes_tests
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.numerics.narrow_band import resonance, shape
from stictionid.record.loop import Loop
from stictionid.record.study import study_from_json, to_json
from stictionid.selection import bootstrap, work
from stictionid.selection.judge import holds, steadiest, winner_of
from stictionid.selection.rounds import look_at
from stictionid.selection.run import without_noise
from stictionid.selection.steps import opened
from stictionid.selection.tells import settling
from stictionid.selection.tries import Tried, held_command
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify

NOISES = {effect.name for effect in catalogue().values() if effect.noise}
HELD = Options(base_only=True, between="hold")
MOVES = ((0.0, 3.0), (200.0, -4.0), (450.0, 5.0), (700.0, -3.0))


def setting(**more) -> Setting:
    base = Setting(Plant(2.0, 6.0, 3.0), Controller(0.15, 6.0, scan_s=1.0), S=4.0, J=2.5, duration_s=900.0,
                   setpoint_moves=MOVES, noise_sd=0.06)
    return replace(base, **more)


def hidden(name: str, seed: int = 21, **values):
    loop = simulate(setting(effects=((name, values),)), seed=seed).loop
    return loop, identify(loop, options=HELD)


@pytest.mark.parametrize(("name", "values"), [
    ("measured-disturbance", {"gain": 0.8, "lag_s": 8.0, "dead_time_s": 2.0}),
])
def test_a_hidden_effect_is_named_first_and_the_error_falls_to_the_noise(name: str, values: dict) -> None:
    loop, study = hidden(name, **values)
    after = diagnose(loop, study, apply=True)
    assert after.missing[0] == name and after.steps[1].added == name
    assert after.steps[-1].error.rmse <= 1.05 * 0.06 and after.adequate
    # Eleven slow cycles: S is known to about one step of the command, nine in ten of which are below 0.09 % here.
    assert after.estimate is not None and pytest.approx(4.0, abs=0.08) == after.estimate.S
    top = after.candidates[0]
    assert top.accepted and top.effect == name and top.rmse_one_step_holdout is not None
    assert {p.name for p in top.parameters} <= {p.name for p in catalogue()[name].parameters}
    others = [c for c in after.candidates if not c.accepted]
    assert sum(c.detectable_from is not None for c in others) > 0.7 * len(others)
    assert study_from_json(to_json(after)) == after


def test_the_same_seed_gives_the_same_study_whatever_the_jobs() -> None:
    loop, study = hidden("step-disturbance", time_s=500.0, size=1.2)
    one = diagnose(loop, study)
    assert one.missing == ("step-disturbance",) and one.candidates[0].variant == "output"
    assert to_json(diagnose(loop, study, jobs=2)) == to_json(one)


def test_a_scanned_command_taken_for_a_moving_one_is_put_right_before_anything_is_named() -> None:
    loop = simulate(setting(), seed=13).loop
    study = identify(loop, options=Options(base_only=True, between="corner"))
    run, fit = opened(loop, study, 0)
    found = held_command(fit, run.rng)
    assert found is not None and found.model.spec.between == "hold" and found.best.rmse < 0.9 * fit.best.rmse
    assert found.best.rmse <= 1.05 * 0.06


def test_a_moving_command_taken_for_a_held_one_is_put_right_once_what_hid_it_is_in() -> None:
    moving = setting(controller=Controller(0.15, 6.0), effects=(("step-disturbance", {"time_s": 500.0, "size": 1.2}),))
    loop = simulate(moving, seed=21).loop
    study = identify(loop, options=HELD)
    assert study.steps[-1].model["between"] == "hold"
    after = add(loop, study, "step-disturbance@output")
    assert after.steps[-1].model["between"] == "corner" and after.steps[-1].error.rmse <= 1.05 * 0.06
    held = add(*hidden("step-disturbance", time_s=500.0, size=1.2), "step-disturbance@output")
    assert held.steps[-1].model["between"] == "hold"


def test_an_effect_that_follows_y_is_run_and_held_out_on_the_y_that_the_model_makes() -> None:
    loop, study = hidden("gain-nonlinearity", curvature=0.08)
    _, fit = opened(loop, study, 0)
    seen = work.look(ground := work.Ground(fit, fit.values[None, :5], 0), "gain-nonlinearity")
    answer = work.finish(ground, seen)
    done = answer.refit(ground)
    white = done.white_model()
    np.testing.assert_allclose(white._evaluate(done.values).model, done.evaluated.model, atol=0.01 * 0.06)
    assert answer.held is not None
    assert answer.held.rmse_one_step <= 1.05 * done.innovation_sd <= 1.1 * 0.06


def test_coloured_noise_is_named_noise_and_its_root_comes_back() -> None:
    loop = simulate(setting(effects=(("coloured-noise", {"root": 0.8, "innovation_sd": 0.05}),), noise_sd=0.0),
                    seed=5).loop
    after = diagnose(loop, identify(loop, options=HELD), apply=True)
    assert after.missing == ("coloured-noise",)
    assert after.steps[-1].error.rmse_one_step == pytest.approx(0.05, rel=0.06)
    root = next(p.value for p in after.steps[-1].parameters if p.effect == "coloured-noise" and p.name == "root")
    assert root == pytest.approx(0.8, abs=0.15)


def test_a_noise_model_that_imitates_physics_gives_way_to_it() -> None:
    loop, study = hidden("sinusoidal-disturbance", period_s=37.0, amplitude=0.5)
    noisy = add(loop, study, "coloured-noise")
    assert noisy.adequate
    after = diagnose(loop, noisy)
    assert after.missing == ("sinusoidal-disturbance",) and not after.adequate
    assert [s.added for s in after.steps] == [None]
    assert "gave-way" in {f.code for f in after.steps[-1].findings}


def test_a_noise_model_stays_where_no_physics_does_better() -> None:
    loop = simulate(setting(effects=(("coloured-noise", {"root": 0.8, "innovation_sd": 0.05}),), noise_sd=0.0),
                    seed=5).loop
    study = add(loop, identify(loop, options=HELD), "coloured-noise")
    after = diagnose(loop, study)
    assert after.steps == study.steps and after.missing == () and after.adequate
    assert all(c.effect != "coloured-noise" and not c.accepted for c in after.candidates)


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
    # Of a walk the changes are asked; a step is far out in them, and a ramp leaves them a mean.
    step, ramp = np.zeros(loop.samples), np.full(loop.samples, np.sqrt(50.0 / loop.samples))
    step[800] = np.sqrt(50.0)
    walked = [np.mean([noise_alone(model, -np.ones(1), position, e + left, good, walk=True) for e in white[:40]])
              for left in (0.0, step, ramp, size * lagged)]
    assert walked[0] >= 0.95 and max(walked[1:]) <= 0.1


def test_a_further_tag_is_seen_in_innovations_unless_it_is_in_the_model() -> None:
    loop = simulate(setting(duration_s=1500.0), seed=5).loop
    rng = np.random.default_rng(9)
    tag = np.cumsum(rng.normal(size=loop.samples) * (rng.random(loop.samples) < 0.02))
    loop = replace(loop, extras={"feed": tag})
    known, unknown = (Model(loop, Spec(effects=names), s_max=10.0, period_s=60.0)
                      for names in (("measured-disturbance:feed",), ()))
    good = np.arange(loop.samples) > 60
    # Noise that walks: errors in differences, and of the tag its moves.
    walk, moves = np.array([1.0, -1.0]), np.diff(tag, prepend=tag[0])
    size = np.sqrt(np.expm1((50.0 + np.log(loop.samples)) / loop.samples)) / moves.std()
    seen = {known: 0, unknown: 0}
    for e in rng.normal(size=(25, loop.samples)):
        assert loop.position is not None
        seen[known] += passes_tests(known, walk, 0, loop.position, e, good)
        seen[unknown] += passes_tests(unknown, walk, 0, loop.position, e + 2.0 * size * np.roll(moves, 2), good)
    assert seen[known] >= 23 and seen[unknown] <= 2


def test_what_a_random_walk_left_over_is_named_though_the_level_runs_away() -> None:
    """A free run beside a walk has no error that could grow, and a second noise model only takes the first's place."""
    loop = simulate(setting(effects=(("random-walk-disturbance", {"innovation_sd": 0.1}), (
        "measured-disturbance", {"gain": 1.5, "lag_s": 2.0, "dead_time_s": 2.0}))), seed=22).loop
    study = add(loop, identify(loop, options=HELD), "random-walk-disturbance")
    found = look_at(loop, study, 0, 1, lambda text, share: None).found
    winner = winner_of(found)
    assert winner is not None and winner.name == "measured-disturbance:D1"
    assert not any(t.noise for t in found.tried)
    lucky = replace(found.reference.evaluated, residual=0.01 * found.reference.evaluated.residual)
    assert winner_of(replace(found, reference=replace(found.reference, evaluated=lucky))) is winner


def test_a_noise_model_gives_way_to_the_physics_that_it_imitated() -> None:
    loop, study = hidden("step-disturbance", time_s=500.0, size=1.2)
    noisy = add(loop, study, "coloured-noise")
    both = add(loop, noisy, "step-disturbance@output")
    after = without_noise(loop, both, "step-disturbance", 0)
    assert set(both.steps[-1].effects) == {"coloured-noise", "step-disturbance"}
    assert after.steps[-1].effects == ("step-disturbance",) and after.steps[-1].added == "step-disturbance"
    assert after.steps[-1].error.rmse <= 1.05 * 0.06
    assert any(f.code == "gave-way" for f in after.steps[-1].findings)
    # The ladder goes from the base to the step, not by way of what is not there.
    assert [step.added for step in after.steps] == [None, "step-disturbance"]
    # Where only changes of y had been looked at before, because no level was explained, there are levels now.
    changes = replace(both.steps[0], model={**both.steps[0].model, "increments": True})
    again = without_noise(loop, replace(both, steps=(changes, *both.steps[1:])), "step-disturbance", 0)
    assert again.steps[-1].model["increments"] is False
    # It stays where nothing falls by half without it.
    assert without_noise(loop, noisy, "coloured-noise", 0).steps[-1].effects == ("coloured-noise",)


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


def test_a_walk_that_does_no_better_than_an_autoregression_is_not_named() -> None:
    walk = Tried("random-walk-disturbance", None, 621.0, np.zeros(5), True)
    steady = replace(walk, name="coloured-noise")
    for behind, named in ((0.1, "coloured-noise"), (5.0, "random-walk-disturbance")):
        assert steadiest([walk, replace(steady, delta_bic=621.0 - behind)]).name == named
    assert steadiest([steady, replace(walk, delta_bic=620.0)]).name == "coloured-noise"


def test_what_a_noise_of_short_memory_explains_is_hunted_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = simulate(setting(effects=(("coloured-noise", {"root": 0.8, "innovation_sd": 0.05}),), noise_sd=0.0),
                    seed=5).loop
    study = identify(loop, options=HELD)
    looked: list[bool] = []
    real = work.scout

    def counted(fit, name, pool, rng, **how):
        looked.append(how["far"])
        return real(fit, name, pool, rng, **how)

    monkeypatch.setattr(work, "scout", counted)
    after = diagnose(loop, study)
    assert after.missing == ("coloured-noise",)
    # One round, whose looks stay near the model so far, and at most one full refit of what the noise does better than.
    assert looked and not any(looked) and len(looked) <= len(after.candidates)
    assert sum(c.rmse_holdout is not None for c in after.candidates if c.effect not in NOISES) <= 1


def test_a_superfluous_effect_is_named_and_left_out_on_request() -> None:
    loop, study = hidden("step-disturbance", time_s=500.0, size=1.2)
    wrong = add(loop, study, "sinusoidal-disturbance")
    kept = add(loop, wrong, "step-disturbance@output")
    assert kept.steps[-1].added == "step-disturbance" and kept.steps[-1].variant == "output"
    assert "superfluous" in {f.code for f in kept.steps[-1].findings}
    pruned = add(loop, wrong, "step-disturbance@output", prune=True)
    assert pruned.steps[-1].model["effects"] == ["step-disturbance@output"]
    assert "pruned" in {f.code for f in pruned.steps[-1].findings}


def test_prewhitening_of_the_process_is_kept_and_extended_by_a_noise_model() -> None:
    loop = simulate(setting(effects=(("coloured-noise", {"root": 0.8, "innovation_sd": 0.05}),), noise_sd=0.0),
                    seed=5).loop
    spec = Spec(taps=(0.5, 0.1))
    model = Model(loop, spec, s_max=8.0, period_s=80.0)
    values = np.array([4.0, 2.5, 0.15, 6.0, 3.0])
    assert own_taps(spec) == (0.5, 0.1) and own_taps(Spec(effects=("coloured-noise",), taps=(0.5,))) == ()
    first = quick(model, values)
    assert first.own == (0.5, 0.1) and first.taps.size > 0
    expected = np.convolve([1.0, 0.5, 0.1], np.concatenate([[1.0], first.taps]))[1:]
    np.testing.assert_allclose(first.spec.taps, expected)
    done = complete(model, values, None, np.random.default_rng(0))
    assert done.model.spec.taps[:1] != (0.5,) and len(done.model.spec.taps) == 2 + done.taps.size
    assert done.innovation_sd == pytest.approx(0.05, rel=0.08)


def test_a_resonance_is_found_in_a_spectrum_made_of_it() -> None:
    rng = np.random.default_rng(3)
    r, w0 = np.exp(-1.0 / (4.0 * 20.0)), 2.0 * np.pi / 20.0
    x, white = np.zeros(3000), rng.standard_normal(3000)
    for k in range(2, x.size):
        x[k] = 2.0 * r * np.cos(w0) * x[k - 1] - r * r * x[k - 2] + white[k]
    x = x / x.std() + 0.5 * rng.standard_normal(x.size)
    found = resonance(x, np.ones(x.size, bool), rng)
    assert found is not None and found.period == pytest.approx(20.0, rel=0.03)
    assert found.coherence == pytest.approx(4.0, rel=0.4) and found.share == pytest.approx(0.8, abs=0.08)
    w = np.linspace(0.01, np.pi, 5)
    flat = shape(w, np.array([0.3]), np.array([5.0]), np.array([0.0]))
    assert np.allclose(flat, 1.0)


def test_a_test_that_settles_is_named_for_pairs_that_look_alike() -> None:
    assert "OP" in settling("valve-characteristic", ("gain-nonlinearity",))
    assert settling("extra-lag", ()) == "" and settling("extra-lag", ("slew-limit",)) != ""


def test_refusals_leave_the_study_as_it_is(tmp_path: Path) -> None:
    loop, study = hidden("step-disturbance", time_s=500.0, size=1.2)
    for name in ("step-disturbence", "measured-disturbance", "measured-disturbance:FEED", "extra-lag@load"):
        with pytest.raises(UsageError) as refusal:
            add(loop, study, name)
        assert refusal.value.hint
    dead = Loop(output=np.full(300, 40.0), process_value=np.random.default_rng(0).standard_normal(300))
    with pytest.raises(DataError):
        diagnose(dead, identify(dead))

    def run(*arguments: object):
        return commands.run(*arguments, cwd=tmp_path)

    assert run("simulate", "--S", 4, "--J", 2, "--noise", 0.05, "--scan", 1, "-o", "a.csv").returncode == 0
    assert run("identify", "a.csv", "--base-only", "-o", "s.json").returncode == 0
    text = (tmp_path / "s.json").read_text()
    newer = json.loads(text) | {"schema": "stictionid.study/99"}
    (tmp_path / "newer.json").write_text(json.dumps(newer))
    with open(tmp_path / "a.csv", "a") as file:
        file.write("\n")
    # A name that is no effect is refused before the file is looked at, which has changed.
    for arguments, code in ((("add", "extra-lug", "s.json"), 2), (("add", "extra-lag", "s.json"), 3),
                            (("diagnose", "s.json"), 3),
                            (("diagnose", "newer.json"), 3), (("add", "extra-lag", "gone.json"), 2),
                            (("diagnose", "a.csv", "s.json"), 3)):
        refused = run(*arguments)
        assert refused.returncode == code and "Traceback" not in refused.stderr and refused.stdout == ""
    assert "a.csv: not a study" in refused.stderr and "give the study first" in refused.stderr
    assert (tmp_path / "s.json").read_text() == text


def test_a_refit_that_breaks_down_is_reported_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, study = hidden("step-disturbance", time_s=500.0, size=1.2)
    real = work.scout

    def breaking(fit, name, pool, rng, **how):
        if name == "slew-limit":
            raise np.linalg.LinAlgError("SVD did not converge")
        return real(fit, name, pool, rng, **how)

    monkeypatch.setattr(work, "scout", breaking)
    after = diagnose(loop, study)
    assert after.missing == ("step-disturbance",)
    broken = next(c for c in after.candidates if c.effect == "slew-limit")
    assert broken.delta_bic is None and "did not converge" in broken.statement
    # An effect that is not there ends where it vanishes, and is said to.
    assert any("not identifiable here" in c.statement for c in after.candidates)


def test_an_effect_that_chance_would_show_as_often_is_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, study = hidden("step-disturbance", time_s=500.0, size=1.2)
    p = iter((0.04, 0.01))
    monkeypatch.setattr(bootstrap, "p_of", lambda *_: next(p))
    doubtful = diagnose(loop, study, bootstrap=99)
    assert doubtful.missing == () and not any(c.accepted for c in doubtful.candidates)
    assert any("bootstrap p = 0.04" in c.statement for c in doubtful.candidates)
    assert diagnose(loop, study, bootstrap=99).missing == ("step-disturbance",)


def test_a_step_in_the_block_held_out_is_no_proof_against_a_step() -> None:
    rows = np.full(5, 100.0)

    def held(*errors: float) -> Held:
        squares = rows * np.array(errors) ** 2
        return Held(squares, rows, squares, rows)

    before, with_step = held(2.0, 2.0, 2.0, 2.0, 2.0), held(1.0, 1.0, 9.0, 1.0, 1.0)
    assert with_step.blocks.tolist() == [1.0, 1.0, 9.0, 1.0, 1.0]
    assert holds(with_step, before, local=True)
    assert not holds(with_step, before)
    # A drift may help in two blocks alone, and what helps in none is not held.
    assert holds(held(2.0, 2.0, 2.0, 1.0, 1.0), before, local=True)
    assert not holds(held(2.0, 2.0, 9.0, 2.0, 2.0), before, local=True)


def test_the_gain_may_change_by_most_of_itself_within_what_most_of_the_record_reaches() -> None:
    y = np.concatenate([np.linspace(45.0, 55.0, 990), np.full(10, 90.0)])
    context = Context(y, y, np.full(y.size, 50.0), 1.0, 1, 50.0)
    (limits,) = get_effect("gain-nonlinearity").parameters_for(context)
    assert limits.high == pytest.approx(0.8 / np.quantile(np.abs(y - 50.0), 0.9))
    assert limits.high > 0.8 / 5.0 and limits.low == -limits.high


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
