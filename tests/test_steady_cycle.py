"""A steady limit cycle with one setpoint move: valves that rest and valves that slide, whose slips look alike."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.options import Options
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.verbs.identify import identify

S, J = 4.4, 2.3
RESTS = (("re-sticking", {"restick_speed": 1000.0}),)


def cycle(*, seed: int = 3, rests: bool = True, S: float = S, J: float = J) -> Loop:
    """A first order of 9 s with a dead time of 4 s under PI control, 1,400 s at 1 s, the setpoint moved by 3 at 5 s."""
    setting = Setting(Plant(2.4, 9.0, 4.0), Controller(0.1, 7.0, scan_s=1.0), S, J, duration_s=1400.0,
                      setpoint_moves=((5.0, 3.0),), noise_sd=0.08, effects=RESTS if rests else ())
    return replace(simulate(setting, seed=seed).loop, position=None)


@cache
def found(rests: bool) -> Study:
    """The study of a cycle."""
    return identify(cycle(rests=rests))


@pytest.mark.parametrize("rests", [False])
def test_the_valve_of_a_steady_cycle_is_found_whether_it_rests_or_slides(rests: bool):
    """One that rests is in benchmarks/long."""
    e = found(rests).estimate
    assert e is not None and e.S_interval is not None and e.J_interval is not None
    assert ("re-sticking" in found(rests).steps[-1].effects) == rests
    assert e.S_interval[0] <= S <= e.S_interval[1]
    assert e.J_interval[0] <= J <= e.J_interval[1]
    assert abs(e.S - S) <= 0.01 * S


def test_a_study_without_intervals_has_none_and_the_same_valve():
    study = identify(cycle(rests=False), options=Options(intervals=False))
    e, known = study.estimate, found(False).estimate
    assert e is not None and known is not None
    assert (e.S_interval, e.J_interval, e.gain_interval, e.dead_time_interval) == (None,) * 4
    assert all(p.interval is None for step in study.steps for p in step.parameters)
    assert abs(e.S - known.S) <= 0.01 * S and abs(e.J - known.J) <= 0.1 * J
