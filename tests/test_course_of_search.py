"""The course of a search at its edges: what it asks, where its budget ends, and which valves it tries.

Each test fails on a fault that `benchmarks/mutants.py` drew and that no other test found: docs/mutants.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from quick_loops import PLAIN, asked_only, known, quick
from real_nodes import SAMPLES, model_on, recorded, scored, search_among, true_values
from study_factory import good
from test_edges_of_search import LAG, POLICY, REST, SHORT, STEP, STOP, WHITE, entry, slow
from test_load_noise import of_load
from test_steady_cycle import cycle

from stictionid.effects import parse
from stictionid.fit.noise.completion import Refit, complete_quickly
from stictionid.fit.points.fitted import as_it_stands
from stictionid.model.segments import bind_model
from stictionid.model.spec import INTEGRATOR, SOFT, Spec
from stictionid.record.loop import Finding, Loop
from stictionid.selection.doubts import add_rest_instead, add_same_slips
from stictionid.selection.entry import ADD, Entry
from stictionid.selection.looks import CLOSER, SPEEDS, VALVES, Ground, Packed, Task, perform_task, pool_of
from stictionid.selection.node import additions, key, kind_of, leaking_process, other_process, with_effect
from stictionid.selection.policy import Policy
from stictionid.selection.refits import from_children
from stictionid.selection.run import resume_search
from stictionid.selection.score import (
    COLOURED,
    WALKING,
    Scored,
    complete_as_is,
    complete_look,
    complete_with_noise,
    noise_name,
    point_in_search_form,
)
from stictionid.selection.search import Search
from stictionid.typing import FloatArray
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose


def spent(*entries: Entry, more: float = 3.0, only: frozenset[str] | None = None, policy: Policy = POLICY) -> Search:
    """A search that holds these nodes and has spent several budgets, so that it notes what it would ask."""
    search = search_among(*entries, only=only, policy=policy)
    search.budget.spent = int(more * policy.budget)
    return search


def unasked(search: Search) -> set[str]:
    """The effects of the nodes that a search did not come to."""
    return {name.partition(": ")[2] for name in search.budget.unasked}


def test_every_effect_that_may_be_added_is_asked_and_the_other_process() -> None:
    loop = recorded(slow(0.97, samples=SHORT))
    base = entry(loop)
    search = spent(base)
    search.expand(base)
    asked = set(additions(Spec(), loop))
    assert {STOP, REST, LAG, "slip-overshoot"} <= asked and asked <= unasked(search) | {
        n for e in search.memo.values() for n in e.spec.effects}
    assert key(other_process(Spec())) in {*search.budget.unasked, *search.memo}


def test_a_look_that_was_taken_before_is_taken_anew_and_a_full_fit_is_not() -> None:
    loop = recorded(slow(0.97, samples=SHORT))
    base, full = entry(loop), entry(loop, STOP)
    look = entry(loop, LAG, parent=base)
    look.scored, look.look = replace(look.scored, full=False), Packed(look.spec, LAG)
    search = spent(base, full, look, only=frozenset({STOP, LAG, STEP.partition("@")[0]}))
    search.expand(base)
    assert LAG in unasked(search) and STOP not in unasked(search)


def test_friction_that_changes_along_the_record_is_asked_last_of_the_effects_on_the_valve() -> None:
    """A stem that was too slow was not looked at: two such looks had spent the budget."""
    base = entry(recorded(slow(0.97, samples=SHORT)))
    search = spent(base)
    search.expand(base)
    left = [name.rpartition(": ")[2] for name in search.budget.unasked]
    before, after = ((left.index(name) for name in names) for names in (
        (STOP, "slew-limit", "valve-characteristic"), ("stiction-change", "stiction-drift")))
    assert max(before) < min(after)


def test_a_leaking_integrator_is_asked_while_nothing_shows_that_it_is_worse() -> None:
    tank = Spec(process=INTEGRATOR)
    base = entry(recorded(slow(0.97, samples=SHORT), tank), spec=tank)
    search = spent(base)
    search.expand(base)
    leaking = leaking_process(tank)
    assert leaking is not None and key(leaking) in {*search.budget.unasked, *search.memo}


def test_an_integrator_is_fitted_beside_the_best_node_and_beside_the_freest_base() -> None:
    """The base lags by a third of a period, and the best node by many periods."""
    loop = recorded(slow(0.97, samples=SHORT) + 6.0 * (np.arange(SHORT) >= 160))
    base = entry(loop)
    best = entry(loop, STEP, values={f"{STEP}:time_s": 160.0, "time_constant_s": 200.0}, parent=base)
    assert best.scored.done.gain_over(base.scored.done) > 0.0 and best.scored.acts_as_integrator(POLICY)
    search = spent(base, best, only=frozenset())
    search.expand(base)
    assert key(other_process(best.spec)) in search.memo and key(other_process(base.spec)) not in search.memo


def test_valves_that_rest_are_sought_beside_a_base() -> None:
    base = entry(recorded(slow(0.97, samples=SHORT)))
    search = search_among(base, only=frozenset({REST}))
    search.expand(base)
    assert search.valves[kind_of(Spec(effects=(REST,)))]


def test_a_late_answer_is_expanded_until_as_much_as_the_budget_went_to_such() -> None:
    loop = recorded(slow(0.97, samples=SHORT) + 6.0 * (np.arange(SHORT) >= 160))
    base, at = entry(loop, asked=True), {f"{STEP}:time_s": 160.0}
    for apart, expanded in ((1, False), (0, True)):
        best = entry(loop, STEP, values=at, parent=base)
        search = spent(base, best, only=frozenset({STOP}), policy=replace(POLICY, budget=1))
        search.budget.apart, search.rested = apart, {key(base.spec), key(best.spec)}
        # (one that its children made much better is to be asked once more, which differs from processor to processor)
        assert search.run() is best and (len(search.memo) > 2) is expanded


def test_changes_of_structure_that_do_not_help_alone_are_asked_by_a_search_for_all_effects_only() -> None:
    loop = recorded(slow(0.9, samples=SHORT) + np.sign(np.sin(np.arange(SHORT) / 10.0)))
    base = entry(loop, asked=True)
    lag = entry(loop, LAG, parent=base, failed="gain")
    assert not base.scored.white
    for only in (None, frozenset({STOP})):
        search = spent(base, lag, only=only)
        search.rested = {key(base.spec)}
        assert search.run() is base
        assert (LAG in unasked(search)) is (only is None)


@pytest.mark.parametrize(("rests", "asked"), [(False, REST), (True, "slip-overshoot")])
def test_an_answer_far_from_the_noise_is_asked_for_the_other_kind_of_valve(rests: bool, asked: str) -> None:
    loop = recorded(slow(0.97, samples=SHORT))
    answer = entry(loop, *((REST,) if rests else ()), asked=True)
    search = search_among(answer, only=frozenset({REST, "slip-overshoot"}))
    search.may_place = False
    search.run()
    assert rests or search.valves[kind_of(Spec(effects=(REST,)))]
    assert asked in {name for e in search.memo.values() for name in e.spec.effects}


def test_innovations_that_are_not_white_are_explained_at_the_irreducible_noise_of_a_moving_command() -> None:
    square = 0.02 * WHITE[:SHORT] + 0.5 * np.sign(np.sin(np.arange(SHORT) / 10.0))
    for spec, explained in ((Spec(), False), (Spec(between="corner", substeps=8), True)):
        node = entry(recorded(square, spec), spec=spec)
        search = search_among(node)
        assert not node.scored.white and not search.is_explained(node)
        search.floor = lambda done, at=node.scored.rmse: at
        assert search.is_explained(node) is explained


@pytest.mark.parametrize("stage", [VALVES, SPEEDS])
def test_a_valve_that_rests_at_some_speeds_only_is_sought_apart(stage: str) -> None:
    fit = point_in_search_form(scored(recorded(WHITE[:SHORT])), Spec())
    ground = Ground(fit, fit.values[None, :5], 0, POLICY)
    found = perform_task(ground, Task(Spec(effects=(REST,)), REST, stage)).valves
    high = parse(REST)[0].parameters[0].high
    assert found and any(valve[f"{REST}:restick_speed"] >= high for valve in found) is (stage == VALVES)


def test_a_course_of_the_command_is_looked_at_from_the_point_of_its_parent() -> None:
    moving = Spec(between="corner", substeps=8)
    loop = recorded(WHITE[:SHORT], moving)
    fit = point_in_search_form(scored(loop), Spec())
    answer = perform_task(Ground(fit, fit.values[None, :5], 0, POLICY), Task(moving))
    assert not answer.failed and answer.score_again(fit).rmse < 1.5 * 0.2


@pytest.mark.parametrize("lost", [True, False])
def test_a_larger_model_that_explains_less_than_the_one_it_holds_is_fitted_once_more(lost: bool) -> None:
    """A further lag whose valve was lost: an inverse response was named in its place."""
    lags, true = Spec(effects=(LAG,)), {f"{LAG}:second_time_constant_s": 4.0}
    loop = recorded(WHITE, lags, true)
    parent = Entry(Spec(), scored(loop))
    wrong = {"S": 4.5, "J": 1.0, f"{LAG}:second_time_constant_s": 15.0}
    child = Entry(lags, scored(loop, lags, wrong if lost else true), key(Spec()), ADD, LAG)
    search = search_among(parent, child, only=frozenset({LAG}))
    assert (child.scored.done.gain_over(parent.scored.done) < -POLICY.margin) == lost
    _, tasks = search._open_node(parent, "expanding")
    assert not any(t.added for t in tasks)
    search._finish_children(parent)
    found = search.memo[key(lags)].scored
    assert found.done.gain_over(parent.scored.done) > POLICY.margin
    assert found.done.evaluated.values["S"] == pytest.approx(true_values()["S"], rel=0.01)
    assert (found is child.scored) is not lost


def test_a_child_is_fitted_once_more_from_the_values_that_its_parent_has_by_now(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Another child had mended the parent's valve, and a step of eight times the noise was not found beside it."""
    lags, true = Spec(effects=(LAG,)), {f"{LAG}:second_time_constant_s": 4.0}
    loop = recorded(WHITE, lags, true)
    parent = Entry(Spec(), scored(loop, Spec(), {"S": 4.5}))
    wrong = {"S": 4.5, "J": 1.0, f"{LAG}:second_time_constant_s": 15.0}
    search = search_among(parent, Entry(lags, scored(loop, lags, wrong), key(Spec()), ADD, LAG), only=frozenset({LAG}))
    grounds = []
    monkeypatch.setattr(Search, "_fit_whole", lambda _, ground, entry, task: grounds.append(ground))
    parent.scored = scored(loop)
    assert search.memo[key(lags)].scored.done.gain_over(parent.scored.done) < -POLICY.margin
    search._finish_children(parent)
    assert [g.fit.values[0] for g in grounds] == [pytest.approx(true_values()["S"])]


