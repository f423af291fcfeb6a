"""A steady limit cycle with one setpoint move: valves that rest and valves that slide, whose slips look alike."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.options import Options
from stictionid.record.intervals import united
from stictionid.record.loop import Loop
from stictionid.record.study import Study, study_from_json, to_json
from stictionid.record.tree import Equivalent
from stictionid.reports import wording
from stictionid.reports.facts import facts
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


@pytest.mark.parametrize("rests", [True, False])
def test_the_valve_of_a_steady_cycle_is_found_whether_it_rests_or_slides(rests: bool):
    e = found(rests).estimate
    assert e is not None and e.S_interval is not None and e.J_interval is not None
    assert ("re-sticking" in found(rests).steps[-1].effects) == rests
    assert e.S_interval[0] <= S <= e.S_interval[1]
    assert e.J_interval[0] <= J <= e.J_interval[1]
    assert abs(e.S - S) <= 0.01 * S


def test_a_ridge_of_J_is_open_and_its_range_holds_the_truth():
    setting = Setting(Plant(1.5, 15.0, 6.0), Controller(0.1, 7.0, scan_s=1.0), 3.0, 1.2, duration_s=1400.0,
                      setpoint_moves=((5.0, 3.0),), noise_sd=0.08, effects=RESTS)
    study = identify(replace(simulate(setting, seed=1).loop, position=None))
    e = study.estimate
    assert e is not None and e.J_interval is not None and not e.J_known
    assert e.J_interval[0] <= setting.J <= e.J_interval[1]
    said = " ".join(facts(study).then)
    assert "setpoint move" in said and wording.apart(e.J, e.J_interval, e.J_pieces)[1] in said


def test_pieces_are_in_the_study_and_in_words():
    pieces = united([(2.4, 2.5), (4.9, 5.2), (2.1, 2.41)])
    assert pieces == ((2.1, 2.5), (4.9, 5.2))
    study = found(True)
    assert study.estimate is not None
    other = Equivalent(1, (), 4.7, 5.0, 0.0, "a setpoint move of 6")
    study = replace(study, equivalents=(other,),
                    estimate=replace(study.estimate, J_interval=(2.1, 5.2), J_pieces=pieces, J_known=False))
    again = study_from_json(to_json(study))
    assert again.estimate == study.estimate
    said = " ".join(facts(again).then)
    assert "2.10 to 2.50, or 4.90 to 5.20 %" in said
    assert "by whether the valve rests: a setpoint move of 6 would tell" in said


def test_a_study_without_intervals_has_none_and_the_same_valve():
    study = identify(cycle(rests=False), options=Options(intervals=False))
    e, known = study.estimate, found(False).estimate
    assert e is not None and known is not None
    assert (e.S_interval, e.J_interval, e.gain_interval, e.dead_time_interval) == (None,) * 4
    assert all(p.interval is None for step in study.steps for p in step.parameters)
    assert abs(e.S - known.S) <= 0.01 * S and abs(e.J - known.J) <= 0.1 * J
