"""Memory of the search over models: looks never push out full fits, and nodes that passed keep their edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from real_nodes import SAMPLES, model_on, recorded, true_values
from real_nodes import scored as completed
from scipy.signal import lfilter
from study_factory import good, modelled

from stictionid.fit.noise.completion import along_slips, complete_quickly, place_slips
from stictionid.fit.points.fitted import as_it_stands
from stictionid.fit.with_effect import fit_along
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.segments import bind_model
from stictionid.model.spec import Spec
from stictionid.paths.settle import settle_path
from stictionid.record.study import Study
from stictionid.record.tree import Edge, Gate, TreeNode
from stictionid.selection.entry import ADD, ROOT, Entry, Memo, remember
from stictionid.selection.looks import Ground, Packed, Task, pool_of
from stictionid.selection.node import key
from stictionid.selection.policy import Policy
from stictionid.selection.refits import _hand_back_values, from_children
from stictionid.selection.run import base_of, resume_search
from stictionid.selection.score import Scored, complete_as_is, point_in_search_form

BARE, LAGGING = Spec(), Spec(effects=("extra-lag",))
DRIFTING = Spec(effects=("stiction-drift", "extra-lag"))
PASSED, FAILED = (Gate("gain", True, ""),), (Gate("gain", False, "it gains 3 BIC"),)


WHITE = 0.2 * np.random.default_rng(4).standard_normal(SAMPLES)


def scored(memory: float, innovations: float = 1.0, *, spec: Spec = DRIFTING, full: bool = True) -> Scored:
    """A node whose errors have a root `memory`, and innovations of so many times 0.2."""
    return completed(recorded(lfilter([1.0], [1.0, -memory], innovations * WHITE)), spec, full=full)


def asked(memo: Memo, parent: Entry, score: Scored) -> Packed:
    answer = Packed(DRIFTING, "stiction-drift", full=score.full)
    remember(memo, parent, Task(DRIFTING, "stiction-drift"), answer, score)
    return answer


@pytest.mark.parametrize("gates", [PASSED, FAILED])
def test_a_look_never_takes_the_place_of_a_full_fit(gates: tuple[Gate, ...]) -> None:
    """A look of half the free run once took the place of the best node, and was not fitted itself."""
    fit = Entry(DRIFTING, scored(0.97), key(LAGGING), ADD, "stiction-drift", gates=gates)
    memo, half = Memo(Policy(), entries=[fit]), scored(0.85, full=False)
    assert half.rmse < fit.scored.rmse / 2
    asked(memo, Entry(BARE, scored(0.99, spec=BARE)), half)
    assert memo[key(DRIFTING)] is fit and fit.scored.full and fit.gates == gates


@pytest.mark.parametrize(("op", "gates", "stays"), [(ADD, PASSED, True), (ADD, FAILED, False), (ROOT, (), True)])
def test_a_better_fit_leaves_a_node_that_passed_its_edge(op: str, gates: tuple[Gate, ...], stays: bool) -> None:
    """A node that passed beside one parent was judged anew beside another, and failed."""
    first, better = scored(0.9), scored(0.9, 0.8)
    before = Entry(DRIFTING, first, key(LAGGING), op, "extra-lag", gates=gates)
    other = Entry(BARE, scored(0.99, spec=BARE))
    memo = Memo(Policy(), entries=[before])
    asked(memo, other, scored(0.9, 1.1))
    assert memo[key(DRIFTING)] is before and before.scored is first
    asked(memo, other, better)
    now = memo[key(DRIFTING)]
    assert now.scored is better
    assert (now is before, now.parent) == ((True, key(LAGGING)) if stays else (False, key(BARE)))


def test_a_childs_better_valve_is_handed_back_to_its_parent() -> None:
    """A wrong basin looks like a missing effect: the further lag that came with the right valve adds nothing to it."""
    loop = recorded(WHITE)
    wrong = {"S": 4.6, "J": 1.2}
    parent, child = completed(loop, BARE, wrong), completed(loop, LAGGING)
    assert child.done.gain_over(parent.done) > 100.0
    fit = point_in_search_form(parent, BARE)
    ground = Ground(fit, pool_of(fit, 0), 0, Policy())
    found = from_children(ground, BARE, parent, [child])
    values = found.done.evaluated.values
    assert found.full and found.held is not None
    assert (values["S"], values["J"]) == (pytest.approx(3.6, rel=0.02), pytest.approx(2.6, rel=0.1))
    assert found.done.gain_over(child.done) > 0.0
    # A parent whose children know no better valve stays as it is.
    there = point_in_search_form(found, BARE)
    assert from_children(replace(ground, fit=there), BARE, found, [completed(loop, LAGGING, wrong)]) is found


def test_a_childs_valve_is_handed_back_by_its_law_to_a_parent_with_slips_in_other_places() -> None:
    """Refitted along its own slips the parent stayed 34 BIC behind, and a slew limit that limits nothing was named."""
    loop = recorded(WHITE)
    right, child = completed(loop, BARE), completed(loop, LAGGING)
    model, values = right.done.model, right.done.values.copy()
    values[:2] = 4.6, 1.2
    wrong = settle_path(model, values, rounds=1)
    parent = Scored(along_slips(wrong), True)
    assert child.done.gain_over(parent.done) > 100.0 and parent.done.model.spec.paths is not None
    fit = as_it_stands(wrong.along, wrong.values)
    found = from_children(Ground(fit, pool_of(fit, 0), 0, Policy()), BARE, parent, [child])
    assert found.done.model.spec.paths is None and found.done.gain_over(child.done) > 0.0
    handed = _hand_back_values(fit, [child], Policy())
    assert handed is not None and handed[0].spec.paths is None


def test_a_childs_path_is_handed_back_where_its_values_alone_do_not_help() -> None:
    """Without the lag of 4 s the child's values are far off, and PV shows no path from there."""
    lag = {"extra-lag:second_time_constant_s": 4.0}
    setting = Setting(Plant(2.0, 8.0, 3.0), Controller(0.25, 8.0, scan_s=1.0), S=4.0, J=2.0, noise_sd=0.08,
                      duration_s=1000.0, scatter=0.06, effects=(("extra-lag", {"second_time_constant_s": 4.0}),))
    loop = simulate(setting, seed=5).loop
    true = {"S": 4.0, "J": 2.0, "initial_residual_force": 0.0, "time_constant_s": 8.0, "dead_time_s": 3.0}
    bare, lagging = (bind_model(loop, spec, s_max=8.0, period_s=40.0) for spec in (BARE, LAGGING))
    parent = Scored(complete_quickly(bare, bare.vector({**true, "S": 4.6, "J": 1.2})), True)
    child = Scored(place_slips(complete_quickly(lagging, lagging.vector({**true, **lag}))), True)
    values = child.done.model.named(child.done.values)
    there = complete_as_is(bare, bare.vector({name: values[name] for name in true}))
    assert there.gain_over(parent.done) < 0.0 < child.done.gain_over(parent.done)
    fit = point_in_search_form(parent, BARE)
    ground = Ground(fit, pool_of(fit, 0), 0, Policy())
    found = from_children(ground, BARE, parent, [child])
    assert found.done.model.spec.paths is not None and found.rmse < parent.rmse / 10
    handed = fit_along(as_it_stands(child.done.model, child.done.values), BARE, bare.vector(values))
    assert handed.evaluated.values["S"] == pytest.approx(4.0, rel=0.05)
    # The likeliest slips of the base come later and make up for the lag, with a smaller S: they count where they win.
    assert found.done.gain_over(handed) >= 0.0 < handed.gain_over(parent.done)


