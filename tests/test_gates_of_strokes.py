"""Gates on how much a few strokes, one slip, or an odd valve may explain; and looks that outlive the budget."""

from __future__ import annotations

from dataclasses import replace

import naive
import numpy as np
import pytest
from real_nodes import PERIOD_S, SAMPLES, gate, holding, model_on, recorded, scored, true_values

from stictionid.fit.cross_validation import Held
from stictionid.fit.noise.completion import RANDOM_WALK, complete_quickly, place_slips, stroke_score
from stictionid.fit.points.fitted import as_it_stands
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.record.loop import Loop
from stictionid.record.tree import Gate
from stictionid.selection.gates import (
    GATES,
    Compared,
    Edge,
    chance_limit,
    fall_of_held_out_error,
    judge_drop,
    judge_edge,
    least_cost,
)
from stictionid.selection.policy import Policy
from stictionid.selection.score import Scored
from stictionid.selection.search import Search

POLICY = Policy()
WHITE = np.random.default_rng(4).standard_normal(SAMPLES)
STOP, STEP, REST = "travel-limit", "step-disturbance@output", "re-sticking"
# Samples of three of 50 half cycles, and of all of them.
FEW, MANY = slice(0, 90), slice(0, None, 3)


def pair(where: slice, times: float = 2.0, process: str = FIRST_ORDER) -> tuple[Scored, Scored]:
    """Two nodes, the first with errors so many times as large at some samples; PV of both has a gap."""
    spec, errors = Spec(process=process), 0.2 * WHITE
    errors[500:530] = np.nan
    larger = errors.copy()
    larger[where] *= times
    return scored(recorded(larger, spec), spec), scored(recorded(errors, spec), spec)


