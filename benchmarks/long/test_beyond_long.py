"""A positioner at length: it comes back from its own simulation with nothing known."""

from __future__ import annotations

import numpy as np
import pytest
from loops_with_effects import NOISE, SMALL, small

from stictionid.fit.points.moves import descend_model
from stictionid.fit.starts.own_scan import scanned_starts
from stictionid.model.model import Model
from stictionid.model.spec import Spec


def test_a_positioner_comes_back_from_its_own_simulation_with_nothing_known() -> None:
    setting, loop = small("positioner")
    model = Model(loop, Spec(effects=("positioner",)), s_max=float(np.ptp(loop.output)), period_s=40.0)
    found = scanned_starts(model, "positioner", model.vector(model.named(np.ones(model.space.size))), True)
    best = model.values(descend_model(model, found).points[:1])[:, 0]
    named = model.named(best)
    assert model.evaluate(best).rmse <= 1.05 * NOISE
    assert named["S"] == pytest.approx(setting.S, rel=0.02) and named["J"] == pytest.approx(setting.J, rel=0.03)
    assert named["positioner:integral_rate"] == pytest.approx(SMALL["positioner"][2]["integral_rate"], rel=0.05)
