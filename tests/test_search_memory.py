"""Memory of the search over models: looks never push out full fits, and nodes that passed keep their edge."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from stictionid.model.spec import Spec
from stictionid.record.tree import Gate
from stictionid.selection.entry import ADD, ROOT, Entry, remember
from stictionid.selection.looks import Packed, Task
from stictionid.selection.node import key
from stictionid.selection.policy import Policy

BARE, LAGGING = Spec(), Spec(effects=("extra-lag",))
DRIFTING = Spec(effects=("stiction-drift", "extra-lag"))
PASSED, FAILED = (Gate("gain", True, ""),), (Gate("gain", False, "it gains 3 BIC"),)


def scored(rmse: float, bic: float, *, full: bool = True) -> Any:
    done = SimpleNamespace(bic=bic)
    done.gain_over = lambda other: other.bic - done.bic
    return SimpleNamespace(done=done, rmse=rmse, full=full)


def asked(memo: dict[str, Entry], parent: Entry, score: Any) -> Packed:
    answer = Packed(DRIFTING, "stiction-drift", full=score.full)
    remember(memo, parent, Task(DRIFTING, "stiction-drift"), answer, score, Policy())
    return answer


@pytest.mark.parametrize("gates", [PASSED, FAILED])
def test_a_look_waits_beside_a_full_fit_where_its_free_run_is_better(gates: tuple[Gate, ...]) -> None:
    """A look of half the free run once took the place of the best node, and was not fitted itself."""
    fit = Entry(DRIFTING, scored(1.8, -100.0), key(LAGGING), ADD, "stiction-drift", gates=gates)
    other = Entry(BARE, scored(9.0, 0.0))
    memo = {key(DRIFTING): fit}
    look = asked(memo, other, scored(0.9, -90.0, full=False))
    assert memo[key(DRIFTING)] is fit and fit.scored.full and fit.gates == gates
    assert fit.look is look and fit.score_of_look(look).rmse == 0.9
    asked(memo, other, scored(1.2, -120.0, full=False))
    assert fit.look is look


@pytest.mark.parametrize(("op", "gates", "stays"), [(ADD, PASSED, True), (ADD, FAILED, False), (ROOT, (), True)])
def test_a_better_fit_leaves_a_node_that_passed_its_edge(op: str, gates: tuple[Gate, ...], stays: bool) -> None:
    """A node that passed beside one parent was judged anew beside another, and failed."""
    before = Entry(DRIFTING, scored(1.8, -100.0), key(LAGGING), op, "extra-lag", gates=gates)
    other = Entry(BARE, scored(9.0, 0.0))
    memo = {key(DRIFTING): before}
    asked(memo, other, scored(2.0, -90.0))
    assert memo[key(DRIFTING)] is before and before.scored.rmse == 1.8
    asked(memo, other, scored(1.0, -300.0))
    now = memo[key(DRIFTING)]
    assert now.scored.rmse == 1.0
    assert (now is before, now.parent) == ((True, key(LAGGING)) if stays else (False, key(BARE)))
