"""The order in which nodes are asked, what an answer may do without, and the scan of all valves beside an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loops_with_effects import small
from plants.beyond import drawn_beyond
from plants.score import loop_of
from real_nodes import SAMPLES, Values, model_on, recorded, scored, search_among, true_values
from scipy.signal import lfilter

from stictionid.effects import parse
from stictionid.fit.noise.completion import explains_slips, stroke_score
from stictionid.fit.points.fitted import as_it_stands
from stictionid.fit.points.moves import descend_model, with_start
from stictionid.fit.starts.beside_effect import guessed_valves
from stictionid.model.segments import bind_model
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, SOFT, Spec
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import swing_of, time_scale_s
from stictionid.record.tree import Gate
from stictionid.selection.decide import prune_effects
from stictionid.selection.entry import ADD, DROP, ROOT, SWAP, Entry, Memo, nodes_to_ask, rank_entries
from stictionid.selection.gates import GATES, chance_limit
from stictionid.selection.node import drop_from, key, leaking_process, node, other_process, what_of, with_effect
from stictionid.selection.policy import Policy
from stictionid.selection.refits import fit_without
from stictionid.selection.score import beyond_noise, complete_as_is

POLICY = Policy()
WHITE = np.random.default_rng(4).standard_normal(SAMPLES)
STOP, STEP, LAG, REST = "travel-limit", "step-disturbance@output", "extra-lag", "re-sticking"
INVERSE = "inverse-response"


def entry(loop: Loop, names: tuple[str, ...] = (), values: Values | None = None, *, parent: Entry | None = None,
          asked: bool = False, failed: str = "") -> Entry:
    """A node with some effects at the true values, a few changed; `failed` is a gate that it does not pass."""
    spec = Spec(effects=names)
    gates = (Gate(failed, False, "no"),) if failed else ()
    return Entry(spec, scored(loop, spec, values), None if parent is None else key(parent.spec),
                 ROOT if parent is None else ADD, names[-1] if names else "", gates=gates, asked=asked)


def memo_of(*entries: Entry) -> Memo:
    return Memo(POLICY, entries=entries)


def stepped(size: float, memory: float = 0.97) -> Loop:
    """A record with a step after 640 s and errors of a root `memory`."""
    return recorded(lfilter([1.0], [1.0, -memory], 0.2 * WHITE) + size * (np.arange(SAMPLES) >= 640))


def test_a_free_run_that_is_hardly_more_than_its_innovations_is_asked_before_another_base() -> None:
    """A stop a little off leaves 1.16 times its innovations; a step beside slow errors leaves four times them."""
    loop = recorded(0.2 * WHITE, Spec(effects=(STOP,)), {f"{STOP}:upper": 53.0})
    base, other = entry(loop, asked=True), entry(loop, (LAG,))
    best = entry(loop, (STOP,), {f"{STOP}:upper": 52.9}, parent=base)
    assert best.scored.leaves_little(POLICY) and not best.scored.only_noise(POLICY)
    assert nodes_to_ask(memo_of(base, other, best), only_some=False)[0] is best
    loop = stepped(2.0)
    base, other = entry(loop, asked=True), entry(loop, (LAG,))
    far = entry(loop, (STEP,), {f"{STEP}:time_s": 640.0}, parent=base)
    assert far.scored.done.gain_over(base.scored.done) > POLICY.margin
    assert nodes_to_ask(memo_of(base, other, far), only_some=False) == [other, far]


@pytest.mark.parametrize(("process", "like_noise"), [("first-order", True), ("integrator", False)])
def test_an_integrator_far_from_its_noise_is_no_noise_whatever_its_differences_say(process: str, like_noise: bool,
                                                                                   ) -> None:
    """A tank adds up the slips of a wrong valve: 20 times the noise were white in differences of y."""
    spec = Spec(process=process, increments=True, taps=SOFT)
    node = scored(recorded(np.cumsum(0.2 * WHITE), replace(spec, increments=False, taps=())), spec)
    assert node.white and node.like_noise(POLICY) is like_noise


@pytest.mark.parametrize(("times", "walks", "sharper"), [
    (2.5, False, False), (1.5, False, True), (2.5, True, True)])
def test_new_bases_come_by_free_run_and_those_about_as_good_by_score(times: float, walks: bool, sharper: bool) -> None:
    """Slow errors of half the innovations have the better score; their free run tells nothing where they walk."""
    slow = lfilter([1.0], [1.0, -0.99], 0.1 * WHITE)
    level = float(np.std(slow)) / times
    lag = Entry(Spec(effects=(LAG,)), scored(recorded(level * WHITE)))
    spec = Spec(increments=True, taps=SOFT) if walks else Spec()
    base = Entry(Spec(), scored(recorded(slow), spec))
    order = nodes_to_ask(memo_of(base, lag), only_some=False)
    assert order == ([base, lag] if sharper else [lag, base])


def test_nodes_that_the_budget_leaves_are_noted_but_not_the_answer() -> None:
    loop = stepped(2.0)
    base, other = entry(loop), entry(loop, (LAG,))
    search = search_among(base, other)
    search.budget.spent = 3 * POLICY.budget
    search.rested = {key(base.spec), key(other.spec)}
    assert {key(search.run().spec), *search.budget.unasked} == {key(base.spec), key(other.spec)}
    assert len(search.budget.unasked) == 1


def test_in_the_place_of_a_further_lag_only_effects_that_shape_the_process_are_asked() -> None:
    """The budget is spent, so that the questions are noted only."""
    loop = recorded(lfilter([1.0], [1.0, -0.97], 0.2 * WHITE[:300]))
    base = entry(loop, asked=True)
    lag = entry(loop, (LAG,), parent=base)
    search = search_among(base, lag)
    search.budget.spent = 3 * POLICY.budget
    search.expand(lag)
    asked = {name.partition(": ")[2] for name in search.budget.unasked}
    assert {INVERSE, f"{LAG} + {INVERSE}", f"{LAG} + {STOP}"} <= asked and STOP not in asked
    search = search_among(base, lag, only=frozenset({STOP, INVERSE}))
    search.budget.spent = 3 * POLICY.budget
    search.expand(lag)
    assert not {INVERSE, STOP} & {name.partition(": ")[2] for name in search.budget.unasked}


@pytest.mark.parametrize(("lagging", "commands"), [(True, ())])
def test_a_rest_is_asked_beside_another_process(lagging: bool, commands: tuple[Spec, ...]) -> None:
    """It is not asked beside a node that is no root.

    Where a root is expanded, or the command between samples is unknown, it is asked: benchmarks/long.
    """
    slow = lfilter([1.0], [1.0, -0.97], 0.2 * WHITE[:300])
    loop, policy = recorded(slow), replace(POLICY, within=1e4)
    base = entry(loop)
    there = entry(recorded(slow / 2), (LAG,), parent=base) if lagging else base
    rest = entry(loop, (*there.spec.effects, REST), parent=there, failed="gain")
    other = Entry(other_process(Spec()), scored(loop, other_process(Spec())), key(Spec()), SWAP, INTEGRATOR)
    search = search_among(base, *([there] if lagging else []), rest, other, policy=policy, only=frozenset({REST}))
    search.commands = commands
    search.expand(there)
    assert (key(with_effect(other.spec, REST)) in search.memo) is (not lagging or bool(commands))


def test_a_free_run_half_of_that_of_every_base_is_asked_before_another_base() -> None:
    """A measured disturbance that took the free run from 11 to 1.7 waited until the budget was spent on bases."""
    loop = stepped(6.0)
    base, other = entry(loop, asked=True), entry(loop, (LAG,))
    half = entry(loop, (STEP,), {f"{STEP}:time_s": 640.0}, parent=base)
    assert not half.scored.leaves_little(POLICY)
    assert nodes_to_ask(memo_of(base, other, half), only_some=False)[0] is half


def test_a_base_that_bends_the_free_run_is_asked_but_is_no_answer() -> None:
    loop = stepped(2.0)
    base = entry(loop, asked=True)
    bent = entry(loop, (REST,), {f"{REST}:restick_speed": 0.2}, parent=base, failed="free-run")
    disturbed = entry(loop, (STEP,), parent=base, failed="free-run")
    assert bent.tentative(memo_of(base, bent)) and not memo_of(base, bent).passed(bent)
    assert not disturbed.tentative(memo_of(base, disturbed))
    assert nodes_to_ask(memo_of(base, bent), only_some=False) == [bent]
    assert nodes_to_ask(memo_of(base, disturbed), only_some=False) == []


@pytest.mark.parametrize(("size", "failed", "asked"), [(6.0, "gain", True), (6.0, "held-out", False),
                                                       (0.5, "gain", False)])
def test_an_effect_that_halves_the_free_run_is_asked_though_it_gains_too_little(size: float, failed: str,
                                                                               asked: bool) -> None:
    """Slips at wrong times bend the gain: a tag that took the free run from 2.7 to 0.7 led to no second effect."""
    loop = stepped(size)
    base = entry(loop, asked=True)
    half = entry(loop, (STEP,), {f"{STEP}:time_s": 640.0}, parent=base, failed=failed)
    assert nodes_to_ask(memo_of(base, half), only_some=False) == [half] * asked
    search = search_among(base, half)
    assert search.least_in_free_run(base) is (half if size == 6.0 else None)


@pytest.mark.parametrize("known", [True, False])
def test_an_effect_that_another_process_does_not_need_is_pruned(known: bool) -> None:
    """An integrator with the stop alone explains as much as a first order with an inverse response beside it."""
    both, integrating = node(Spec(effects=(STOP, INVERSE))), Spec(process=INTEGRATOR, effects=(STOP,))
    where = {f"{STOP}:upper": 53.0, f"{INVERSE}:zero_s": 6.0, f"{INVERSE}:lag_s": 2.0}
    loop = recorded(0.2 * WHITE, both, where)
    root = entry(loop)
    alone = entry(loop, (STOP,), where, parent=root)
    best = entry(loop, both.effects, where, parent=alone)
    less = Entry(integrating, scored(recorded(0.2 * WHITE, integrating, where), integrating, where))
    search = search_among(root, alone, best, *([less] if known else []))
    assert prune_effects(search, best) is (less if known else best)


def test_a_node_found_better_where_an_effect_was_left_out_meets_its_gates_anew() -> None:
    """A rest along its path was 680 BIC likelier than by its law, and was refused by the gates of the worse fit."""
    both = node(Spec(effects=(STOP, INVERSE)))
    where = {f"{STOP}:upper": 53.0, f"{INVERSE}:zero_s": 6.0, f"{INVERSE}:lag_s": 2.0}
    loop = recorded(0.2 * WHITE, Spec(effects=(STOP,)), where)
    root = entry(loop)
    worse = entry(loop, (STOP,), {f"{STOP}:upper": 56.0}, parent=root, failed="gain")
    search = search_among(root, worse, entry(loop, both.effects, where, parent=root))
    assert not search.memo.passed(worse)
    assert search.drop_effect(search.memo[key(both)], INVERSE) is worse and search.memo.passed(worse)
    assert worse.scored.done.gain_over(root.scored.done) > POLICY.margin


def test_slips_count_beside_noise_of_long_memory_where_the_innovations_are_white() -> None:
    noise = recorded(lfilter([1.0], [1.0, -0.97], 0.2 * WHITE))
    beside, wrong = scored(noise).done, scored(noise, values={"S": 2.4}).done
    assert min(d.evaluated.rmse for d in (beside, wrong)) > 2.0 * beside.innovation_sd
    assert explains_slips(beside) and not explains_slips(wrong)


def test_gates_are_those_of_the_fits_that_a_search_has_now() -> None:
    """A lag that made up for a wrong valve of its parent passed, and stayed when the parent had the right valve."""
    loop = recorded(0.2 * WHITE)
    wrong, right = scored(loop, values={"S": 4.6}), scored(loop)
    base, lag = entry(loop, values={"S": 4.6}), entry(loop, (LAG,), {f"{LAG}:second_time_constant_s": 0.1})
    lag = replace(lag, parent=key(base.spec), op=ADD)
    memo = memo_of(base, lag)
    assert memo.passed(lag) and memo.gates(lag) is memo.gates(lag)
    base.scored = right
    assert not memo.passed(lag) and memo.last_passed(lag) is base
    base.scored = wrong
    assert memo.passed(lag) and memo.last_passed(lag) is lag
    # The decision may put a node in the place of one that passed; it meets no gate then.
    base.scored, lag.stands_in = right, True
    assert memo.passed(lag) and memo.gates(lag) == ()


def test_a_sliding_valve_without_its_rest_meets_the_gate_of_its_slip_jump() -> None:
    loop = recorded(0.2 * WHITE, Spec(effects=(REST,)))
    rests = entry(loop, (REST,))
    slides = replace(entry(loop, values={"J": 4.6}), parent=key(rests.spec), op=DROP, what=REST)
    memo = memo_of(rests, slides)
    assert [(g.name, g.passed) for g in memo.gates(slides)] == [("rest", False)] and not memo.passed(slides)
    slides.scored = scored(loop, values={"J": 2.6})
    assert memo.passed(slides)


def test_nodes_that_are_each_others_parents_are_judged() -> None:
    loop = stepped(2.0)
    root = entry(loop)
    one, other = entry(loop, (REST,), failed="free-run"), entry(loop, (LAG,), failed="free-run")
    one.op, one.parent, other.op, other.parent = ADD, key(other.spec), ADD, key(one.spec)
    memo = memo_of(root, one, other)
    assert [g.name for g in memo.gates(one)] == ["free-run"] == [g.name for g in memo.gates(other)]
    one.scored = scored(loop, one.spec, {"S": 3.5})
    assert [g.name for g in memo.gates(one)] == [name for name, _ in GATES] == [g.name for g in memo.gates(other)]
    assert not memo.passed(one) and memo.last_passed(one) in (one, other)


def test_the_scan_of_all_valves_finds_the_one_beside_a_drift_from_a_wrong_one() -> None:
    setting, loop = small("stiction-drift")
    name = "stiction-drift"
    model = bind_model(loop, Spec(effects=(name,)), s_max=2.0 * setting.S, period_s=60.0)
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
    assert beyond_noise(scored(recorded(0.2 * WHITE[:8])).done) == -np.inf
    assert np.isfinite(beyond_noise(scored(recorded(0.2 * WHITE[:400])).done))


@pytest.mark.parametrize("overshoot", [1.0, 1.5])
def test_slip_overshoot_ranks_behind_a_resting_valve_unless_the_strokes_tell_them_apart(overshoot: float) -> None:
    slips_on = {"slip-overshoot:overshoot": overshoot}
    loop = recorded(0.2 * WHITE, Spec(effects=("slip-overshoot",)), slips_on)
    base, rests, slips = entry(loop), entry(loop, (REST,)), entry(loop, ("slip-overshoot",), slips_on)
    rests, slips = (replace(e, parent=key(base.spec), op=ADD, gates=(Gate("gain", True, ""),)) for e in (rests, slips))
    told = overshoot > 1.0
    assert (stroke_score(rests.scored.done, slips.scored.done) > chance_limit(POLICY)) == told
    gain = slips.scored.done.gain_over(rests.scored.done)
    assert slips.debit(memo_of(base, rests, slips)) == (0.0 if told else POLICY.margin + max(gain, 0.0))
    ranked = [e for e in rank_entries(memo_of(base, rests, slips)) if e is not base]
    assert ranked == ([slips, rests] if told else [rests, slips])
    assert slips.debit(memo_of(base, slips)) == base.debit(memo_of(base, rests)) == 0.0
    refused = replace(rests, gates=(Gate("gain", False, "no"),), compared=())
    assert slips.debit(memo_of(base, refused, slips)) == 0.0


def test_a_child_near_the_noise_is_fitted_again_once() -> None:
    loop = recorded(0.2 * WHITE, Spec(effects=(STOP,)), {f"{STOP}:upper": 53.0})
    base = entry(loop)
    child = entry(loop, (STOP,), {f"{STOP}:upper": 52.9}, parent=base)
    parent, before = key(base.spec), base.scored
    assert child.is_near_noise(parent, before, POLICY)
    for other in (replace(child, settled=True), replace(child, parent="another"),
                  replace(child, scored=replace(child.scored, full=False))):
        assert not other.is_near_noise(parent, before, POLICY)
    assert not child.is_near_noise(parent, child.scored, POLICY)  # (it gains nothing)


def test_a_change_of_structure_is_called_by_what_changed() -> None:
    moving = Spec(between="corner", substeps=8)
    assert what_of(Spec(process=INTEGRATOR), Spec()) == INTEGRATOR
    assert what_of(moving, Spec()) == "corner command" and what_of(Spec(), moving) == "hold command"


def test_a_leaking_integrator_is_asked_as_a_process_of_two_lags() -> None:
    tank = Spec(process=INTEGRATOR, effects=(STOP,))
    leaking = leaking_process(tank)
    assert leaking is not None and leaking.process == FIRST_ORDER and {*leaking.effects} == {STOP, LAG}
    assert leaking_process(Spec()) is None and leaking_process(replace(tank, effects=(LAG,))) is None
    assert leaking_process(replace(tank, fixed={"S": 3.0})) is None


def test_a_fit_without_a_rest_that_never_rests_is_no_worse_than_the_same_valve() -> None:
    """In differences of y a slip in a wrong sample costs little: the fit moved there and the needless rest was named.
    """
    plant = drawn_beyond("travel-limit", 31005)
    loop, truth, process = loop_of(plant), plant.truth, plant.setting.process
    spec = node(Spec(process=INTEGRATOR, effects=(REST, STOP)))
    found = find_range(loop)
    model = bind_model(loop, spec, s_max=swing_of(loop, found), period_s=time_scale_s(loop, found))
    near = model.vector({"S": truth["S"], "J": truth["J"], "initial_residual_force": 0.0,
                         "time_constant_s": 0.3 * process.time_constant_s, "dead_time_s": process.dead_time_s + 0.5,
                         f"{REST}:restick_speed": 0.0, f"{STOP}:lower": truth["effects"][STOP]["lower"]})
    points = descend_model(model, with_start(model, model.cube(near[:, None]))).points
    fit = as_it_stands(model, model.values(points[:1])[:, 0])
    without = fit_without(fit, drop_from(spec, (REST,)), REST, np.random.default_rng(0), POLICY)
    assert without.gain_over(complete_as_is(model, fit.values)) > 0.0


def test_without_a_further_lag_the_longer_of_both_stays() -> None:
    """Two lags in series may be told in either order; without the long one the valve moved far off."""
    loop = recorded(0.02 * np.random.default_rng(0).standard_normal(SAMPLES))
    spec, lag = Spec(effects=(LAG,)), f"{LAG}:second_time_constant_s"
    model, true = model_on(loop, spec), true_values()
    fit = as_it_stands(model, model.vector({**true, lag: true["time_constant_s"], "time_constant_s": 0.05}))
    without = fit_without(fit, drop_from(spec, (LAG,)), LAG, np.random.default_rng(0), POLICY)
    assert without.evaluated.rmse == pytest.approx(0.02, rel=0.05)
    assert without.evaluated.values["time_constant_s"] == pytest.approx(true["time_constant_s"], rel=0.01)
