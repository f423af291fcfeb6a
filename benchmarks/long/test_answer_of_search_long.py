"""Answers of the search at length: two lags in place of a ringing process."""

from __future__ import annotations

import test_answer_of_search
from real_nodes import recorded
from test_answer_of_search import LAG, WHITE, entry, search_among

from stictionid.model.spec import Spec
from stictionid.selection.decide import simplify_effects
from stictionid.selection.node import key

RINGS = "underdamped-process"


def test_two_lags_in_place_of_a_ringing_process_keep_what_its_gates_found() -> None:
    loop = recorded(WHITE, Spec(effects=(LAG,)), {f"{LAG}:second_time_constant_s": 8.0})
    base = entry(loop)
    rings = entry(loop, RINGS, values={f"{RINGS}:damping": 1.0, f"{RINGS}:natural_period_s": 73.0}, parent=base)
    # (no child of the base, whose gates would be asked once more)
    lag = entry(loop, LAG, values={f"{LAG}:second_time_constant_s": 8.0}, parent=rings, failed="scans")
    search = search_among(base, lag, rings)
    search.drops = {(key(rings.spec), RINGS, rings.scored.done.innovation_sd): base}
    assert simplify_effects(search, rings, ()) is lag
    assert search.memo.passed(lag)


def test_a_lag_that_the_best_node_no_longer_needs_is_dropped() -> None:
    test_answer_of_search.test_a_lag_that_the_best_node_no_longer_needs_is_dropped(False)
