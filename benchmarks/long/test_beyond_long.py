"""A positioner at length: it comes back from its own simulation with nothing known."""

from __future__ import annotations

import numpy as np
import pytest
from loops_with_effects import NOISE, SMALL, small

from stictionid.fit.points.moves import descend_model
from stictionid.fit.starts.own_scan import scanned_starts
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.system import evaluations
from stictionid.verbs.identify import Options, identify


def test_a_positioner_comes_back_from_its_own_simulation_with_nothing_known() -> None:
    setting, loop = small("positioner")
    model = Model(loop, Spec(effects=("positioner",)), s_max=float(np.ptp(loop.output)), period_s=40.0)
    found = scanned_starts(model, "positioner", model.vector(model.named(np.ones(model.space.size))), True)
    best = model.values(descend_model(model, found).points[:1])[:, 0]
    named = model.named(best)
    assert model.evaluate(best).rmse <= 1.05 * NOISE
    assert named["S"] == pytest.approx(setting.S, rel=0.02) and named["J"] == pytest.approx(setting.J, rel=0.03)
    assert named["positioner:integral_rate"] == pytest.approx(SMALL["positioner"][2]["integral_rate"], rel=0.05)


def test_samples_at_the_end_of_a_range_are_left_out_from_the_start() -> None:
    setting, loop = small("measurement-limit")
    study = identify(loop, options=Options(between="hold", base_only=True))
    assert study.steps[0].effects == ("measurement-limit",) and study.estimate is not None and study.adequate
    assert pytest.approx(setting.S, rel=0.02) == study.estimate.S
    rows = {p.name: p.value for p in study.steps[0].parameters if p.effect == "measurement-limit"}
    assert rows == {"upper": pytest.approx(SMALL["measurement-limit"][2]["upper"])}


def test_a_search_for_a_positioner_ends_where_the_model_without_it_leaves_less() -> None:
    _setting, loop = small()
    alone = Model(loop, Spec(), s_max=float(np.ptp(loop.output)), period_s=40.0)
    noise = np.random.default_rng(3).normal(0.0, 0.5 * NOISE, loop.samples)
    model = Model(loop, Spec(effects=("positioner",)), s_max=alone.s_max, period_s=40.0, residual=noise)
    before = evaluations.samples_spent()
    assert len(scanned_starts(model, "positioner", model.vector(model.named(np.ones(7))), True)) == 0
    # It has limits of its own, and takes nothing from the budget of the search around it.
    assert evaluations.samples_spent() == before