def resumed(*tree: TreeNode) -> Study:
    """A study of one step, the base at its true values, with a tree."""
    model = model_on(recorded(WHITE[:300]), BARE)
    step = replace(good().study.steps[0], model=model.describe(model.vector(true_values())))
    return replace(good().study, steps=(step,), tree=tree)


def tree_node(number: int, what: str, status: str, *, parent: int | None = 0, **more: float) -> TreeNode:
    """A node of a stored tree at the true values of the base; without `more` numbers it has none at all."""
    values = {**true_values(), **more} if more else {}
    return TreeNode(number, parent, Edge(ROOT if parent is None else ADD, what), (what,) if parent is not None else (),
                    "chen, first-order, hold", "white", values, 0.2, 0.2, 0.0, status,
                    (Gate("fit", False, "no"),) if status == "failed" else PASSED)


def test_a_search_that_is_resumed_holds_the_full_fits_of_its_tree() -> None:
    """A look is not held: the search would not look there again. Nor is a node without numbers."""
    lag, step, stop = "extra-lag", "step-disturbance@output", "travel-limit"
    tree = (tree_node(0, "the base", "expanded", parent=None, S=3.7),
            tree_node(1, lag, "rejected", **{"J": 2.4, f"{lag}:second_time_constant_s": 2.0}),
            tree_node(2, "stiction-drift", "rejected"),
            tree_node(3, stop, "looked", **{f"{stop}:upper": 57.0}), tree_node(4, step, "failed"))
    on = resume_search(recorded(WHITE[:300]), resumed(*tree), seed=0)
    assert [*on.search.memo] == [key(BARE), key(LAGGING)]
    assert [(e.spec.effects, bool(e.failed)) for e in on.looked] == [((stop,), False), ((step,), True)]
    held = on.search.memo[key(LAGGING)]
    assert held.parent == key(BARE) and held.scored.full and on.search.memo.passed(held) and held.what == lag
    assert held.scored.done.evaluated.values["J"] == pytest.approx(2.4)
    # The model of the study explains more than the tree's fit of its node, and not every effect was asked for.
    assert on.here.scored.done.evaluated.values["S"] == pytest.approx(3.6, rel=0.01) and not on.here.asked


@pytest.mark.parametrize("searched", [True, False])
def test_slips_of_an_answer_are_moved_once(searched: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The search that made a study moved those of its answer; a fit that comes later has others."""
    tree = (tree_node(0, "the base", "expanded", parent=None, S=3.7),) if searched else ()
    on = resume_search(recorded(WHITE[:300]), resumed(*tree), seed=0)
    asked = []
    monkeypatch.setattr("stictionid.selection.nodes.move_all_slips", lambda done: asked.append(done) or done)
    assert on.search.move_slips(on.here) is on.here
    assert on.here.settled is searched and len(asked) == (0 if searched else 1)
    on.here.scored = replace(on.here.scored)
    for _ in range(2):
        on.search.move_slips(on.here)
    assert len(asked) == (1 if searched else 2)


def test_the_base_of_a_study_is_its_first_step_without_noise() -> None:
    study = modelled().study
    assert base_of(study) == ("extra-lag",) and len(study.steps[1].effects) == 2
    first = replace(study.steps[0], model={**study.steps[0].model, "effects": ["extra-lag", "coloured-noise"]})
    assert base_of(replace(study, steps=(first, study.steps[1]))) == ("extra-lag",)