@pytest.mark.parametrize("verdict", ["stiction", "undecided"])
def test_a_likelier_fit_of_the_same_model_is_taken_where_the_valve_sticks(verdict: str) -> None:
    loop = quick()
    study = known(loop, options=PLAIN)
    last = study.steps[-1]
    off = replace(last, model={**last.model, "values": {**last.model["values"], "S": 1.05 * last.model["values"]["S"]}})
    estimate = study.estimate
    assert estimate is not None
    worse = replace(study, steps=(*study.steps[:-1], off), verdict=replace(study.verdict, stiction=verdict),
                    estimate=replace(estimate, S=1.05 * estimate.S))
    with asked_only():
        found = diagnose(loop, worse, apply=True)
    taken = estimate.S * (1.0 if verdict == "stiction" else 1.05)
    assert found.estimate is not None and pytest.approx(taken, rel=0.005) == found.estimate.S
    assert found.steps[-1].effects == study.steps[-1].effects


def test_only_paths_of_children_are_handed_back() -> None:
    loop = recorded(WHITE)
    parent, child = scored(loop, values={"S": 4.6, "J": 1.2}), scored(loop, Spec(effects=(LAG,)))
    fit = point_in_search_form(parent, Spec())
    found = from_children(Ground(fit, pool_of(fit, 0), 0, POLICY), Spec(), parent, [child])
    assert found.done.gain_over(parent.done) > 0.0 and found.done.model.spec.paths is None


