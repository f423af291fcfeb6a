"""Steady cycles at length: a valve that rests, and a ridge of J."""

from __future__ import annotations

from dataclasses import replace

import test_steady_cycle
from test_steady_cycle import RESTS, found

from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.intervals import united
from stictionid.record.study import study_from_json, to_json
from stictionid.record.tree import Equivalent
from stictionid.reports import wording
from stictionid.reports.facts import facts
from stictionid.verbs.identify import identify


def test_a_ridge_of_J_is_open_and_its_range_holds_the_truth():
    setting = Setting(Plant(1.5, 15.0, 6.0), Controller(0.1, 7.0, scan_s=1.0), 3.0, 1.2, duration_s=1400.0,
                      setpoint_moves=((5.0, 3.0),), noise_sd=0.08, effects=RESTS)
    study = identify(replace(simulate(setting, seed=1).loop, position=None))
    e = study.estimate
    assert e is not None and e.J_interval is not None and not e.J_known
    assert e.J_interval[0] <= setting.J <= e.J_interval[1]
    said = " ".join(facts(study).then)
    assert "setpoint move" in said and wording.apart(e.J, e.J_interval, e.J_pieces)[1] in said


def test_the_valve_of_a_steady_cycle_is_found_where_it_rests() -> None:
    test_steady_cycle.test_the_valve_of_a_steady_cycle_is_found_whether_it_rests_or_slides(True)


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
