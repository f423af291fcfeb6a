"""Controller laws at length: S and J of a record whose output is rebuilt, and what later commands make of it."""

from __future__ import annotations

from dataclasses import replace

import naive
import numpy as np
import pytest
from test_controller_law import STEP, in_steps, recorded, setting_of

from stictionid.fit.context import Run
from stictionid.model.closed_loop import Controller
from stictionid.model.restore import described_segments, rerun
from stictionid.options import Options
from stictionid.process.rounded import step_of
from stictionid.record.controller import COMMAND_FINDINGS, LEFT, REBUILT
from stictionid.record.oscillation import find_range
from stictionid.record.study import study_from_json, to_json
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify
from stictionid.verbs.valve_command import full_over_rounded


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


def test_rounding_that_stays_is_said_first_and_j_is_then_a_range() -> None:
    setting = replace(setting_of(scan_s=0.0), controller=Controller(0.2, 5.0), duration_s=500.0)
    loop, _ = recorded(setting, 2)
    study = identify(loop)
    found = [f for f in study.data.findings if f.code in COMMAND_FINDINGS]
    assert [f.code for f in found] == [LEFT] and study.controller is None
    assert study.adequate_reason.startswith("the output is recorded in steps of 0.1 %")
    e = study.estimate
    assert e.J > 0.0 and e.J_known is bool(e.J_interval[1] - e.J_interval[0] <= 0.5 * e.J)


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