def test_a_fast_walk_is_named_behind_an_integrator_and_a_gap_of_pv_counts_for_nothing() -> None:
    tank = Spec(process=INTEGRATOR, increments=True, taps=SOFT)
    walk = np.cumsum(WHITE)
    assert noise_name(scored(recorded(walk, tank), tank), POLICY) == WALKING
    assert noise_name(scored(recorded(slow(0.9), tank), tank), POLICY) == ""
    gaps = slow(0.6)
    gaps[200:700] = np.nan
    assert noise_name(scored(recorded(gaps)), POLICY) == COLOURED


@pytest.mark.parametrize(("seed", "size"), [(0, 0.01), (0, 0.03), (1, 0.01), (1, 0.03), (2, 0.01), (2, 0.03)])
def test_a_walk_is_named_where_the_noise_of_its_own_leaves_white_innovations(seed: int, size: float) -> None:
    """The node's autoregression leaves none: it was fitted beside a gain that white noise gives."""
    rng = np.random.default_rng(seed)
    found = scored(recorded(np.cumsum(size * rng.standard_normal(1200)) + 0.08 * rng.standard_normal(1200)))
    best = min(found.at_output.values(), key=lambda f: f.bic).noise
    assert best.walks and not found.white and found.is_white_under(best)
    assert noise_name(found, POLICY) == WALKING


