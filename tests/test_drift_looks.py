"""Looks at friction that drifts: they are settled, and compared with valves that slip by their law, too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from real_nodes import POLICY, SAMPLES, SETTINGS, model_on, recorded, scored, true_values

from stictionid.effects import parse
from stictionid.fit.noise.completion import complete_quickly, place_slips
from stictionid.fit.points.fitted import as_it_stands
from stictionid.model.closed_loop import simulate
from stictionid.model.spec import FIRST_ORDER, Spec
from stictionid.record.loop import Loop
from stictionid.selection.looks import FAR, NEAR, Ground, edge_adding, look_at, pool_of
from stictionid.selection.node import hidden_by_lag
from stictionid.selection.score import Scored

DRIFT = "stiction-drift"
GROWTH = {"stickband_growth": 0.9, "jump_growth": 0.2}
DRIFTS = {f"{DRIFT}:{name}": value for name, value in GROWTH.items()}
NOISE = 0.1


def loop_of_drift() -> Loop:
    """A closed loop whose friction grows along the record, with white noise on PV."""
    setting = replace(SETTINGS[FIRST_ORDER], duration_s=float(SAMPLES), effects=((DRIFT, GROWTH),))
    loop = simulate(setting).loop
    noise = NOISE * np.random.default_rng(8).standard_normal(SAMPLES)
    return replace(loop, position=None, process_value=loop.process_value + noise)


LOOP = loop_of_drift()


def ground(*, along: bool) -> Ground:
    """The ground of a base whose S is that of the middle of the record, also along the slips that PV shows."""
    done = scored(LOOP, values={"S": 4.2, "J": 2.8}).done
    done = place_slips(done) if along else done
    assert (done.model.spec.paths is not None) == along
    fit = as_it_stands(done.model, done.values)
    return Ground(fit, pool_of(fit, 0), 0, POLICY)


@pytest.mark.parametrize("along", [False, True])
def test_a_look_at_drifting_friction_is_settled_down_to_the_noise(along: bool) -> None:
    base = ground(along=along)
    task = edge_adding(base.fit.model.spec, DRIFT)
    far = look_at(base, replace(task, stage=FAR)).score_again(base.fit)
    near = look_at(base.by_law(), replace(task, stage=NEAR)).score_again(base.fit)
    assert far.least_rmse <= 1.1 * NOISE < 1.3 * NOISE < near.least_rmse
    assert far.done.evaluated.values[f"{DRIFT}:stickband_growth"] == pytest.approx(0.9, rel=0.2)


def test_a_valve_by_law_is_compared_by_law_and_one_along_slips_with_all_slips_as_placed() -> None:
    model = model_on(LOOP, Spec())
    wrong = complete_quickly(model, model.vector({**true_values(), "S": 4.2, "J": 2.8}))
    placed, drifts = Scored(place_slips(wrong), True), scored(LOOP, Spec(effects=(DRIFT,)), DRIFTS)
    assert placed.rmse < 0.5 * placed.rmse_by_law
    assert drifts.error_over(placed, placed) == drifts.least_rmse / placed.rmse_by_law
    assert placed.error_over(drifts) == placed.rmse / drifts.rmse
    assert placed.error_over(placed, drifts) == placed.rmse / min(placed.rmse, drifts.rmse)


def test_a_better_valve_shows_by_law_where_pv_placed_the_slips_of_both() -> None:
    """Slips that PV placed took up a stop: the look at the stop hardly lowered that error, but a tenth was left by law.
    """
    model = model_on(LOOP, Spec())
    wrong, nearer = (Scored(place_slips(complete_quickly(model, model.vector({**true_values(), **v}))), True)
                     for v in ({"S": 4.2, "J": 2.8}, {"S": 3.9, "J": 2.7}))
    assert wrong.done.model.spec.paths is not None and nearer.done.model.spec.paths is not None
    assert nearer.rmse_by_law / wrong.rmse_by_law < nearer.rmse / wrong.rmse
    assert nearer.error_over(wrong) == nearer.rmse_by_law / wrong.rmse_by_law


def test_an_error_is_compared_with_none_at_all() -> None:
    """A record that a model made may leave that model nothing to the last digit."""
    near, wrong = (scored(recorded(np.zeros(SAMPLES)), values=v) for v in (None, {"S": 3.7}))
    nothing = replace(near.done.evaluated, residual=np.zeros(SAMPLES))
    exact = replace(near, done=replace(near.done, evaluated=nothing))
    assert exact.rmse == 0.0 < wrong.rmse
    assert exact.error_over(exact) == 0.0 and wrong.error_over(exact) > 1e12 and exact.error_over(wrong) == 0.0


def test_a_further_lag_may_stand_in_for_drifting_friction_and_for_other_processes() -> None:
    assert hidden_by_lag(parse(DRIFT)[0]) and hidden_by_lag(parse("inverse-response")[0])
    assert not hidden_by_lag(parse("extra-lag")[0]) and not hidden_by_lag(parse("stiction-change")[0])
