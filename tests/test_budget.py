"""The budget of a search: what it charges, where it ends, and what it allows an answer that came late."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stictionid.fit.cross_validation import Held
from stictionid.model.spec import Spec
from stictionid.selection.crew import Budget
from stictionid.selection.decide import _idle
from stictionid.selection.gates import Edge, _held_out
from stictionid.selection.looks import Packed, Task
from stictionid.selection.node import key
from stictionid.selection.policy import Policy

POLICY = Policy()


def answers(budget: Budget, questions: list[dict[str, int]], spent: int) -> list[Packed]:
    tasks = [Task(Spec(effects=("extra-lag",) * i), "extra-lag") for i in range(len(questions))]
    found = [Packed(t.spec, t.added, spent=spent, questions=q) for t, q in zip(tasks, questions, strict=True)]
    crew: Any = SimpleNamespace(map=lambda asked: found)
    return [answer for _, answer in budget.answers(crew, tasks)]


def test_a_question_is_charged_once_and_the_rest_is_left_where_the_budget_ends() -> None:
    budget = Budget(100, 10)
    assert len(answers(budget, [{"a": 400}, {"a": 400}, {"b": 300}, {}], 20)) == 3
    assert budget.spent == 20 + 40 + 20 + 20 + 30 and budget.over
    assert budget.unasked == [key(Spec(effects=("extra-lag",) * 3))]
    budget.leave(budget.unasked * 2)
    assert len(budget.unasked) == 1


def test_a_late_answer_gets_half_the_budget_until_as_much_as_the_budget_went_to_such() -> None:
    budget = Budget(100, 10)
    budget.spent = 120
    for _ in range(2):
        with budget.late():
            assert not budget.over
            budget.spent += 50
            assert budget.over
        assert budget.over and budget.share == pytest.approx(1.2)
    with budget.late():
        assert budget.over


def held(one_step: list[float], level: float) -> Held:
    rows = np.full(5, 100.0)
    return Held(np.square(one_step) * rows, rows, np.full(5, level**2) * rows, rows)


def edge(after: Held, before: Held, *, walks: bool = False) -> Edge:
    child: Any = SimpleNamespace(held=after, done=SimpleNamespace(increments=walks), free_run_at_noise=True, rmse=1.0)
    parent: Any = SimpleNamespace(held=before, done=SimpleNamespace(increments=False), rmse=9.0)
    return Edge("gain-nonlinearity", child, parent, POLICY)


def test_a_block_predicted_worse_is_no_reason_where_the_held_out_free_run_is_halved() -> None:
    before, worse = held([1.4, 1.3, 1.3, 1.3, 1.3], 5.0), [2.2, 1.0, 1.0, 1.0, 1.0]
    assert _held_out(edge(held(worse, 1.3), before)) == ""
    assert _held_out(edge(held(worse, 3.0), before)) != ""
    assert _held_out(edge(held(worse, 1.3), before, walks=True)) != ""
    assert _held_out(edge(held([2.2, 1.3, 1.3, 1.3, 1.3], 1.3), before)) != ""


def test_a_rest_beside_noise_alone_must_show_in_a_slow_record() -> None:
    def scored(rmse: float) -> Any:
        return SimpleNamespace(rmse=rmse, done=SimpleNamespace(innovation_sd=rmse), bare=lambda policy: True)

    slow: Any = SimpleNamespace(policy=POLICY, slow=True)
    quick: Any = SimpleNamespace(policy=POLICY, slow=False)
    assert _idle(slow, scored(1.0), scored(1.05), "re-sticking")
    assert not _idle(slow, scored(1.0), scored(1.2), "re-sticking")
    assert not _idle(slow, scored(1.0), scored(1.05), "extra-lag")
    assert not _idle(quick, scored(1.0), scored(1.05), "re-sticking")