@pytest.mark.parametrize(("seed", "size"), [(4, 0.1), (5, 0.1), (7, 0.06)])
def test_a_fast_walk_behind_an_integrator_is_judged_by_its_own_innovations(seed: int, size: float) -> None:
    rng, tank = np.random.default_rng(seed), Spec(process=INTEGRATOR)
    found = scored(recorded(np.cumsum(size * rng.standard_normal(SAMPLES)) + 0.06 * rng.standard_normal(SAMPLES), tank),
                   tank)
    assert not found.white and noise_name(found, POLICY) == WALKING and noise_name(found, POLICY, slow=True) == ""


def cycling(**values: float) -> Entry:
    """The base of a steady cycle at its true values, a few changed, with the residual force that suits them."""
    loop = cycle(rests=False)
    model = bind_model(loop, Spec(), s_max=9.0, period_s=40.0)
    true = {"S": 4.4, "J": 2.3, "time_constant_s": 9.0, "dead_time_s": 4.0, **values}
    starts = [model.vector({**true, "initial_residual_force": force}) for force in np.linspace(-0.98, 0.98, 99)]
    best = min(starts, key=lambda start: model.evaluate(start).rmse)
    return Entry(Spec(), Scored(complete_quickly(model, best), True))


@pytest.mark.parametrize("better", [True, False])
@pytest.mark.parametrize(("lag_s", "most"), [(9.0, 10.0), (9.5, 1000.0)])
def test_a_base_takes_the_values_that_its_own_slips_give(lag_s: float, most: float, better: bool) -> None:
    """From 9.5 s its slips change once, and so does S, from 4.32 to 4.41: it is fitted anew from the new ones."""
    base = cycling(time_constant_s=lag_s)
    loop, before, memo = base.scored.done.model.loop, base.scored.done, {key(Spec()): base}
    add_same_slips(memo, base, loop, frozenset({REST}), 0, POLICY, better=better)
    assert POLICY.better_fit < base.scored.done.gain_over(before) < most
    assert base.scored.done.evaluated.values["S"] == pytest.approx(4.4, rel=0.005) and base.scored.held is not None


