"""Gates on how much a few strokes, one slip, or an odd valve may explain; and looks that outlive the budget."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import naive
import numpy as np
import pytest

from stictionid.fit.cross_validation import Held
from stictionid.fit.noise.completion import stroke_score
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.selection.doubts import judge_drop, least_cost
from stictionid.selection.entry import Entry
from stictionid.selection.gates import GATES, Edge, chance_limit
from stictionid.selection.looks import CLOSER, Packed, Task
from stictionid.selection.node import key
from stictionid.selection.policy import Policy
from stictionid.selection.search import Search

POLICY, PERIOD = Policy(), 40


def completed(innovation: np.ndarray[Any, Any]) -> Any:
    """A completed model with these innovations, one a second, in a loop with a period of 40 s."""
    return SimpleNamespace(innovation=innovation, good=np.isfinite(innovation), increments=False, prior=0.0,
                           model=SimpleNamespace(period_s=PERIOD, step_s=1.0, spec=Spec()))


def pair(where: slice) -> tuple[Any, Any]:
    """Two models, one of which predicts better only at some samples; the innovations of both have gaps."""
    rng = np.random.default_rng(4)
    worse = rng.standard_normal(2000)
    worse[500:530] = np.nan
    better = worse.copy()
    better[where] *= 0.5
    return completed(worse), completed(better)


@pytest.mark.parametrize("where", [slice(None), slice(0, 60), slice(0, 2000, 3)])
def test_the_score_of_strokes_is_that_of_a_loop_over_half_cycles(where: slice) -> None:
    before, after = pair(where)
    said = naive.stroke_score(before.innovation, after.innovation, PERIOD // 2)
    assert stroke_score(before, after) == pytest.approx(said, rel=1e-9)


def test_a_gain_from_a_few_strokes_names_no_effect_on_the_valve() -> None:
    gate, limit = dict(GATES)["strokes"], chance_limit(POLICY)
    few, many = pair(slice(0, 60)), pair(slice(0, 2000, 3))
    assert stroke_score(*few) < limit < stroke_score(*many)
    for name, judged in (("travel-limit", True), ("stiction-drift", True), ("re-sticking", False),
                         ("step-disturbance@output", False), ("gain-drift", False)):
        for (before, after), rejected in ((few, judged), (many, False)):
            child = SimpleNamespace(done=after, free_run_at_noise=False, rmse=1.0)
            parent = SimpleNamespace(done=before, rmse=1.1)
            edge: Any = Edge(name, child, parent, POLICY)  # type: ignore[arg-type]
            assert bool(gate(edge)) is rejected, name


@pytest.mark.parametrize(("process", "error", "rejected"), [
    (FIRST_ORDER, 1.4, False), (FIRST_ORDER, 1.2, True), (INTEGRATOR, 1.4, True)])
def test_a_few_strokes_that_lower_the_free_run_clearly_will_do_but_for_an_integrator(process: str, error: float,
                                                                                      rejected: bool) -> None:
    """An integrator adds up every slip, so that one put right lowers the free run clearly."""
    before, after = pair(slice(0, 60))
    after.model.spec = Spec(process=process)
    child, parent = SimpleNamespace(done=after, free_run_at_noise=False, rmse=1.0), SimpleNamespace(done=before,
                                                                                                   rmse=error)
    edge: Any = Edge("travel-limit", child, parent, POLICY)  # type: ignore[arg-type]
    assert bool(dict(GATES)["strokes"](edge)) is rejected


@pytest.mark.parametrize(("process", "error", "more"), [
    (INTEGRATOR, 3.0, True), (INTEGRATOR, 0.9, False), (FIRST_ORDER, 3.0, False)])
def test_a_shift_is_believed_beyond_what_one_lost_slip_adds_up_to(process: str, error: float, more: bool) -> None:
    """A gain of 0.01 per second, a stickband of 5 and half a cycle of 20 s shift y by 1."""
    model = SimpleNamespace(period_s=40.0, spec=Spec(process=process))
    done = SimpleNamespace(model=model, increments=True, innovation_sd=0.01,
                           evaluated=SimpleNamespace(gain=0.01, values={"S": 5.0}))
    child, parent = SimpleNamespace(done=done, rmse=0.1, noise_alone=False), SimpleNamespace(rmse=error)
    edge: Any = Edge("step-disturbance@load", child, parent, POLICY)  # type: ignore[arg-type]
    assert edge.beyond_slip is more
    assert bool(dict(GATES)["slip"](edge)) is (process == INTEGRATOR and not more)


@pytest.mark.parametrize(("between", "believed"), [("hold", True), ("corner", False)])
def test_coloured_noise_alone_shows_that_no_slip_is_wrong_only_under_a_held_command(between: str,
                                                                                    believed: bool) -> None:
    """A ramp of a clean loop whose command moved put one slip right, with S 66 % off."""
    model = SimpleNamespace(period_s=40.0, spec=Spec(process=INTEGRATOR, between=between))
    done = SimpleNamespace(model=model, innovation_sd=0.01, evaluated=SimpleNamespace(gain=0.01, values={"S": 5.0}))
    child, parent = SimpleNamespace(done=done, rmse=0.1, noise_alone=True), SimpleNamespace(rmse=0.4)
    edge: Any = Edge("ramp-disturbance@output", child, parent, POLICY)  # type: ignore[arg-type]
    assert (dict(GATES)["slip"](edge) == "") is believed


@pytest.mark.parametrize(("tentative", "error", "believed"), [
    (True, 0.1, False), (True, 0.01, True), (False, 0.1, True)])
def test_beside_a_step_that_may_be_one_slip_both_together_are_judged(tentative: bool, error: float,
                                                                     believed: bool) -> None:
    """A rest beside such a step is an answer only where the free run with both is at the noise."""
    spec = Spec(process=INTEGRATOR, effects=("step-disturbance@output", "re-sticking"))
    done = SimpleNamespace(model=SimpleNamespace(period_s=40.0, spec=spec), innovation_sd=0.01,
                           evaluated=SimpleNamespace(gain=0.01, values={"S": 5.0}))
    child, parent, sound = (SimpleNamespace(done=done, rmse=rmse, noise_alone=False) for rmse in (error, 0.2, 0.5))
    edge: Any = Edge("re-sticking", child, parent, POLICY, tentative=tentative,  # type: ignore[arg-type]
                     sound=sound)  # type: ignore[arg-type]
    assert (edge.before is sound) is tentative
    assert (dict(GATES)["slip"](edge) == "") is believed


class Done(SimpleNamespace):
    """A completed model of which only the BIC and the valve are known."""

    def gain_over(self, other: Done) -> float:
        return float(other.bic - self.bic)


def valve(bic: float, slip_jump: float) -> Any:
    done = Done(bic=bic, evaluated=SimpleNamespace(values={"S": 4.0, "J": slip_jump}))
    return Entry(Spec(), SimpleNamespace(done=done))  # type: ignore[arg-type]


def test_a_slip_jump_beyond_the_stickband_must_beat_a_valve_that_rests() -> None:
    rests = Done(bic=0.0)
    usual, odd, clearly = valve(5.0, 3.0), valve(-5.0, 6.0), valve(-25.0, 6.0)
    assert least_cost("re-sticking", usual, POLICY) == POLICY.structure_margin
    assert least_cost("re-sticking", odd, POLICY) == -POLICY.margin == -least_cost("travel-limit", odd, POLICY)
    before: Any = SimpleNamespace(done=rests)
    assert judge_drop("re-sticking", usual, before, POLICY) == ()
    assert [g.passed for g in judge_drop("re-sticking", odd, before, POLICY)] == [False]
    assert judge_drop("re-sticking", clearly, before, POLICY) == ()


def test_a_look_is_kept_where_the_budget_ends_before_it_is_polished(monkeypatch: pytest.MonkeyPatch) -> None:
    loop: Any = SimpleNamespace(samples=1000)
    search = Search(loop, POLICY, 0, 1, lambda words, share: None)
    root: Any = Entry(Spec(), SimpleNamespace(done=Done(bic=0.0), rmse=2.0, white=False))  # type: ignore[arg-type]
    look = Packed(Spec(effects=("travel-limit",)), "travel-limit")
    found: Any = Entry(look.spec, SimpleNamespace(done=Done(bic=-90.0), rmse=1.0), look=look)  # type: ignore[arg-type]
    search.memo = {key(root.spec): root, key(look.spec): found}
    stages: list[str] = []

    def perform(_self: Search, _ground: Any, _entry: Any, tasks: list[Task]) -> list[Packed]:
        stages.extend(t.stage for t in tasks)
        return [] if tasks[0].stage == CLOSER else [look]

    monkeypatch.setattr(Search, "_perform_tasks", perform)
    ground: Any = None
    assert search._look_at_tasks(ground, root, [Task(look.spec, "travel-limit")]) == [look]
    assert stages == ["far", CLOSER]


def held(one_step: list[float], level: float) -> Held:
    rows = np.full(5, 100.0)
    return Held(np.square(one_step) * rows, rows, np.full(5, level**2) * rows, rows)


def edge(after: Held, before: Held, *, walks: bool = False) -> Edge:
    child: Any = SimpleNamespace(held=after, done=SimpleNamespace(increments=walks, prior=0.0), free_run_at_noise=True,
                                 rmse=1.0)
    parent: Any = SimpleNamespace(held=before, done=SimpleNamespace(increments=False, prior=0.0), rmse=9.0)
    return Edge("gain-nonlinearity", child, parent, POLICY)


def test_a_block_predicted_worse_is_no_reason_where_the_held_out_free_run_is_halved() -> None:
    before, worse = held([1.4, 1.3, 1.3, 1.3, 1.3], 5.0), [2.2, 1.0, 1.0, 1.0, 1.0]
    assert dict(GATES)["held-out"](edge(held(worse, 1.3), before)) == ""
    assert dict(GATES)["held-out"](edge(held(worse, 3.0), before)) != ""
    assert dict(GATES)["held-out"](edge(held(worse, 1.3), before, walks=True)) != ""
    assert dict(GATES)["held-out"](edge(held([2.2, 1.3, 1.3, 1.3, 1.3], 1.3), before)) != ""
