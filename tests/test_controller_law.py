"""Controllers read from rounded records, the output rebuilt by their law, and S and J identified on it.

Which command the valve followed, and whole studies, are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace

import naive
import numpy as np
import pytest

from stictionid.model.closed_loop import Controller, Setting, preset, simulate
from stictionid.process.controller_law import controller_law
from stictionid.process.controller_words import as_read, steps_of
from stictionid.record.loop import Loop

STEP = 0.1
"""Step in which OP is recorded. Unit: %."""


def setting_of(derivative_time_s: float = 0.0, scan_s: float = 1.0) -> Setting:
    return replace(preset("foptd"), S=5.0, J=2.0, noise_sd=0.2, duration_s=900.0,
                   controller=Controller(0.1, 5.0, derivative_time_s, scan_s=scan_s))


def in_steps(signal: np.ndarray, step: float) -> np.ndarray:
    return np.round(np.rint(signal / step) * step, 9) if step else signal


def recorded(setting: Setting, seed: int, pv_step: float = 0.0) -> tuple[Loop, np.ndarray]:
    """A record with rounded signals, and its output with all digits."""
    loop = simulate(setting, seed=seed).loop
    return replace(loop, output=in_steps(loop.output, STEP), position=None,
                   process_value=in_steps(loop.process_value, pv_step)), loop.output


@pytest.mark.parametrize(("derivative_time_s", "pv_step"), [(0.0, 0.0), (0.0, 0.2), (1.0, 0.0), (1.0, 0.1)])
def test_a_controller_comes_back_from_a_rounded_record(derivative_time_s: float, pv_step: float) -> None:
    loop, full = recorded(setting_of(derivative_time_s), 1, pv_step)
    law = controller_law(loop)
    assert law is not None
    found = law.controller
    assert found.kind == ("PID" if derivative_time_s else "PI")
    assert found.gain == pytest.approx(0.1, rel=0.02) and found.integral_time_s == pytest.approx(5.0, rel=0.02)
    assert (found.derivative_time_s or 0.0) == pytest.approx(derivative_time_s, abs=0.15)
    for name, truth in (("gain", 0.1), ("integral_time_s", 5.0)):
        low, high = found.intervals[name]
        assert low - (high - low) < truth < high + (high - low)
    # The rebuilt output stays in the step in which each sample was recorded, and is closer to the truth.
    assert np.abs(law.command - loop.output).max() <= 0.5 * STEP + 1e-9
    error = float(np.sqrt(np.mean((law.command - full) ** 2)))
    assert error < 0.4 * float(np.sqrt(np.mean((loop.output - full) ** 2)))
    assert error < 2.0 * law.command_sd < 4.0 * error + 0.01


@pytest.mark.parametrize("derivative_time_s", [0.0, 1.0])
def test_the_law_is_that_of_the_written_regression(derivative_time_s: float) -> None:
    loop, _ = recorded(setting_of(derivative_time_s), 2)
    law = controller_law(loop)
    assert law is not None and len(law.stretches) == 1
    expected = naive.controller_numbers(loop.output, loop.setpoint, loop.process_value, loop.step_s,
                                        bool(derivative_time_s))
    found = law.controller
    assert (found.gain, found.integral_time_s, found.derivative_time_s or 0.0) == pytest.approx(expected, rel=1e-6)


def test_manual_saturation_and_a_change_of_tuning_end_a_stretch() -> None:
    first, second = (simulate(replace(setting_of(), controller=replace(setting_of().controller, gain=gain)),
                              seed=3).loop for gain in (0.1, 0.15))
    u = np.concatenate([first.output, second.output])
    u[300:420], u[1200:1300] = u[300], 100.0
    joined = [np.concatenate([getattr(part, name) for part in (first, second)])
              for name in ("process_value", "setpoint")]
    loop = Loop(output=in_steps(u, STEP), process_value=joined[0], setpoint=joined[1])
    law = controller_law(loop)
    assert law is not None
    obeys = np.zeros(u.size, bool)
    for part in law.stretches:
        obeys[part] = True
    assert obeys[100:299].all() and obeys[540:890].all() and obeys[1000:1199].all() and obeys[1420:1790].all()
    assert not obeys[310:410].any() and not obeys[1203:1300].any()
    assert np.array_equal(law.command[~obeys], loop.output[~obeys])


def test_a_record_without_a_law_gives_none() -> None:
    loop, _ = recorded(setting_of(), 4)
    other = np.cumsum(np.random.default_rng(0).standard_normal(loop.samples))
    continuous, _ = recorded(setting_of(scan_s=0.0), 4)
    assert controller_law(replace(loop, setpoint=None)) is None
    assert controller_law(replace(loop, output=in_steps(50.0 + other, STEP))) is None
    assert controller_law(continuous) is None and as_read(continuous) is None


def test_steps_are_null_where_none_shows() -> None:
    loop, full = recorded(setting_of(), 5)
    assert steps_of(loop).output == pytest.approx(STEP) and steps_of(loop).process_value is None
    assert steps_of(replace(loop, output=full)).output is None
