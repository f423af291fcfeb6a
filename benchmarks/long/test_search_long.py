"""The search over models at length: a process that rings indeed stays one."""

from __future__ import annotations

import test_search

from stictionid.model.closed_loop import Plant


def test_a_process_that_rings_stays_where_two_lags_explain_less() -> None:
    test_search.test_a_process_that_rings_gives_way_to_two_lags_that_explain_as_much(
        Plant(1.5, 10.0, 2.0), (("underdamped-process", {"natural_period_s": 40.0}),), {"underdamped-process"})
