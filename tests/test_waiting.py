"""The order in which nodes are asked, what an answer may do without, and the scan of all valves beside an effect."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from loops_with_effects import small

from stictionid.effects import parse
from stictionid.fit.moves import search_model
from stictionid.fit.starts.beside_effect import guessed_valves
from stictionid.model.segments import bind_model
from stictionid.model.spec import INTEGRATOR, Spec
from stictionid.record.tree import Gate
from stictionid.selection.decide import prune_effects
from stictionid.selection.entry import ADD, ROOT, Entry
from stictionid.selection.node import key
from stictionid.selection.policy import Policy
from stictionid.selection.score import beyond_noise
from stictionid.selection.search import Search
from stictionid.selection.waiting import nodes_to_ask

POLICY = Policy()


class Done:
    """A completed model of which only its score is known: BIC, free-run error and innovations."""

    good = None

    def __init__(self, bic: float, rmse: float, innovation_sd: float) -> None:
        self.value, self.rmse, self.innovation_sd, self.increments = bic, rmse, innovation_sd, False

    def gain_over(self, other: Done) -> float:
        return other.value - self.value

    def bic(self, good: None) -> float:
        return self.value


def entry(names: tuple[str, ...], bic: float, rmse: float, *, parent: Spec | None = None, process: str = "first-order",
          asked: bool = False, failed: str = "") -> Entry:
    done = Done(bic, rmse, 1.0)
    scored: Any = SimpleNamespace(done=done, rmse=rmse, white=False, full=True,
                                  needs_no_noise_model=lambda policy: rmse <= 1.0,
                                  only_noise=lambda policy: False,
                                  leaves_little=lambda policy: rmse <= policy.nearly * done.innovation_sd)
    gates = (Gate(failed, False, "no"),) if failed else ()
    spec = Spec(process=process, effects=names)
    return Entry(spec, scored, None if parent is None else key(parent), ROOT if parent is None else ADD,
                 names[-1] if names else "", gates=gates, asked=asked)


def memo_of(*entries: Entry) -> dict[str, Entry]:
    return {key(e.spec): e for e in entries}


def test_a_free_run_that_is_hardly_more_than_its_innovations_is_asked_before_another_base() -> None:
    base = entry((), 0.0, 9.0, asked=True)
    other = entry(("extra-lag",), -30.0, 8.0)
    best = entry(("travel-limit",), -200.0, 1.2, parent=base.spec)
    assert nodes_to_ask(memo_of(base, other, best), POLICY, only_some=False)[0] is best
    far = replace(best, scored=entry(("travel-limit",), -200.0, 5.0).scored)
    assert nodes_to_ask(memo_of(base, other, far), POLICY, only_some=False)[0] is not far


def test_a_free_run_half_of_that_of_every_base_is_asked_before_another_base() -> None:
    """A measured disturbance that took the free run from 11 to 1.7 waited until the budget was spent on bases."""
    base = entry((), 0.0, 9.0, asked=True)
    other = entry(("extra-lag",), -30.0, 8.0)
    half = entry(("measured-disturbance:D1",), -200.0, 4.0, parent=base.spec)
    assert nodes_to_ask(memo_of(base, other, half), POLICY, only_some=False)[0] is half


def test_a_base_that_bends_the_free_run_is_asked_but_is_no_answer() -> None:
    base = entry((), 0.0, 9.0, asked=True)
    bent = entry(("re-sticking",), -300.0, 20.0, parent=base.spec, failed="free-run")
    disturbed = entry(("ramp-disturbance@load",), -300.0, 20.0, parent=base.spec, failed="free-run")
    assert bent.tentative and not bent.passed and not disturbed.tentative
    assert nodes_to_ask(memo_of(base, bent), POLICY, only_some=False) == [bent]
    assert nodes_to_ask(memo_of(base, disturbed), POLICY, only_some=False) == []


def test_a_step_that_may_be_one_slip_is_asked_but_is_no_answer() -> None:
    """The step and a valve that rests took the free run from 2.2 to 1.0 times the noise; the step alone failed."""
    base = entry((), 0.0, 9.0, asked=True)
    step = entry(("step-disturbance@output",), -190.0, 5.0, parent=base.spec, failed="slip")
    assert step.tentative and not step.passed
    assert nodes_to_ask(memo_of(base, step), POLICY, only_some=False) == [step]


def test_an_effect_that_another_process_does_not_need_is_pruned() -> None:
    root = entry((), 0.0, 9.0)
    best = entry(("travel-limit", "gain-nonlinearity"), -300.0, 1.0, parent=root.spec)
    less = entry(("travel-limit",), -290.0, 1.0, parent=root.spec, process=INTEGRATOR)
    alone = entry(("travel-limit",), -220.0, 2.0)
    search: Any = SimpleNamespace(memo=memo_of(root, best, less), policy=POLICY, drop_effect=lambda e, name: alone,
                                  slow=False)
    assert prune_effects(search, best) is less
    search.memo = memo_of(root, best)
    assert prune_effects(search, best) is best


def test_nodes_that_are_each_others_parents_are_judged() -> None:
    root = entry((), 0.0, 9.0)
    one = entry(("re-sticking",), -300.0, 20.0, parent=Spec(effects=("extra-lag",)), failed="free-run")
    other = entry(("extra-lag",), -310.0, 21.0, parent=one.spec, failed="free-run")
    other.failed = "its refit did not converge"
    loop: Any = SimpleNamespace(samples=1000)
    search = Search(loop, POLICY, 0, 1, lambda words, share: None, memo=memo_of(root, one, other))
    search._judge(one)
    assert other.gates and not one.passed


def test_the_scan_of_all_valves_finds_the_one_beside_a_drift_from_a_wrong_one() -> None:
    setting, loop = small("stiction-drift")
    name = "stiction-drift"
    model = search_model(bind_model(loop, Spec(effects=(name,)), s_max=2.0 * setting.S, period_s=60.0))
    plant = setting.plant
    wrong = model.vector({"S": 0.5 * setting.S, "J": 0.1 * setting.J, "initial_residual_force": 0.0,
                          "time_constant_s": plant.time_constant_s,
                          "dead_time_s": plant.dead_time_s})
    effect, option = parse(name)
    assert effect.guess is not None
    guesses = effect.guess(model.context_of(option))
    found = model.values(guessed_valves(model, name, guesses, wrong))
    assert np.abs(found[0] / setting.S - 1.0).min() < 0.15


def test_a_record_too_short_for_the_noise_family_shows_no_model_to_be_better() -> None:
    done = Done(-50.0, 1.0, 1.0)
    done.good = np.ones(8, bool)
    done.model = SimpleNamespace(loop=SimpleNamespace(process_value=np.arange(8.0), starts=(0,)))
    assert beyond_noise(done) == -np.inf
