"""Records without noise: what a model leaves there is arithmetic, or less than a transmitter resolves.

Studies of a held command, and with a hidden effect, are in benchmarks/long.
"""

from functools import cache

import numpy as np
import pytest

from stictionid.fit.noise.whiteness import of_arithmetic
from stictionid.model.closed_loop import Controller, Plant, Setting, preset, simulate
from stictionid.model.segments import bind_model
from stictionid.model.spec import Spec
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.verbs.identify import identify

HELD = Setting(Plant(1.5, 10.0, 3.0), Controller(0.4, 12.0, scan_s=1.0), S=4.0, J=2.0, duration_s=900.0,
               setpoint_moves=((0.0, 3.0), (450.0, -2.0)))
TRUTH = {"S": 4.0, "J": 2.0, "initial_residual_force": 1.3 / 3.0, "time_constant_s": 10.0, "dead_time_s": 3.0}


@cache
def default() -> Study:
    """The study of the default loop of `simulate`."""
    return identify(simulate(preset("foptd")).loop)


def test_the_default_loop_of_simulate_is_adequate_and_nothing_is_named():
    study = default()
    assert study.adequate and "no transmitter resolves it" in (study.adequate_reason or "")
    assert study.steps[-1].effects == ()
    assert pytest.approx((5.0, 3.0), rel=0.02) == (study.estimate.S, study.estimate.J)


def test_the_position_of_a_moving_command_gives_the_stiction_of_the_valve():
    # The law at the samples alone has slips a sample late; it gave S 4.77 and J 4.87 %.
    position = default().estimate.from_position
    assert pytest.approx((5.0, 3.0), rel=0.02) == (position.S, position.J)


def test_errors_of_arithmetic_are_no_errors():
    loop = simulate(HELD).loop
    model = bind_model(loop, Spec(), s_max=8.0, period_s=60.0)
    exact = model.vector(TRUTH)  # (the first move of the setpoint puts 1.3 % of force on a stem that needs 3 %)
    assert model.evaluate(exact).rmse < loop.arithmetic_error
    assert model.costs_of(exact[:, None])[0] == pytest.approx(loop.samples * loop.arithmetic_error**2, rel=0.01)
    assert of_arithmetic(model, np.nan_to_num(model.evaluate(exact).residual))
    assert not of_arithmetic(model, np.full(loop.samples, 1e-6))


def test_setpoint_moves_are_no_swing():
    wave = np.sin(np.arange(1000) / 5.0)
    still = Loop(output=wave, process_value=50.0 + wave)
    moved = Loop(output=wave, process_value=50.0 + wave + np.where(np.arange(1000) < 250, 0.0, 40.0))
    assert still.resolution == pytest.approx(2e-3, rel=0.01)
    assert moved.resolution == pytest.approx(still.resolution, rel=0.01)