@pytest.mark.parametrize("where", [slice(None), FEW, MANY])
def test_the_score_of_strokes_is_that_of_a_loop_over_half_cycles(where: slice) -> None:
    before, after = (node.done for node in pair(where))
    innovations = [np.where(done.good, done.innovation, np.nan) for done in (before, after)]
    said = naive.stroke_score(*innovations, int(PERIOD_S) // 2)
    assert stroke_score(before, after) == pytest.approx(said, rel=1e-9)


def test_a_gain_from_a_few_strokes_names_no_effect_on_the_valve() -> None:
    few, many = pair(FEW), pair(MANY)
    limit = chance_limit(POLICY)
    assert stroke_score(few[0].done, few[1].done) < limit < stroke_score(many[0].done, many[1].done)
    for name, rejected in ((STOP, True), ("stiction-drift", True), (REST, False), (STEP, False),
                           ("gain-drift", False)):
        edge = Edge(name, few[1], few[0], POLICY)
        assert bool(gate("strokes", edge)) is rejected, name
        assert not gate("strokes", Edge(name, many[1], many[0], POLICY)), name


def test_the_gate_of_the_free_run_says_both_errors_whether_it_passes_or_not() -> None:
    # No noise model whitens the corners of a square wave, and what is not white excuses no error.
    spec, square = Spec(), 0.02 * WHITE + 0.5 * np.sign(np.sin(np.arange(SAMPLES) / 10.0))
    small, large = scored(recorded(square, spec), spec), scored(recorded(2.0 * square, spec), spec)
    assert not small.white and not large.white
    for child, parent, passes in ((small, large, True), (large, small, False)):
        said = dict(GATES)["free-run"](Edge(STOP, child, parent, POLICY))
        assert isinstance(said, Compared) and (said.reason == "") is passes
        assert said.statistic == pytest.approx(child.rmse)
        assert said.threshold == pytest.approx(POLICY.free_run * parent.rmse)


@pytest.mark.parametrize(("upper", "failed"), [(57.0, ["strokes"]), (54.0, [])])
def test_a_stop_that_few_strokes_meet_is_not_named(upper: float, failed: list[str]) -> None:
    """The stop at 57 % cuts the peaks of the strokes that go furthest; it gains 60 BIC all the same."""
    with_stop, where = Spec(process=INTEGRATOR, effects=(STOP,)), {f"{STOP}:upper": upper}
    loop = recorded(0.2 * WHITE, with_stop, where)
    edge = Edge(STOP, scored(loop, with_stop, where), scored(loop, Spec(process=INTEGRATOR)), POLICY)
    assert edge.gain > POLICY.margin
    assert [g.name for g in judge_edge(edge) if not g.passed] == failed


@pytest.mark.parametrize(("process", "times", "rejected"), [
    (FIRST_ORDER, 6.0, False), (FIRST_ORDER, 2.0, True), (INTEGRATOR, 6.0, True)])
def test_a_few_strokes_that_lower_the_free_run_clearly_will_do_but_for_an_integrator(process: str, times: float,
                                                                                      rejected: bool) -> None:
    """An integrator adds up every slip, so that one put right lowers the free run clearly."""
    before, after = pair(FEW, times, process)
    assert (before.rmse > POLICY.nearly * after.rmse) is (times > 2.0)
    assert bool(gate("strokes", Edge(STOP, after, before, POLICY))) is rejected


def test_a_slip_jump_beyond_the_stickband_must_beat_a_valve_that_rests() -> None:
    usual, odd = {"J": 2.6}, {"J": 4.6}
    errors = 0.2 * WHITE
    sliding, resting = recorded(errors, Spec(), odd), recorded(errors, Spec(effects=(REST,)), usual)

    def judged_on(loop: Loop, jump: dict[str, float]) -> tuple[Gate, ...]:
        rests = scored(loop, Spec(effects=(REST,)), usual)
        return judge_drop(Edge(REST, scored(loop, Spec(), jump), rests, POLICY))

    nodes = [scored(resting, Spec(), jump) for jump in (usual, odd)]
    assert [least_cost(REST, s, POLICY) for s in nodes] == [POLICY.structure_margin, -POLICY.margin]
    assert least_cost(STOP, nodes[1], POLICY) == POLICY.margin
    assert judged_on(resting, usual) == () == judged_on(sliding, odd)
    assert [g.passed for g in judged_on(resting, odd)] == [False]


def test_a_look_is_kept_where_the_budget_ends_before_it_is_polished() -> None:
    """The look is the best one, so it is fitted in full although nothing is left to spend."""
    time_s = np.arange(600)
    loop = recorded(0.2 * WHITE[:time_s.size] + 3.0 * (time_s >= 320))
    search = Search(loop, replace(POLICY, budget=1), 0, 1, lambda words, share: None,
                    only=frozenset({"step-disturbance"}))
    root = search.root(as_it_stands(model_on(loop, Spec()), scored(loop).done.values))
    search.expand(root)
    assert search.budget.over and search.budget.unasked
    (found,) = (e for e in search.memo.values() if e is not root)
    assert found.scored.full and search.memo.passed(found)
    named = found.scored.done.model.named(found.scored.done.values)
    assert named[f"{found.what}:time_s"] == pytest.approx(320.0, abs=2)


def held(one_step: list[float], level: float) -> Held:
    rows = np.full(5, 100.0)
    return Held(np.square(one_step) * rows, rows, np.full(5, level**2) * rows, rows)


def held_edge(after: Held, before: Held) -> Edge:
    """An edge between nodes with these held-out errors."""
    parent, child = pair(slice(None), 9.0)
    return Edge("gain-nonlinearity", holding(child, after), holding(parent, before), POLICY)


def test_beside_a_random_walk_only_the_held_out_free_run_tells() -> None:
    """A walk follows any disturbance one step ahead, so that no block need be predicted better."""
    larger, smaller = pair(slice(None), 9.0)
    walking = complete_quickly(smaller.done.model, smaller.done.values, noise=RANDOM_WALK)
    before, worse = held([1.4, 1.3, 1.3, 1.3, 1.3], 5.0), [2.2, 1.3, 1.3, 1.3, 1.3]
    for done, level, believed in ((walking, 1.3, True), (walking, 3.0, False), (smaller.done, 1.3, False)):
        edge = Edge("gain-nonlinearity", holding(larger, held(worse, level)),
                    holding(replace(smaller, done=done), before), POLICY)
        assert (gate("held-out", edge) == "") is believed


def test_a_block_beyond_the_range_of_the_others_does_not_drown_them() -> None:
    """Both models extrapolate into the first block; its squared errors alone would make the child the worse one."""
    before, after = held([2.0, 1.0, 1.0, 1.0, 1.0], 5.0), held([2.3, 0.95, 0.95, 0.95, 0.95], 5.0)
    assert after.rmse_one_step > before.rmse_one_step
    assert gate("held-out", held_edge(after, before)) == ""
    assert fall_of_held_out_error(after, before) == pytest.approx(0.05)
    # Two blocks that fall by 40 % lower the error over all of them, and the middle one stays.
    few = held([2.0, 0.6, 0.6, 1.0, 1.0], 5.0)
    assert fall_of_held_out_error(few, before) == pytest.approx(1.0 - 0.6 ** 0.4)
    assert gate("held-out", held_edge(held([1.0, 0.996, 0.996, 1.0, 1.0], 5.0), before)) == ""
    assert gate("held-out", held_edge(held([2.0, 0.99, 0.997, 1.0, 1.0], 5.0), before)) != ""


def test_where_pv_moved_the_slips_of_the_parent_only_valves_by_law_are_compared() -> None:
    """Friction that drifts looks like one that scatters: PV moves most slips, and few strokes carry what is left."""
    drift = Spec(effects=("stiction-drift",))
    growth = {"stiction-drift:stickband_growth": 0.2, "stiction-drift:jump_growth": 0.05}
    loop = recorded(0.2 * WHITE, drift, growth)
    child, rests = scored(loop, drift, growth), Spec(effects=(REST,))
    start = model_on(loop, rests)
    near = start.vector({**true_values(), "S": 3.75, "J": 2.64, f"{REST}:restick_speed": 1e3})
    parent = Scored(place_slips(complete_quickly(start, near)), True)
    assert parent.by_pv and not child.by_pv
    assert child.rmse * POLICY.freer > parent.rmse and child.rmse_by_law * POLICY.freer < parent.rmse_by_law
    assert stroke_score(parent.done, child.done) < chance_limit(POLICY)
    assert not gate("strokes", Edge("stiction-drift", child, parent, POLICY))
    assert gate("strokes", Edge("stiction-drift", parent, parent, POLICY))
    # PV of a block held out placed slips in it, so that the parent predicts it better than anybody could.
    held, by_law = (fall_of_held_out_error(child.held, h) for h in (parent.held, parent.held_by_law))
    assert by_law > 0.1 > 5.0 * held
    assert gate("held-out", Edge("stiction-drift", child, parent, POLICY)) == ""
    assert child.held_by_law is child.held