def test_noise_is_that_of_a_load_or_a_walk_where_it_gains_by_that() -> None:
    def completed(errors: FloatArray) -> Refit:
        done = scored(recorded(errors)).done
        return complete_with_noise(done.model, done.values, np.random.default_rng(0), POLICY)

    load = completed(of_load(0.9))
    assert load.noise_numbers == 2 and not load.increments
    assert not completed(slow(0.99)).increments and completed(np.cumsum(WHITE)).increments


def test_a_search_knows_the_irreducible_noise_of_its_record() -> None:
    loop = recorded(WHITE)
    model = model_on(loop, Spec())
    step = replace(good().study.steps[0], model=model.describe(model.vector(true_values())))
    on = resume_search(loop, replace(good().study, steps=(step,)), seed=0)
    floor = on.search.floor(on.here.scored.done)
    assert floor is not None and 0.15 < floor < 0.21


@pytest.mark.parametrize(("name", "walks"), [("random-walk-disturbance", True), ("coloured-noise", False)])
def test_noise_that_is_added_by_hand_is_of_the_kind_that_was_asked_for(name: str, walks: bool) -> None:
    """The record has white noise, so that the search itself names neither."""
    loop = quick()
    step = add(loop, known(loop, options=PLAIN), name).steps[-1]
    assert step.added == name and step.model["increments"] is walks


@pytest.mark.parametrize(("root", "asked"), [(0.6, False), (0.9, True)])
def test_what_is_asked_last_is_asked_beside_noise_whose_free_run_is_twice_its_innovations(root: float,
                                                                                         asked: bool) -> None:
    base = entry(recorded(slow(root)), asked=True)
    assert base.scored.noise_alone and (base.scored.rmse > 2 * base.scored.done.innovation_sd) is asked
    search = spent(base, more=1.0, policy=replace(POLICY, budget=1))
    search.rested = {key(base.spec)}
    search.run()
    assert (key(Spec(effects=("positioner",))) in {*search.memo, *search.budget.unasked}) is asked


def test_beside_another_process_other_changes_of_structure_are_asked_and_no_further_effect() -> None:
    tank, moving = Spec(process=INTEGRATOR), Spec(process=INTEGRATOR, between="corner", substeps=8)
    base = entry(recorded(slow(0.97, samples=SHORT), tank), spec=tank)
    search = spent(base, only=frozenset({REST, STOP}))
    search.commands = (Spec(), Spec(between="corner", substeps=8))
    search.ask_for(base, (REST,), changes=True)
    assert {key(moving), key(with_effect(tank, REST))} <= {*search.budget.unasked, *search.memo}
    assert STOP not in unasked(search)


def ground_of(loop: Loop, policy: Policy) -> Ground:
    """The base of a record at its true values, as the parent of tasks."""
    fit = point_in_search_form(scored(loop), Spec())
    return Ground(fit, fit.values[None, :5], 0, policy)


