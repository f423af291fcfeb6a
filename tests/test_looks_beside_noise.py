"""Looks at effects beside coloured noise: the noise model of the parent weighs them, not the free-run error alone."""

from __future__ import annotations

import pytest
from loops_with_effects import loop_of
from real_nodes import POLICY

from stictionid.fit.points.fitted import Fitted
from stictionid.fit.with_effect import look_under, widen_by
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import swing_of, time_scale_s
from stictionid.selection.looks import Ground, edge_adding, look_at, pool_of
from stictionid.selection.score import Scored, complete_as_is, complete_fit, point_in_search_form

BENT = "gain-nonlinearity"


def base_at_truth(seed: int) -> Fitted:
    """The base at its true values on a loop with a bent gain, under noise of the load that hides most of it."""
    setting, loop, _, _ = loop_of(seed, f"{BENT}+load-noise", 0.01, 0.0, 1500)
    found = find_range(loop)
    model = Model(loop, Spec(), s_max=swing_of(loop, found), period_s=time_scale_s(loop, found))
    values = model.vector({"S": setting.S, "J": setting.J, "initial_residual_force": 0.0,
                           "time_constant_s": setting.plant.time_constant_s, "dead_time_s": setting.plant.dead_time_s})
    return point_in_search_form(Scored(complete_as_is(model, values)), model.spec)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_look_beside_coloured_noise_is_no_less_likely_than_its_parent(seed: int) -> None:
    fit = base_at_truth(seed)
    before = complete_fit(fit)
    assert before.taps.size and before.evaluated.rmse > 5.0 * before.innovation_sd
    found = look_at(Ground(fit, pool_of(fit, 0), 0, POLICY), edge_adding(fit.model.spec, BENT)).score_again(fit).done
    assert found.gain_over(before) > POLICY.margin


@pytest.mark.parametrize("seed", [0, 1])
def test_under_the_noise_model_a_bent_gain_is_found_near_its_parent(seed: int) -> None:
    fit = base_at_truth(seed)
    before, model = complete_fit(fit), widen_by(fit, BENT)
    found = complete_as_is(model, look_under(before, model, BENT))
    assert found.gain_over(before) > POLICY.margin
    # (the same model at the values of its parent is that parent)
    same = complete_as_is(model, model.vector(fit.model.named(fit.values)))
    assert abs(same.gain_over(before)) < POLICY.margin
