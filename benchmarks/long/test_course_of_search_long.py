"""Changes of structure that a search asks for only together, on whole searches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from real_nodes import recorded, search_among
from test_edges_of_search import LAG, REST, SHORT, WHITE, entry, slow

from stictionid.model.spec import INTEGRATOR, Spec
from stictionid.selection.node import key


def test_beside_a_further_lag_only_a_rest_is_asked_again() -> None:
    """The search asks for all structures beside another process: two changes may help only together."""
    base = entry(recorded(slow(0.9, samples=SHORT) + np.sign(np.sin(np.arange(SHORT) / 10.0))))
    search = search_among(base, only=frozenset({LAG, REST}))
    search.expand(base)
    assert {key(Spec(effects=(LAG, REST))), key(Spec(process=INTEGRATOR, effects=(REST,)))} <= search.memo.keys()
    assert key(Spec(process=INTEGRATOR, effects=(LAG,))) not in search.memo


def test_another_course_of_the_command_is_fitted_with_a_further_lag_beside_coloured_noise() -> None:
    """The record has both, and AR(1) noise: the held base leaves coloured noise, and neither change helps as much."""
    moving = Spec(between="corner", substeps=8)
    truth = replace(moving, effects=(LAG,))
    loop = recorded(slow(0.9, 0.5), truth, {f"{LAG}:second_time_constant_s": 6.0})
    for spec, errors in ((truth, slow(0.9, 0.5)), (Spec(), WHITE)):
        base = entry(loop if spec is truth else recorded(errors), asked=True)
        search = search_among(base, only=frozenset({LAG}))
        search.commands, search.may_place = (Spec(), moving), False
        best = search.run()
        assert (key(truth) in search.memo) is (spec is truth)
        assert (key(best.spec) == key(truth)) is (spec is truth)
