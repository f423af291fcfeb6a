"""Single hard loops: valves that rest on every process, a lag beside a valve effect, ramps, kicks, slow stems."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from loops_with_effects import VISIBLE, loop_of, shown, small
from plants.run import plant_of
from plants.score import loop_of as loop_of_plant

from stictionid.effects import parse
from stictionid.fit.points.fitted import as_it_stands
from stictionid.fit.points.moves import descend_model, with_start
from stictionid.fit.starts.beside_effect import guessed_valves, open_valves
from stictionid.fit.starts.continuation import grown_valves
from stictionid.fit.starts.intersample import as_moving
from stictionid.model.model import Model
from stictionid.model.segments import bind_model
from stictionid.model.spec import SOFT, Spec
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import swing_of, time_scale_s
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify

# The valve of this loop overshoots, and its process is of second order.
HIDDEN = (300, "slip-overshoot", 0.01, 0.0, 1500)


def slow_stem() -> tuple[Loop, dict[str, Any]]:
    """An integrator with a valve that rests and a slow stem, and its truth."""
    plant = plant_of("one", 80, 41_000)
    assert plant.truth["hidden"] == ["slew-limit"] and plant.truth["levels"]["valve"] == "resting"
    return loop_of_plant(plant), plant.truth


def test_a_part_that_grows_finds_a_valve_with_a_stop() -> None:
    setting, loop, (kind, _), _ = loop_of(314, "travel-limit", 0.01, 0.0, 1500)
    found = find_range(loop)
    spec = Spec(effects=("travel-limit",))
    spec = spec if kind == "scan" else Spec(effects=spec.effects, between="corner", substeps=4)
    model = Model(loop, spec, s_max=swing_of(loop, found), period_s=time_scale_s(loop, found))
    points = grown_valves(model, ("travel-limit",), np.random.default_rng(0))
    assert np.abs(model.values(points)[0] / setting.S - 1.0).min() < 0.03


@pytest.mark.parametrize(("seed", "colour", "added"), [
    (525, 0.0, ["re-sticking", "extra-lag"]), (739, 0.0, ["re-sticking"]), (958, 0.0, ["re-sticking"]),
    (407, 0.8, ["re-sticking", "coloured-noise"])])
def test_the_basin_of_a_valve_that_rests_is_found(seed: int, colour: float, added: list[str]) -> None:
    """Karnopp valves of plants of second and first order, an integrator and a tank: the first search ends 1.5 to 23
    times the noise away, on the ridge of S, J and dead time, or at a process without its second lag."""
    setting, loop, (kind, _), sd = loop_of(seed, None, 0.01, colour, 1500)
    assert kind == "karnopp"
    study = identify(loop)
    assert set(study.steps[-1].effects) == set(added)
    assert study.steps[-1].error.rmse < 1.05 * sd
    assert study.estimate is not None
    assert pytest.approx(setting.S, rel=0.005) == study.estimate.S
    assert pytest.approx(setting.J, rel=0.03) == study.estimate.J


@pytest.mark.xfail(strict=True, reason="a lag and a random walk are named with S of 3.53 %; true are a lag and a valve "
                                       "that overshoots, with S of 4.42 %")
def test_a_lag_and_a_valve_effect_are_found_together() -> None:
    setting, loop, _, sd = loop_of(*HIDDEN)
    after = diagnose(loop, identify(loop), apply=True)
    assert set(after.steps[-1].effects) == {"extra-lag", "slip-overshoot"}
    assert after.steps[-1].error.rmse < 1.05 * sd
    assert after.estimate is not None
    assert pytest.approx(setting.S, rel=0.03) == after.estimate.S


def test_an_integrator_shows_a_slow_ramp_in_its_level() -> None:
    _, loop, _, sd = loop_of(321, "ramp-disturbance", 0.01, 0.0, 1500)
    study = identify(loop)
    assert study.steps[-1].error.rmse > 2.0 * sd
    after = diagnose(loop, study, apply=True)
    # A ramp at the output of an integrator is a step at its load.
    assert set(after.missing) <= {"ramp-disturbance", "step-disturbance"} and after.missing
    assert after.steps[-1].error.rmse < 1.05 * sd


def test_what_a_record_cannot_show_is_told_from_the_truth() -> None:
    setting, loop, _, sd = loop_of(*HIDDEN)
    assert shown(setting, loop, "slip-overshoot", sd) > VISIBLE
    # A lag of 2 s stands for the 0.3 s of this integrator, and the dead time for the rest.
    setting, loop, _, sd = loop_of(300, "extra-lag", 0.01, 0.0, 1500)
    assert shown(setting, loop, "extra-lag", sd) < VISIBLE


def test_a_ramp_at_the_load_of_a_tank_is_found_on_the_right_process() -> None:
    setting, loop, _, sd = loop_of(322, "ramp-disturbance", 0.01, 0.0, 700)
    after = diagnose(loop, identify(loop), apply=True)
    assert after.missing == ("ramp-disturbance",) and after.adequate
    assert after.steps[-1].model["process"] == "first-order"
    assert after.steps[-1].error.rmse < 1.05 * sd
    assert after.estimate is not None
    assert pytest.approx(setting.S, rel=0.03) == after.estimate.S
    assert pytest.approx(setting.J, rel=0.03) == after.estimate.J


@pytest.mark.xfail(strict=True, reason="a step of 0.04 % at the load is named 22 s before the kick; nothing is hidden")
def test_a_valve_that_stops_elsewhere_at_a_kick_is_no_disturbance() -> None:
    """A slip arrives in the very sample in which the setpoint kicks the output of a continuous controller."""
    _, loop, (kind, _), _ = loop_of(703, None, 0.01, 0.0, 1500)
    assert kind == "moving"
    assert diagnose(loop, identify(loop)).missing == ()


def test_a_stickband_that_grows_is_found_in_an_integrator() -> None:
    """Valves that follow their command fit as well on short parts, with a third of the true stickband."""
    setting, loop, (kind, bed), sd = loop_of(716, "stiction-drift", 0.01, 0.0, 1500)
    assert (kind, bed) == ("scan", "integrator")
    after = diagnose(loop, identify(loop), apply=True)
    assert after.steps[-1].effects == ("stiction-drift",) and after.steps[-1].model["process"] == "integrator"
    assert after.steps[-1].error.rmse < 1.05 * sd
    assert after.estimate is not None
    assert pytest.approx(setting.S, rel=0.03) == after.estimate.S
    assert pytest.approx(setting.J, rel=0.03) == after.estimate.J


def test_a_valve_that_rests_is_found_beside_a_slow_stem() -> None:
    """S, J and rate trade against each other for as long as no process goes with them: a polish of all settles them."""
    setting, loop, _, _ = loop_of(401, "slew-limit", 0.01, 0.0, 1500)
    found = find_range(loop)
    model = Model(loop, Spec(effects=("re-sticking", "slew-limit")), s_max=swing_of(loop, found),
                  period_s=time_scale_s(loop, found))
    points = grown_valves(model, ("re-sticking", "slew-limit"), np.random.default_rng(0))
    valves = model.values(points)
    rates = valves[model.rows_of("slew-limit").start] / dict(setting.effects)["slew-limit"]["rate"]
    apart = np.stack([valves[0] / setting.S, valves[1] / setting.J, rates]) - 1.0
    assert np.abs(apart).max(axis=0).min() < 0.25


@pytest.mark.parametrize("seed", [
    pytest.param(335, marks=pytest.mark.xfail(strict=True, reason="a random walk is named with S of 4.34 %; true is a "
                                              "valve that overshoots by 1.58, with S of 4.61 %")), 337, 338])
def test_a_valve_that_overshoots_is_found_though_the_model_without_it_has_a_wrong_process(seed: int) -> None:
    """Scanned loops of a first order with dead time, an integrator and a tank."""
    setting, loop, (kind, _), sd = loop_of(seed, "slip-overshoot", 0.01, 0.0, 1500)
    assert kind == "scan"
    after = diagnose(loop, identify(loop), apply=True)
    assert after.steps[-1].effects == ("slip-overshoot",) and after.steps[-1].error.rmse < 1.05 * sd
    assert after.estimate is not None
    assert pytest.approx(setting.S, rel=0.02) == after.estimate.S
    overshoot = next(p.value for p in after.steps[-1].parameters if p.name == "overshoot")
    assert overshoot == pytest.approx(dict(setting.effects)["slip-overshoot"]["overshoot"], abs=0.05)


def test_a_valve_that_rests_under_a_moving_command_may_be_one_that_goes_past_its_place() -> None:
    """Both explained this record to the noise, and only the first was shown: its S is a quarter too small."""
    setting, loop, (kind, _), sd = loop_of(713, "slip-overshoot", 0.01, 0.0, 1500)
    assert kind == "moving"
    study = identify(loop)
    assert [step.added for step in study.steps] == [None, "re-sticking"]
    assert study.estimate is not None and study.estimate.S < 0.8 * setting.S
    found = diagnose(loop, study)
    assert found.missing == () and found.steps[-1].error.rmse < 1.05 * sd
    (other,) = found.equivalents
    assert other.effects == ("slip-overshoot",) and "position" in other.what_would_tell
    # The intervals reach beyond it, as far as its own; asking again changes nothing.
    assert found.estimate is not None and found.estimate.S_interval is not None
    assert other.S > 1.2 * study.estimate.S
    assert found.estimate.S_interval[0] <= study.estimate.S and found.estimate.S_interval[1] > other.S
    assert diagnose(loop, found) == found


def test_a_slow_stem_of_a_valve_that_rests_is_found_once_it_is_added_by_hand() -> None:
    loop, truth = slow_stem()
    after = add(loop, identify(loop), "slew-limit")
    assert set(after.steps[-1].effects) == {"re-sticking", "slew-limit"} and after.adequate
    values = {p.name: p.value for p in after.steps[-1].parameters}
    assert values["S"] == pytest.approx(truth["S"], rel=0.08) and values["J"] == pytest.approx(truth["J"], rel=0.08)
    assert values["rate"] == pytest.approx(truth["effects"]["slew-limit"]["rate"], rel=0.08)


@pytest.mark.xfail(strict=True, reason="a valve that rests is named alone with S of 4.54 %; its stem is slow, too, "
                                       "and S is 5.20 %")
def test_a_slow_stem_of_a_valve_that_rests_is_named() -> None:
    loop, truth = slow_stem()
    after = diagnose(loop, identify(loop), apply=True)
    assert "slew-limit" in after.steps[-1].effects
    assert after.estimate is not None and pytest.approx(truth["S"], rel=0.08) == after.estimate.S


@pytest.mark.xfail(strict=True, reason="no generator of four finds S, J and rate within 8 %; two should")
def test_a_valve_that_rests_is_found_beside_a_slow_stem_whatever_the_process() -> None:
    """Looks beside the process of the model so far, its dead time 5 s too long, ended with S 13 % too small.

    Five numbers are searched: half of the generators find them. Identified valves that rest are in benchmarks/long.
    """
    loop, truth = slow_stem()
    found = find_range(loop)
    spec = as_moving(Spec(process="integrator", increments=True, taps=SOFT))
    model = Model(loop, spec, s_max=swing_of(loop, found), period_s=time_scale_s(loop, found))
    wrong = as_it_stands(model, model.vector({"S": 4.5, "J": 2.7, "initial_residual_force": -0.9,
                                              "time_constant_s": 3.7, "dead_time_s": 8.8}))
    both = Model(loop, replace(model.spec, effects=("re-sticking", "slew-limit")), s_max=model.s_max,
                 period_s=model.period_s)
    found_by = 0
    for seed in range(4):
        if found_by == 2:
            break
        values = both.values(open_valves(both, "slew-limit", wrong, np.random.default_rng(seed)))
        rates = values[both.rows_of("slew-limit").start] / truth["effects"]["slew-limit"]["rate"]
        apart = np.stack([values[0] / truth["S"], values[1] / truth["J"], rates]) - 1.0
        found_by += bool(np.abs(apart).max(axis=0).min() < 0.08)
    assert found_by == 2


def test_a_scan_with_no_process_assumed_finds_the_valve_beside_a_process_that_is_far_off() -> None:
    """A slew limit of a slow tank was found so, at 2.5 times the noise; beside the wrong process it left 20 times.

    Valves that overshoot beside a wrong process are in benchmarks/long.
    """
    setting, loop = small("slew-limit")
    name, span = "slew-limit", {"s_max": 2.0 * setting.S, "period_s": 60.0}
    before, after = (bind_model(loop, Spec(effects=names), **span) for names in ((), (name,)))
    wrong = before.vector({"S": 0.3 * setting.S, "J": 0.0, "initial_residual_force": 0.0, "dead_time_s": 0.0,
                           "time_constant_s": 6.0 * setting.plant.time_constant_s})
    fit = as_it_stands(before, wrong)
    effect = parse(name)[0]
    assert effect.guess is not None
    beside = guessed_valves(after, name, effect.guess(after.context_of("")), after.vector(before.named(wrong)))
    free = open_valves(after, name, fit, np.random.default_rng(0))
    least, other = (float(descend_model(after, with_start(after, points)).costs[0]) for points in (free, beside))
    assert least < other / 4
