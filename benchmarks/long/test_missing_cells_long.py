"""Records with missing cells at length: an interval that holds S where the fit ends beside a step of the jump."""

from __future__ import annotations

import missing_cells

from stictionid.model.closed_loop import simulate
from stictionid.verbs.identify import identify


def test_s_is_inside_its_interval_where_the_fit_ends_beside_a_step_of_the_jump() -> None:
    setting = missing_cells.LOOPS["with-ramp"]
    estimate = identify(simulate(setting, seed=0).loop).estimate
    assert estimate is not None and estimate.S_interval is not None
    low, high = estimate.S_interval
    assert low <= setting.S <= high and high - low < 0.01 * setting.S
