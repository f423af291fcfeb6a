"""The budget of a search: what it charges, where it ends, and what it allows an answer that came late."""

from __future__ import annotations

import numpy as np
import pytest
from real_nodes import recorded, scored

from stictionid.model.spec import Spec
from stictionid.selection.crew import Budget, Crew
from stictionid.selection.looks import FAR, Ground, Task, pool_of
from stictionid.selection.node import key
from stictionid.selection.policy import Policy
from stictionid.selection.score import point_in_search_form


def test_valves_are_counted_once_beside_the_budget_and_the_rest_is_left_where_it_ends() -> None:
    """Looks at a stop search for valves on growing records: the second look asks for the same search again."""
    fit = point_in_search_form(scored(recorded(0.2 * np.random.default_rng(4).standard_normal(300))), Spec())
    stop, uneven = (Task(Spec(effects=(name,)), name, FAR) for name in ("travel-limit", "asymmetric-stiction"))
    tasks = [stop, stop, uneven, Task(Spec(effects=("extra-lag",)), "extra-lag")]
    unit = Policy().unit
    with Crew(Ground(fit, pool_of(fit, 0), 0, Policy()), 1) as crew:
        first, again, other = list(crew.map(tasks[:3]))
        searches = [sum(answer.questions.values()) // unit for answer in (first, other)]
        assert again.questions == first.questions and min(searches) > 0
        asked = first.spent + again.spent + other.spent
        budget = Budget(asked, unit)
        assert [task for task, _ in budget.answers(crew, tasks)] == tasks[:3]
    assert budget.once == sum(searches) and budget.counted == asked + budget.once and budget.over
    assert budget.unasked == [key(Spec(effects=("extra-lag",)))]
    budget.note_unasked(budget.unasked * 2)
    assert len(budget.unasked) == 1


def test_a_last_question_has_a_whole_budget_whatever_was_spent_before() -> None:
    budget = Budget(100, 10, spent=150, once=30, apart=50)
    with budget.allow_last_question():
        budget.spent += 99
        assert not budget.over
        budget.spent, budget.once = budget.spent + 1, budget.once + 20
        assert budget.over
    assert (budget.counted, budget.once, budget.apart) == (300, 50, 50)


def test_a_late_answer_gets_half_the_budget_until_as_much_as_the_budget_went_to_such() -> None:
    budget = Budget(100, 10)
    budget.spent = 120
    for _ in range(2):
        with budget.allow_late_answer():
            assert not budget.over
            budget.once += 500  # (valves that are searched once for a record take nothing of it)
            assert not budget.over
            budget.spent += 50
            assert budget.over
        assert budget.over and budget.share == pytest.approx(1.2)
    with budget.allow_late_answer():
        assert budget.over
