"""Valves found along paths from any start, on exports whose valve no free run by the law shows."""

from __future__ import annotations

import pytest

from stictionid.fit.valves_by_paths import valves_by_paths
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.replay import Paths
from stictionid.model.segments import bind_model
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.paths.any_valve import settle_from_any_valve
from stictionid.paths.likelihood import law_paths, likeliest_slips
from stictionid.paths.settle import score_path
from stictionid.process.scan import DECIMATED
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import swing_of, time_scale_s
from stictionid.verbs.identify import Options, identify

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


def test_a_tank_whose_export_hides_scans_shows_its_valve_along_paths_alone() -> None:
    model = bound(exported(TANK, 4, 5), Spec())
    found = valves_by_paths([model], INTEGRATOR, may_rest=False)
    assert len(found) == 1 and found[0].model.spec.paths is not None
    values = found[0].best.values
    assert values["S"] == pytest.approx(4.6, rel=0.06) and values["J"] == pytest.approx(4.0, rel=0.2)
    truth = {**values, "S": 4.6, "J": 4.0, "time_constant_s": 5.4, "dead_time_s": 3.8}
    plain = bound(model.loop, Spec(process=INTEGRATOR))
    assert plain.evaluate(plain.vector(truth)).rmse > 5.0 * 0.03


def test_a_lag_of_many_periods_becomes_an_integrator_where_that_is_likelier() -> None:
    found = valves_by_paths([bound(exported(TANK, 4, 5), Spec())], FIRST_ORDER, may_rest=False)
    assert found[0].model.spec.process == INTEGRATOR


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


def test_identify_finds_the_valve_of_a_tank_whose_export_hides_scans() -> None:
    """By the law alone S was 3 and J 8 % off, and the verdict undecided."""
    study = identify(exported(TANK, 6, 5), options=Options(intervals=False))
    assert study.estimate is not None and study.verdict is not None and study.verdict.stiction == "stiction"
    found = [study.estimate.S, study.estimate.J]
    assert found == pytest.approx([4.6, 4.0], rel=0.03)
