"""The search over models at length: a process that rings gives way to two lags, or stays where it rings indeed."""

from __future__ import annotations

from dataclasses import replace

import pytest
from quick_loops import PLAIN, quick
from test_same_model import swung
from test_search import tree_tells_the_answer

from stictionid.fit.study_steps import open_last_model
from stictionid.model.closed_loop import Plant
from stictionid.selection.decide import simplify_effects
from stictionid.selection.node import key, with_effect
from stictionid.selection.policy import Policy
from stictionid.selection.search import Search
from stictionid.verbs.identify import identify


@pytest.mark.parametrize(("plant", "effects", "answer"), [
    (Plant(2.0, 6.0, 3.0, 4.0), (), {"extra-lag"}),
    (Plant(1.5, 10.0, 2.0), (("underdamped-process", {"natural_period_s": 40.0}),), {"underdamped-process"})])
def test_a_process_that_rings_gives_way_to_two_lags_that_explain_as_much(
        plant: Plant, effects: tuple[tuple[str, dict[str, float]], ...], answer: set[str]) -> None:
    """One that rings indeed stays."""
    loop = replace(quick(plant=plant, effects=effects, noise_sd=0.02), position=None)
    run, fit = open_last_model(loop, identify(loop, options=PLAIN), 0)
    search = Search(run.loop, Policy(), 0, 1, lambda words, share: None)
    root = search.root(fit)
    search.ask_for(root, ("underdamped-process",))
    rings = search.memo[key(with_effect(root.spec, "underdamped-process"))]
    assert set(simplify_effects(search, rings, ()).spec.effects) == answer
    assert simplify_effects(search, rings, ("underdamped-process",)) is rings


def test_the_tree_of_a_search_among_all_effects_tells_why_every_other_one_is_not_named() -> None:
    tree_tells_the_answer(swung(()), 11)


def test_a_look_far_behind_the_best_node_is_not_fitted_in_full() -> None:
    step = ("step-disturbance", {"time_s": 270.0, "size": 1.0, "at": "output"})
    loop = replace(quick(effects=(step,), noise_sd=0.02), position=None)
    run, fit = open_last_model(loop, identify(loop, options=PLAIN), 0)
    search = Search(run.loop, Policy(), 0, 1, lambda words, share: None)
    root = search.root(fit)
    search.ask_for(root, ("step-disturbance@output",))
    search.ask_for(root, ("step-disturbance@load",))
    output, load = (search.memo[key(with_effect(root.spec, f"step-disturbance@{at}"))] for at in ("output", "load"))
    assert search.best() is output and output.scored.full and not load.failed and not load.scored.full
    # Beside the root alone that look would have been fitted.
    assert load.scored.done.gain_over(root.scored.done) > 0.0 > load.scored.done.gain_over(output.scored.done) + 150.0
