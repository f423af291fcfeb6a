"""Memory of the search over models: looks never push out full fits, and nodes that passed keep their edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from real_nodes import SAMPLES, recorded
from real_nodes import scored as completed
from scipy.signal import lfilter

from stictionid.model.spec import Spec
from stictionid.record.tree import Gate
from stictionid.selection.entry import ADD, ROOT, Entry, remember
from stictionid.selection.looks import Ground, Packed, Task, pool_of
from stictionid.selection.node import key
from stictionid.selection.policy import Policy
from stictionid.selection.refits import from_children
from stictionid.selection.score import Scored, point_in_search_form

BARE, LAGGING = Spec(), Spec(effects=("extra-lag",))
DRIFTING = Spec(effects=("stiction-drift", "extra-lag"))
PASSED, FAILED = (Gate("gain", True, ""),), (Gate("gain", False, "it gains 3 BIC"),)


WHITE = 0.2 * np.random.default_rng(4).standard_normal(SAMPLES)


def scored(memory: float, innovations: float = 1.0, *, spec: Spec = DRIFTING, full: bool = True) -> Scored:
    """A node whose errors have a root `memory`, and innovations of so many times 0.2."""
    return completed(recorded(lfilter([1.0], [1.0, -memory], innovations * WHITE)), spec, full=full)


def asked(memo: dict[str, Entry], parent: Entry, score: Scored) -> Packed:
    answer = Packed(DRIFTING, "stiction-drift", full=score.full)
    remember(memo, parent, Task(DRIFTING, "stiction-drift"), answer, score, Policy())
    return answer


@pytest.mark.parametrize("gates", [PASSED, FAILED])
def test_a_look_waits_beside_a_full_fit_where_its_free_run_is_better(gates: tuple[Gate, ...]) -> None:
    """A look of half the free run once took the place of the best node, and was not fitted itself."""
    fit = Entry(DRIFTING, scored(0.97), key(LAGGING), ADD, "stiction-drift", gates=gates)
    other = Entry(BARE, scored(0.99, spec=BARE))
    memo, half = {key(DRIFTING): fit}, scored(0.85, full=False)
    assert half.rmse < fit.scored.rmse / 2
    look = asked(memo, other, half)
    assert memo[key(DRIFTING)] is fit and fit.scored.full and fit.gates == gates
    assert fit.look is look and fit.score_of_look(look) is half
    sharper = scored(0.92, 0.9, full=False)
    assert half.rmse < sharper.rmse < fit.scored.rmse and sharper.done.gain_over(half.done) > 0.0
    asked(memo, other, sharper)
    assert fit.look is look


@pytest.mark.parametrize(("op", "gates", "stays"), [(ADD, PASSED, True), (ADD, FAILED, False), (ROOT, (), True)])
def test_a_better_fit_leaves_a_node_that_passed_its_edge(op: str, gates: tuple[Gate, ...], stays: bool) -> None:
    """A node that passed beside one parent was judged anew beside another, and failed."""
    first, better = scored(0.9), scored(0.9, 0.8)
    before = Entry(DRIFTING, first, key(LAGGING), op, "extra-lag", gates=gates)
    other = Entry(BARE, scored(0.99, spec=BARE))
    memo = {key(DRIFTING): before}
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
