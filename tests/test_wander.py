"""A level of y that wanders in place of a slow disturbance: the valve that it leaves, and disturbances beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stictionid.fit.noise.completion import complete_quickly, place_slips
from stictionid.fit.valves_by_paths import (
    WANDERS,
    along_path_of,
    look_beside_wander,
    valves_by_paths,
    without_level,
)
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.segments import bind_model
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range

S, J, SHIFTS_S, NOISE = 4.6, 3.0, 2600.0, 0.02


def tank(seed: int, *, shift: float) -> Loop:
    """A tank whose load shifts once, exported at every fifth scan."""
    setting = Setting(Plant(0.0165, 5.4, 3.8, integrating=True), Controller(2.0, 120.0, scan_s=1.0), S=S, J=J,
                      noise_sd=NOISE, duration_s=6000.0,
                      effects=(("step-disturbance", {"at": "load", "size": shift, "time_s": SHIFTS_S}),))
    loop = simulate(setting, seed=seed).loop
    return Loop(output=loop.output[::5], process_value=loop.process_value[::5], setpoint=loop.setpoint[::5],
                step_s=5.0 * loop.step_s)


def model_of(loop: Loop, **options: object) -> Model:
    found = find_range(loop)
    return bind_model(loop, replace(Spec(), **options), s_max=found.s_max, period_s=found.period_median_s)


@pytest.mark.parametrize("process", [FIRST_ORDER, INTEGRATOR])
def test_a_level_that_wanders_is_straight_between_its_corners(process: str) -> None:
    loop = tank(1, shift=2.0)
    plain, wanders = model_of(loop, process=process), model_of(loop, process=process, knots=4)
    time = loop.time_s / loop.time_s[-1]
    corners = np.linspace(0.0, 1.0, 6)
    level = np.interp(time, corners, [0.0, 2.0, -1.0, 0.5, 0.0, 3.0])
    columns = wanders.shared_columns()
    size, *_ = np.linalg.lstsq(columns, level, rcond=None)
    assert np.abs(columns @ size - level).max() < 1e-9
    size, *_ = np.linalg.lstsq(plain.shared_columns(), level, rcond=None)
    assert np.abs(plain.shared_columns() @ size - level).max() > 0.5


def test_a_load_that_shifts_bends_no_valve_beside_a_level_that_wanders() -> None:
    found, = valves_by_paths([model_of(tank(4, shift=3.0))], FIRST_ORDER, rests=(False,), knots=WANDERS)
    fit = without_level(found)
    assert found.model.spec.process == INTEGRATOR and found.model.spec.paths and not fit.model.spec.knots
    best = place_slips(look_beside_wander(fit, "step-disturbance@load"))
    assert best.evaluated.values["S"] == pytest.approx(S, rel=0.05)
    assert best.evaluated.values["step-disturbance@load:time_s"] == pytest.approx(SHIFTS_S, abs=30.0)
    assert best.gain_over(look_beside_wander(fit)) > 400.0
    # A look keeps the slips, so that another disturbance can be held against it along the same ones.
    along = along_path_of(best, fit.model.spec)
    assert along is not None and along.model.spec.paths == best.model.spec.paths and not along.model.effects


def test_the_sign_of_the_controller_forbids_its_own_inverse_as_the_process() -> None:
    """A valve that follows its command and the inverse of the controller explain y at once, with the wrong sign."""
    loop = tank(3, shift=3.0)
    model = model_of(loop)
    follows = {"S": 0.1, "J": 0.1, "initial_residual_force": 0.0, "time_constant_s": model.step_s, "dead_time_s": 0.0}
    done = complete_quickly(model, model.vector(follows))
    assert done.evaluated.gain >= 0.0
    assert complete_quickly(model_of(replace(loop, setpoint=None)), model.vector(follows)).evaluated.gain < 0.0


def test_no_valve_is_sought_where_slips_are_not_replayed() -> None:
    loop = tank(1, shift=0.0)
    assert not valves_by_paths([model_of(loop, law="karnopp")], FIRST_ORDER, rests=(False,), knots=WANDERS)
