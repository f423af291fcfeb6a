"""Valves found along paths from any start, on exports whose valve no free run by the law shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stictionid.fit.intervals.along_path import scatter_of
from stictionid.fit.noise.completion import along_slips, complete_quickly
from stictionid.fit.valves_by_paths import move_all_slips, valves_by_paths
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.segments import bind_model
from stictionid.model.slips import Paths
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.paths.any_valve import settle_from_any_valve, settle_near
from stictionid.paths.command_error import error_range, errs_by_scan, likely_errors
from stictionid.paths.likelihood import law_paths, likeliest_slips
from stictionid.paths.settle import Settled, all_slips_moved, bounds, scatters_at_most, score_path, settle_path
from stictionid.process.scan import DECIMATED, hidden_noise, unseen_noise
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range, noise_of
from stictionid.record.preconditions import swing_of, time_scale_s
from stictionid.selection.score import Scored

TANK = Setting(Plant(0.0165, 5.4, 3.8, integrating=True), Controller(2.0, 120.0, scan_s=1.0), S=4.6, J=4.0,
               noise_sd=0.03, duration_s=3000.0, setpoint_moves=((0.0, 2.0),))


def exported(setting: Setting, seed: int, every: int) -> Loop:
    loop = simulate(setting, seed=seed).loop
    assert loop.setpoint is not None
    return Loop(output=loop.output[::every], process_value=loop.process_value[::every],
                setpoint=loop.setpoint[::every], step_s=every * loop.step_s)


def bound(loop: Loop, spec: Spec) -> Model:
    found = find_range(loop)
    return bind_model(loop, spec, s_max=swing_of(loop, found), period_s=time_scale_s(loop, found))


def test_a_tank_whose_export_hides_scans_shows_its_valve_along_paths_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    model = bound(exported(TANK, 4, 5), Spec())
    found = valves_by_paths([model], INTEGRATOR, rests=(False,))
    assert len(found) == 1 and found[0].model.spec.paths is not None
    values = found[0].evaluated.values
    assert values["S"] == pytest.approx(4.6, rel=0.06) and values["J"] == pytest.approx(4.0, rel=0.2)
    truth = {**values, "S": 4.6, "J": 4.0, "time_constant_s": 5.4, "dead_time_s": 3.8}
    plain = bound(model.loop, Spec(process=INTEGRATOR))
    assert plain.evaluate(plain.vector(truth)).rmse > 5.0 * 0.03
    # Beside a rival that is likelier by far the valve is settled once, and not sought more closely.
    better = replace(found[0], innovation=found[0].innovation * np.exp(-1000.0 / found[0].good.sum()))
    assert better.gain_over(found[0]) > 1000.0
    settled: list[object] = []
    monkeypatch.setattr("stictionid.fit.valves_by_paths.settle_near", lambda *given: settled.append(given))
    assert valves_by_paths([model], INTEGRATOR, rests=(False,), rival=better) and not settled


def test_an_answer_whose_slips_all_come_too_early_moves_them_back_beside_its_noise() -> None:
    """An answer at every second scan was 39 BIC and 3 % of S from the one two commands further on."""
    model = bound(exported(replace(TANK, noise_sd=0.01), 4, 2), Spec(process=INTEGRATOR))
    values = model.vector({"S": 4.6, "J": 4.0, "initial_residual_force": 0.0, "time_constant_s": 5.4,
                           "dead_time_s": 3.8})
    best = settle_path(model, values, error=likely_errors(model, values)[0], within=error_range(model, values))
    early = all_slips_moved(best, -1)
    assert early is not None
    wrong = along_slips(score_path(model, *early))
    assert wrong.evaluated.values["dead_time_s"] > 5.0 and wrong.taps.size
    right = move_all_slips(wrong)
    assert right.gain_over(wrong) > 100.0 and right.evaluated.values["S"] == pytest.approx(4.6, rel=0.01)
    assert right.evaluated.values["dead_time_s"] == pytest.approx(3.8, abs=0.3)
    by_law = complete_quickly(model, values)
    assert move_all_slips(by_law) is by_law


def test_an_integrator_that_no_valve_moves_becomes_a_process_of_first_order() -> None:
    """A base with an integrator won beside a valve of 3 % of the true stickband."""
    lagging = Setting(Plant(1.3, 6.0, 1.5), Controller(1.0, 6.0, scan_s=1.0), S=2.7, J=1.1, noise_sd=0.01,
                      duration_s=1500.0, setpoint_moves=((0.0, 2.0),))
    found = valves_by_paths([bound(exported(lagging, 4, 1), Spec())], INTEGRATOR, rests=(False,), noise=0.01)
    assert [done.model.spec.process for done in found] == [FIRST_ORDER]
    assert found[0].evaluated.values["S"] == pytest.approx(2.7, rel=0.02)


def test_no_valve_is_found_where_even_a_widely_scattered_one_explains_nothing() -> None:
    model = bound(exported(TANK, 4, 5), Spec(process=INTEGRATOR))
    start = model.vector({"S": 1.0, "J": 1.0, "initial_residual_force": 0.0, "time_constant_s": 5.0,
                          "dead_time_s": 4.0})
    assert settle_from_any_valve(model, start, 0.1, (0.0, 1.0), most=1e-6) is None
    fixed = bound(model.loop, Spec(process=INTEGRATOR, fixed={"S": 4.6}))
    assert settle_from_any_valve(fixed, start, 0.1, (0.0, 1.0)) is None


def test_with_few_hypotheses_slips_between_samples_are_lost() -> None:
    """With a command rebuilt at five scans a sample the likeliest slips need many hypotheses to be found."""
    model = bound(exported(TANK, 4, 5), Spec(process=INTEGRATOR, between=DECIMATED, substeps=5))
    values = model.vector({"S": 4.6, "J": 4.0, "initial_residual_force": 0.0, "time_constant_s": 5.4,
                           "dead_time_s": 3.8})
    start = likeliest_slips(model.along(Paths(law_paths(model, values), 0.2, 0.05)), values)
    few, many = (score_path(model, values, likeliest_slips(model.along(start), values, few=few))
                 for few in (True, False))
    assert many.deviance < few.deviance - 20.0


RESTS = Setting(Plant(1.5, 10.0, 6.0), Controller(0.6, 20.0, scan_s=1.0), law="he", S=4.0, J=2.0, noise_sd=0.01,
                duration_s=3000.0, setpoint_moves=((0.0, 3.0), (1500.0, -2.0)))


def rebuilt() -> tuple[Model, Settled]:
    """A valve that rests, at every fifth scan, its command rebuilt; settled from its true values, landing exactly."""
    model = bound(exported(RESTS, 4, 5), Spec(between=DECIMATED, substeps=5, effects=("re-sticking",)))
    values = model.vector({"S": 4.0, "J": 2.0, "initial_residual_force": 0.0, "time_constant_s": 10.0,
                           "dead_time_s": 6.0, "re-sticking:restick_speed": 1e9})
    return model, settle_path(model, values)


@pytest.mark.parametrize("commands", [-2, 2])
def test_slips_that_all_move_take_the_stickband_along(commands: int) -> None:
    """The stem keeps its places if f_s and f_d change by what the command does in between: S does, J does not."""
    model, truth = rebuilt()
    moved = all_slips_moved(truth, commands)
    assert moved is not None
    values, paths = moved
    assert (values[0] - truth.values[0]) * commands > 0.0 and values[1] == truth.values[1]
    assert values[4] == pytest.approx(truth.values[4] - commands)
    stays = truth.values.copy()
    stays[4] = values[4]
    left = [score_path(model, v, paths).left for v in (values, stays)]
    assert left[0] < 0.75 * left[1]


def test_a_valve_whose_slips_all_come_late_is_found_along_the_ridge() -> None:
    """Every slip had been placed by itself, at another S and a dead time that made up for it."""
    model, truth = rebuilt()
    values, error = truth.values, likely_errors(model, truth.values)[0]
    moved = all_slips_moved(truth, 4)
    assert moved is not None and moved[0][0] > 1.05 * 4.0
    late = settle_path(model, moved[0], error=error, begin=moved[1], rounds=2, seek=False)
    found = settle_near([late], error, error_range(model, values), tries=0)
    assert found.deviance < late.deviance - 20.0 and found.values[0] == pytest.approx(4.0, rel=0.05)


def test_a_command_rebuilt_by_its_law_errs_by_little_more_than_the_noise_that_it_passes_on() -> None:
    """The sum of a PI law tells a single scan between two rows, and the mean of more."""
    for every, noise in ((2, 0.01), (5, 0.03)):
        loop = exported(replace(TANK, noise_sd=noise), 4, every)
        held, law = (bound(loop, spec) for spec in (Spec(process=INTEGRATOR),
                                                    Spec(process=INTEGRATOR, between=DECIMATED, substeps=every)))
        values = law.vector({"S": 4.6, "J": 4.0, "initial_residual_force": 0.0, "time_constant_s": 5.4,
                             "dead_time_s": 3.8})
        hidden = hidden_noise(loop, every)
        assert hidden == pytest.approx(2.0 * noise, rel=0.4)
        assert errs_by_scan(law) == (every == 5) and not errs_by_scan(held)
        if every == 2:
            assert error_range(law, values)[1] == pytest.approx(3.0 * hidden)
            continue
        assert error_range(held, values)[1] > 6.0 * hidden and error_range(law, values) == (0.0, 0.0)
        assert likely_errors(law, values) == pytest.approx((np.sqrt(3.0 / 4.0) * hidden,))
        manual = Loop(output=loop.output, process_value=loop.process_value, step_s=loop.step_s)
        assert hidden_noise(manual, 5) is None
        assert unseen_noise(manual, 5) == pytest.approx(noise_of(loop.output))


def test_noise_of_unseen_scans_hides_the_scatter_of_a_force() -> None:
    model = bound(exported(TANK, 8, 5), Spec(process=INTEGRATOR, between=DECIMATED, substeps=5))
    values = model.vector({"S": 4.6, "J": 4.0, "initial_residual_force": 0.0, "time_constant_s": 5.4,
                           "dead_time_s": 3.8})
    found = settle_path(model, values, error=likely_errors(model, values)[0])
    assert found.paths.by_scan and found.left == pytest.approx(0.03, rel=0.1) and found.moved < 0.1
    assert found.values[0] == pytest.approx(4.6, rel=0.05)
    assert scatter_of(found.along, found.values, "%") is None
    wide = replace(found.paths, scatter=0.05 * found.values[0])
    assert scatter_of(model.along(wide), found.values, "%") is None
    assert scatter_of(model.along(replace(wide, by_scan=False)), found.values, "%") is not None


def test_a_course_rebuilt_at_unseen_scans_is_the_first_to_explain_slips() -> None:
    loop = exported(TANK, 4, 5)
    courses = [bound(loop, Spec(process=INTEGRATOR)), bound(loop, Spec(process=INTEGRATOR, between=DECIMATED,
                                                                       substeps=5))]
    found = valves_by_paths(courses, INTEGRATOR, rests=(False,))
    assert [f.model.spec.between for f in found] == [DECIMATED]  # (held it is far less likely)
    values = found[0].evaluated.values
    assert [values["S"], values["J"]] == pytest.approx([4.6, 4.0], rel=0.05)


def test_valves_are_sought_beside_effects_that_were_found_with_another_one() -> None:
    loop = exported(TANK, 4, 5)
    wave = "sinusoidal-disturbance"
    swings = replace(loop, process_value=loop.process_value + 0.5 * np.sin(0.021 * np.arange(loop.samples) * 5.0))
    model = bound(swings, Spec(process=INTEGRATOR, effects=(wave,)))
    wrong = complete_quickly(model, model.vector({
        "S": 3.0, "J": 1.0, "initial_residual_force": 0.0, "time_constant_s": 9.0, "dead_time_s": 8.0,
        f"{wave}:period_s": 2.0 * np.pi / 0.021}))
    found = valves_by_paths([model], INTEGRATOR, rests=(False,), beside=wrong)
    assert found[0].model.spec.effects == (wave,)
    assert found[0].evaluated.values["S"] == pytest.approx(4.6, rel=0.06)


def test_a_scatter_at_its_bound_stands_for_what_is_missing() -> None:
    model, truth = rebuilt()
    assert not scatters_at_most(truth.along, truth.values) and not scatters_at_most(model, truth.values)
    most = bounds(model, truth.values, truth.paths.error)[1]
    assert scatters_at_most(model.along(replace(truth.paths, scatter=most)), truth.values)


def test_without_friction_a_valve_follows_its_command_and_no_path() -> None:
    """Along a path it waited for slips; with an error of landing its place was no number, and a search broke off."""
    model, truth = rebuilt()
    error, within = likely_errors(model, truth.values)[0], error_range(model, truth.values)
    done = along_slips(settle_path(model, truth.values, error=error, within=within))
    assert done.model.spec.paths is not None and done.model.spec.paths.landing is not None
    follows = model.vector({**model.named(done.values), "S": 0.0, "J": 0.0})
    left = Scored(done, True).without_friction
    assert left == pytest.approx(model.evaluate(follows).rmse) and left > 2.0 * done.evaluated.rmse
