"""The search over models: what it finds, what it leaves alone, and that asking again changes nothing.

Two answers that explain alike: benchmarks/long/test_grown_long.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from quick_loops import PLAIN, asked_only, quick
from test_same_model import FEW, NOISE, swung

from stictionid.effects import parse
from stictionid.fit.adequacy import NOISE_MODEL
from stictionid.fit.study_steps import open_last_model
from stictionid.model.spec import SOFT, Spec
from stictionid.record.loop import Loop
from stictionid.record.study import Study, study_from_json, to_json
from stictionid.selection.looks import SPEEDS, VALVES, Task
from stictionid.selection.node import key, node, spec_of, structure, with_effect
from stictionid.selection.policy import Policy
from stictionid.selection.search import Search
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify


@pytest.fixture(scope="module")
def found() -> tuple[Loop, Study, Study]:
    """A loop with a hidden sine, its study, and the study with what a search among a few effects found."""
    return swung(FEW)


def test_a_node_is_the_same_whatever_its_noise_and_the_order_of_its_effects() -> None:
    spec = Spec(effects=("extra-lag", "travel-limit"))
    assert key(spec) == key(node(replace(spec, effects=("travel-limit", "extra-lag", "coloured-noise"))))
    assert key(spec) != key(with_effect(spec, "re-sticking"))
    assert node(Spec(process="integrator")).taps == SOFT and not node(Spec(taps=(0.5,))).taps
    moving = replace(spec, between="corner", substeps=8)
    assert spec_of(structure(moving), moving.effects, Spec()) == node(moving)


def tree_tells_the_answer(found: tuple[Loop, Study, Study], asked: int) -> None:
    """The tree names the sine, and says of each other effect why it is not named; at least so many were asked."""
    _, before, after = found
    assert after.missing == ("sinusoidal-disturbance",) and after.steps[-1].error.rmse < 1.1 * NOISE
    named = {name for n in after.tree if n.status == "named" for name in n.effects}
    assert named == {"sinusoidal-disturbance"}
    assert all(c.rejected_because for c in after.candidates if not c.accepted)
    assert len({parse(n.edge.what)[0].name for n in after.tree if n.edge.op == "add"}) >= asked
    assert after.evaluations is not None and before.evaluations is not None
    assert after.evaluations > before.evaluations and after.unasked == ()
    rejected = [n for n in after.tree if n.status == "rejected"]
    assert all(any(not g.passed and g.reason for g in n.gates) or n.edge.op == "drop" for n in rejected)


def test_the_tree_tells_the_answer_and_why_every_other_effect_is_not_named(found: tuple[Loop, Study, Study]) -> None:
    """Among a few effects; benchmarks/long asks for all."""
    tree_tells_the_answer(found, 2)


def test_a_step_that_leaves_white_noise_has_no_finding_on_noise(found: tuple[Loop, Study, Study]) -> None:
    _, _, after = found
    assert after.steps[-1].model["taps"] == [] and NOISE_MODEL not in {f.code for f in after.steps[-1].findings}


def test_asking_again_changes_nothing(found: tuple[Loop, Study, Study]) -> None:
    loop, _, after = found
    with asked_only(*FEW):
        again = diagnose(loop, study_from_json(to_json(after)), apply=True)
    assert again.steps == after.steps and again.estimate == after.estimate and again.missing == ()
    assert again.candidates == after.candidates and len(again.tree) >= len(after.tree)


def test_a_small_budget_ends_the_search_and_lists_what_was_not_asked(found: tuple[Loop, Study, Study]) -> None:
    loop, before, _ = found
    after = diagnose(loop, before, apply=True, policy=Policy(budget=1))
    assert after.missing == () and len(after.unasked) > 10 and after.steps == before.steps
    assert after.evaluations is not None and before.evaluations is not None
    assert after.evaluations < before.evaluations + 50_000


def test_a_clean_loop_is_left_alone_within_a_few_evaluations() -> None:
    loop = quick()
    study = identify(loop)
    after = diagnose(loop, study, apply=True)
    assert after.missing == () and [s.added for s in after.steps] == [None] and after.adequate
    assert after.evaluations == study.evaluations
    assert np.isfinite(after.steps[-1].error.rmse)


def test_a_tree_names_each_node_once(found: tuple[Loop, Study, Study]) -> None:
    _, _, after = found
    ids = [n.id for n in after.tree]
    assert len(set(ids)) == len(ids) and all(n.parent is None or n.parent in ids for n in after.tree)


def test_a_look_at_the_beginning_of_a_long_record_is_compared_on_all_of_it() -> None:
    loop = replace(quick(effects=(("gain-nonlinearity", {}),), noise_sd=0.02), position=None)
    run, fit = open_last_model(loop, identify(loop, options=PLAIN), 0)
    search = Search(run.loop, Policy(fit_samples=250), 0, 1, lambda words, share: None)
    root = search.root(fit)
    search.ask_for(root, ("gain-nonlinearity",))
    found = search.memo[key(with_effect(root.spec, "gain-nonlinearity"))]
    assert not found.failed and found.scored.done.good.size == loop.samples


def test_valves_are_searched_once_beside_noise_alone_where_a_second_search_has_other_random_numbers_only() -> None:
    held, moving = (Task(Spec(effects=("re-sticking",), **course)) for course in
                    ({}, {"between": "corner", "substeps": 8}))
    for task, beside_noise, stages in ((held, True, [VALVES, SPEEDS]), (held, False, [VALVES, SPEEDS]),
                                       (moving, True, [VALVES]), (moving, False, [VALVES, SPEEDS])):
        assert [asked.stage for asked in task.for_valves(beside_noise)] == stages