def test_valves_are_sought_on_the_beginning_of_a_long_record_and_on_all_of_a_short_one() -> None:
    loop, task = recorded(WHITE[:2 * SHORT]), Task(Spec(effects=(REST,)), REST, VALVES)
    part, whole = (perform_task(ground_of(loop, replace(POLICY, periods=1, valve_samples=count, unit=1)), task).spent
                   for count in (SHORT // 2, 2 * SHORT))
    assert part < whole


def test_a_look_at_a_long_record_is_polished_on_all_of_it() -> None:
    """The errors of the second half are three times those of the first one, which looks search on."""
    errors = WHITE[:2 * SHORT] * np.where(np.arange(2 * SHORT) < SHORT, 1.0, 3.0)
    ground = ground_of(recorded(errors), replace(POLICY, fit_samples=SHORT))
    task = Task(Spec(effects=(LAG,)), LAG)
    look = perform_task(ground, task)
    polished = perform_task(ground, replace(task, stage=CLOSER, look=look))
    for answer in (look, polished):
        assert answer.rmse == pytest.approx(answer.score_again(ground.fit).rmse, rel=1e-6) and answer.rmse > 0.35


def test_the_slips_of_a_base_are_tried_before_it_is_expanded() -> None:
    base = cycling(time_constant_s=9.5)
    base.asked = True
    search = spent(base, only=frozenset({REST}))
    search.rested, before = {key(base.spec)}, base.scored.done
    search.run()
    assert base.scored.done.gain_over(before) > POLICY.better_fit


def test_a_step_of_a_study_is_kept_as_it_is() -> None:
    loop = quick(effects=((STOP, {"lower": 0.0, "upper": 52.0}),))
    study, mark = known(loop, options=PLAIN), Finding("mark", "info", "this step is the study's own")
    marked = replace(study, steps=(replace(study.steps[0], findings=(mark,)),))
    with asked_only(STOP):
        steps = diagnose(loop, marked, apply=True).steps
    assert [step.added for step in steps] == [None, STOP] and mark in steps[0].findings


def test_a_lag_that_gains_nothing_is_looked_at_and_not_fitted_in_full() -> None:
    base = entry(recorded(WHITE[:SHORT]))
    search = search_among(base, only=frozenset({LAG, STOP}))
    search.ask_for(base, (STOP, LAG))
    full = {name: e.scored.full for name, e in search.memo.items() if e is not base and e.scored is not None}
    assert full[key(Spec(effects=(LAG,)))] is False


@pytest.mark.parametrize("most", [1, 2, 3])
def test_as_many_looks_are_fitted_in_full_as_the_policy_says(most: int) -> None:
    """A small step that none of them halves the error of: the best looks are near one another."""
    base = entry(recorded(WHITE[:SHORT] + 0.4 * (np.arange(SHORT) >= 160)))
    ways = [f"{name}@{place}" for name in ("step-disturbance", "ramp-disturbance") for place in ("output", "load")]
    search = search_among(base, policy=replace(POLICY, finalists=most))
    search.ask_for(base, ways)
    assert sum(search.memo[key(Spec(effects=(name,)))].scored.full for name in ways) == most


@pytest.mark.parametrize(("growth", "rests"), [(1e-4, True), (-1e-4, False)])
def test_friction_that_hardly_grows_gives_way_to_a_valve_that_rests_by_itself(growth: float, rests: bool) -> None:
    """Kinetic friction that grows, however slowly, brings a sliding stem to rest. Where it falls the stem slides on."""
    drift, at_once = "stiction-drift", {f"{REST}:restick_speed": 1e3}
    loop = recorded(WHITE, Spec(effects=(REST,)) if rests else Spec(), at_once if rests else None)
    base = entry(loop)
    drifting = entry(loop, drift, values={f"{drift}:stickband_growth": growth}, parent=base)
    memo, lone = ({key(e.spec): e for e in known} for known in ((base, drifting), (drifting,)))
    add_rest_instead(memo, drifting, loop, None, 0, POLICY)
    assert (key(Spec(effects=(REST,))) in memo) is rests
    if rests:
        rest = memo[key(Spec(effects=(REST,)))]
        assert rest.scored.done.gain_over(drifting.scored.done) > 0.0 and (rest.op, rest.what) == (ADD, REST)
        for known in (memo, lone):
            before = dict(known)
            add_rest_instead(known, drifting, loop, None, 0, POLICY)
            assert known == before


@pytest.mark.parametrize(("share", "placed"), [(0.97, True), (0.9, False)])
def test_a_look_far_behind_by_its_law_is_not_worth_a_path(share: float, placed: bool) -> None:
    """PV would place the slips of both, but those of the far one would leave it 260 BIC behind all the same."""
    model = model_on(recorded(2.0 * WHITE), Spec())
    fit = as_it_stands(model, model.vector(true_values()))
    look = model.vector({**true_values(), "S": share * true_values()["S"]})
    assert complete_as_is(model, look).model.spec.paths is not None
    assert (complete_look(model, look, fit, POLICY).model.spec.paths is not None) is placed
