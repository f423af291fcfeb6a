"""A valve that is repaired within a record is told with its time and both stickbands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from loops_with_effects import small
from quick_loops import HELD

from stictionid.model.closed_loop import simulate
from stictionid.record.loop import Finding, Origin
from stictionid.record.study import VALVE_CHANGED
from stictionid.reports.facts import valve_state
from stictionid.reports.story import action
from stictionid.verbs.add import add
from stictionid.verbs.identify import identify
from stictionid.verbs.support import REJECTED
from stictionid.verbs.valve_changes import change_of


def test_a_repaired_valve_is_told_with_its_time_and_both_stickbands() -> None:
    setting, loop = small("stiction-change")
    loop = replace(loop, position=None, origin=Origin(start="2026-03-14T09:13:20"))
    study = add(loop, identify(loop, options=HELD), "stiction-change")
    found = change_of(loop, study)
    step = study.steps[-1]
    assert step.supported and found is not None
    np.testing.assert_allclose(found.S, (1.6, 4.0), rtol=0.02)
    np.testing.assert_allclose(found.J, (1.0, 2.5), rtol=0.1)
    # The estimate, and all that is judged by it, is the valve as it is now.
    assert found.S[1] == study.estimate.S and study.severity.band == "significant"
    # The time is known from one slip to the next.
    assert found.at_interval_s[0] <= 400.0 <= found.at_interval_s[1]
    assert np.ptp(found.at_interval_s) < 60.0 and abs(found.at_s - 400.0) < 30.0
    said = next(f for f in step.findings if f.code == VALVE_CHANGED)
    assert said.statement == found.statement and "on 14 March 2026 at 09:" in found.statement
    assert found.statement.startswith("S changes from 1.") and found.at.startswith("2026-03-14T09:")
    # The page says the valve as it is now, and asks for no service of a valve that got better.
    state = valve_state(study)
    assert "of OP span now, significant" in state and found.statement in state
    worse, better = ({"S": ends} for ends in ((1.6, 4.0), (4.0, 1.6)))
    for evidence, asked in ((worse, "Service the valve"), (better, "S fell within this record")):
        told = replace(step, findings=(replace(said, evidence=evidence),))
        assert asked in action(replace(study, steps=(told,)))
    # Without a calendar the seconds are said, and nothing where the record does not support the change.
    assert "s after the first sample" in change_of(replace(loop, origin=Origin()), study).statement
    refused = replace(step, findings=(Finding(REJECTED, "warning", "no", {}, (), ""),))
    assert change_of(loop, replace(study, steps=(*study.steps[:-1], refused))) is None
    # The same record without its change is another one.
    plain = simulate(replace(setting, effects=()), seed=21).loop
    assert np.ptp(plain.process_value[500:]) > np.ptp(loop.process_value[500:])
