"""The budget of a search: what it charges, where it ends, and what it allows an answer that came late."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from stictionid.model.spec import Spec
from stictionid.selection.crew import Budget
from stictionid.selection.looks import Packed, Task
from stictionid.selection.node import key


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
    budget.note_unasked(budget.unasked * 2)
    assert len(budget.unasked) == 1


def test_a_late_answer_gets_half_the_budget_until_as_much_as_the_budget_went_to_such() -> None:
    budget = Budget(100, 10)
    budget.spent = 120
    for _ in range(2):
        with budget.allow_late_answer():
            assert not budget.over
            budget.spent += 50
            assert budget.over
        assert budget.over and budget.share == pytest.approx(1.2)
    with budget.allow_late_answer():
        assert budget.over
