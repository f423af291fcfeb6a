"""Controllers read from rounded records, the output rebuilt by their law, and S and J identified on it."""

from __future__ import annotations

from dataclasses import replace

import naive
import numpy as np
import pytest

from stictionid.fit.context import Run
from stictionid.model.closed_loop import Controller, Setting, preset, simulate
from stictionid.model.restore import described_segments, rerun
from stictionid.options import Options
from stictionid.process.controller_law import controller_law
from stictionid.process.controller_words import as_read, steps_of
from stictionid.process.rounded import step_of
from stictionid.record.controller import COMMAND_FINDINGS, LEFT, REBUILT
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.study import study_from_json, to_json
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify
from stictionid.verbs.valve_command import full_over_rounded

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


def test_identify_runs_on_the_rebuilt_output_and_so_do_later_commands() -> None:
    loop, _ = recorded(setting_of(), 1, 0.2)
    study = study_from_json(to_json(identify(loop)))
    e, controller = study.estimate, study.controller
    assert pytest.approx(5.0, rel=0.01) == e.S and pytest.approx(2.0, rel=0.1) == e.J
    assert e.S_interval[0] <= 5.0 <= e.S_interval[1] and e.J_interval[0] <= 2.0 <= e.J_interval[1] and e.J_known
    assert controller.kind == "PI" and controller.rebuilt and controller.seen_by_valve == "full"
    assert study.data.steps.output == pytest.approx(STEP) and study.data.steps.process_value == pytest.approx(0.2)
    assert study.severity.controller_gain == controller.gain
    assert [f.code for f in study.data.findings if f.code in COMMAND_FINDINGS] == [REBUILT]
    piece, _ = described_segments(loop, study.steps[-1].model)
    assert step_of(piece.output) == 0.0
    # Samples from which the model starts are no part of its error.
    assert np.nanstd(rerun(loop, study.steps[-1].model).residual) == pytest.approx(study.steps[-1].error.rmse, rel=0.02)
    after = diagnose(loop, study)
    assert after.missing == () and after.controller == controller
    old = to_json(study).replace('"controller"', '"left_out"').replace('"steps": {', '"left_out": {')
    assert study_from_json(old).controller is None


def test_y_tells_which_command_the_valve_followed() -> None:
    loop, full = recorded(setting_of(), 6)
    rounded = in_steps(full, 0.5)

    def run(output: np.ndarray, y: np.ndarray) -> Run:
        part = replace(loop, output=output, process_value=y)
        return Run(part, find_range(loop), Options(), law="chen", rng=np.random.default_rng(0),
                   tell=lambda text, share: None)

    for followed, sign in ((full, 1.0), (rounded, -1.0)):
        y = behind_valve(followed) + 0.2 * np.random.default_rng(1).standard_normal(loop.samples)
        assert sign * full_over_rounded(run(full, y), run(rounded, y)) > 10.0


def behind_valve(command: np.ndarray) -> np.ndarray:
    """y of a valve with S 5 %, J 2 %, a gain of 3, a dead time of 5 s and a lag of 5 s, sampled every second."""
    position = np.concatenate([np.full(5, command[0]), naive.chen(command, 5.0, 2.0)])[:command.size]
    y, state = [], 0.0
    for move in position - command[0]:
        y.append(50.0 + 3.0 * state)
        state += (move - state) * (1.0 - np.exp(-1.0 / 5.0))
    return np.array(y)


def test_rounding_that_stays_is_said_first_and_j_is_then_a_range() -> None:
    setting = replace(setting_of(scan_s=0.0), controller=Controller(0.2, 5.0), duration_s=500.0)
    loop, _ = recorded(setting, 2)
    study = identify(loop)
    found = [f for f in study.data.findings if f.code in COMMAND_FINDINGS]
    assert [f.code for f in found] == [LEFT] and study.controller is None
    assert study.adequate_reason.startswith("the output is recorded in steps of 0.1 %")
    e = study.estimate
    assert e.J > 0.0 and e.J_known is bool(e.J_interval[1] - e.J_interval[0] <= 0.5 * e.J)
