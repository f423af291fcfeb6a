"""Edges of the rules of the search: what lies just before a limit and just beyond it, and answers in words.

Each test fails on a fault that `benchmarks/mutants.py` drew and that no other test found: docs/mutants.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from real_nodes import SAMPLES, Values, recorded, scored, search_among, true_values
from scipy.signal import lfilter
from study_factory import good

from stictionid.effects import parse
from stictionid.errors import UsageError
from stictionid.model.spec import INTEGRATOR, SOFT, Spec
from stictionid.record.loop import Loop
from stictionid.record.tree import Gate
from stictionid.selection.crew import Crew
from stictionid.selection.decide import (
    Decision,
    as_equivalent,
    candidates,
    decide_answer,
    equivalents,
    prune_effects,
    simplify_effects,
)
from stictionid.selection.doubts import deciding_measurement, offer_rest, specs_with_same_slips
from stictionid.selection.entry import ADD, ROOT, SWAP, Entry, Memo, nodes_to_ask, remember
from stictionid.selection.ladder import order_ladder
from stictionid.selection.looks import VALVES, Ground, Packed, Task, keep_followed_tags, pool_of
from stictionid.selection.node import key, kind_of, other_process, with_effect
from stictionid.selection.policy import Policy
from stictionid.selection.score import point_in_search_form
from stictionid.system import evaluations
from stictionid.typing import FloatArray

POLICY = Policy()
STOP, STEP, LAG, REST, RINGS = ("travel-limit", "step-disturbance@output", "extra-lag", "re-sticking",
                                "underdamped-process")
SHORT = 300
WHITE = 0.2 * np.random.default_rng(4).standard_normal(SAMPLES)


def slow(root: float, size: float = 1.0, samples: int = SAMPLES) -> FloatArray:
    """Errors (n,) with a root, of so many times the innovations of 0.2."""
    return np.asarray(lfilter([1.0], [1.0, -root], size * WHITE[:samples]))


def entry(loop: Loop, *names: str, values: Values | None = None, parent: Entry | None = None, failed: str = "",
          asked: bool = False, spec: Spec | None = None) -> Entry:
    """A node at the true values, a few changed; `failed` is a gate that it does not pass."""
    spec = spec or Spec(effects=names)
    gates = (Gate(failed, False, "no"),) if failed else ()
    return Entry(spec, scored(loop, spec, values), None if parent is None else key(parent.spec),
                 ROOT if parent is None else ADD if names else SWAP, names[-1] if names else spec.process, gates=gates,
                 asked=asked)


def heard(ground: Ground, task: Task) -> Packed:
    """An answer that says how many listeners hear the counts in its process."""
    return Packed(task.spec, failed=str(len(evaluations.listeners)))


def test_only_the_first_process_tells_its_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluations, "listeners", [lambda: None])
    fit = point_in_search_form(scored(recorded(WHITE[:SHORT])), Spec())
    ground = Ground(fit, fit.values[None, :5], 0, POLICY)
    for jobs, count in ((1, "1"), (2, "0")):
        with Crew(ground, jobs) as crew:
            assert [a.failed for a in crew.map([Task(Spec())], heard)] == [count]


@pytest.mark.parametrize("name", ["budget", "beam", "depth", "finalists", "periods", "valve_samples", "fit_samples",
                                  "unit"])
def test_a_count_of_a_policy_is_one_at_least(name: str) -> None:
    assert getattr(Policy(**{name: 1}), name) == 1
    with pytest.raises(UsageError, match=f"{name} 0 is below 1"):
        Policy(**{name: 0})


def test_an_equivalent_says_what_tells_it_from_the_answer() -> None:
    loop = recorded(WHITE)
    stop, step, rest, bare = (entry(loop, *names) for names in ((STOP,), (STEP,), (REST,), ()))
    assert as_equivalent(step, 3, stop).what_would_tell == deciding_measurement(STEP, (STOP,)) != ""
    assert as_equivalent(bare, 3, stop).what_would_tell == "the measured valve position"
    assert "a setpoint move of" in as_equivalent(rest, 3, bare).what_would_tell


def test_a_valve_that_rests_is_offered_with_the_numbers_of_the_valve_that_it_stands_for() -> None:
    done = scored(recorded(WHITE[:SHORT]), Spec(effects=("asymmetric-stiction",))).done
    valves: dict[str, tuple[dict[str, float], ...]] = {}
    offer_rest(valves, done, "asymmetric-stiction", Spec())
    (offered,) = valves[kind_of(Spec(effects=(REST,)))]
    true = true_values()
    assert (offered["S"], offered["J"]) == (true["S"], true["J"])
    assert offered[f"{REST}:restick_speed"] == parse(REST)[0].parameters[0].high


@pytest.mark.parametrize(("names", "white", "asked"), [
    ((), True, [(), (REST,)]), ((), False, [(), (REST,), (LAG,), (LAG, REST)]),
    ((REST,), False, [(REST,), (), (LAG, REST)]), ((STOP,), False, [])])
def test_the_other_kind_of_valve_is_tried_at_the_same_slips(names: tuple[str, ...], white: bool,
                                                            asked: list[tuple[str, ...]]) -> None:
    """A further lag is tried beside innovations that are not white, and beside no valve that only lost its rest."""
    loop = recorded(WHITE if white else 0.1 * WHITE + 0.5 * np.sign(np.sin(np.arange(SAMPLES) / 10.0)))
    known = entry(loop, *names)
    assert white or not known.scored.white
    assert [set(s.effects) for s in specs_with_same_slips(known, loop, None)] == [set(each) for each in asked]


def test_the_same_fit_beside_another_parent_leaves_a_node_its_edge() -> None:
    spec = Spec(effects=(STOP,))
    fit = scored(recorded(slow(0.9)), spec)
    known = Entry(spec, fit, key(Spec()), ADD, STOP, gates=(Gate("gain", False, "no"),))
    memo = Memo(POLICY, entries=[known])
    remember(memo, entry(recorded(slow(0.99)), LAG), Task(spec, STOP), Packed(spec, STOP, full=True), fit)
    assert memo[key(spec)] is known


def test_of_two_looks_at_a_node_that_are_alike_the_first_stays() -> None:
    spec = Spec(effects=(STOP,))
    look = scored(recorded(slow(0.9)), spec, full=False)
    memo = Memo(POLICY, entries=[Entry(spec, look, key(Spec()), ADD, STOP, look=Packed(spec, STOP))])
    known, other = memo[key(spec)], entry(recorded(slow(0.99)), LAG)
    remember(memo, other, Task(spec, STOP), Packed(spec, STOP), look)
    assert memo[key(spec)] is known
    remember(memo, other, Task(spec, STOP), Packed(spec, STOP),
             scored(recorded(slow(0.9, 0.5)), spec, full=False))
    assert memo[key(spec)].parent == key(other.spec)


def test_of_the_bases_only_the_best_and_those_of_a_better_free_run_are_asked() -> None:
    """A lag whose free run is that of its parent is no new base; a node that leaves noise is asked alone."""
    loop = recorded(slow(0.97) + 2.0 * (np.arange(SAMPLES) >= 640))
    base = entry(loop, asked=True)
    lag = entry(loop, LAG, parent=base)
    far = entry(loop, STEP, values={f"{STEP}:time_s": 640.0}, parent=base)
    assert far.scored.done.gain_over(base.scored.done) > POLICY.margin
    memo = Memo(POLICY, entries=(base, lag, far))
    assert nodes_to_ask(memo, only_some=False) == [far]
    quiet = recorded(WHITE)
    memo = Memo(POLICY, entries=(entry(quiet), entry(quiet, LAG), entry(quiet, STOP)))
    assert len(nodes_to_ask(memo, only_some=False)) == 1


def test_the_ladder_of_a_walking_process_is_fitted_to_levels_and_its_rungs_need_not_be_known() -> None:
    walking = Spec(effects=(STOP,), increments=True, taps=SOFT)
    winner = entry(recorded(np.cumsum(WHITE[:SHORT]), Spec(effects=(STOP,))), spec=walking)
    assert winner.scored.done.increments
    order, rungs = order_ladder(search_among(winner), winner)
    assert order == (STOP,) and [spec.increments for spec, _ in rungs] == [False, False]
    # An integrator whose free run is at the noise is fitted to levels in its last rung.
    tank = Spec(process=INTEGRATOR)
    quiet = entry(recorded(WHITE[:SHORT], tank), spec=tank)
    assert not quiet.scored.done.increments and quiet.scored.free_run_at_noise
    _, rungs = order_ladder(search_among(quiet), quiet)
    assert [spec.increments for spec, _ in rungs] == [False]


def test_few_of_many_tags_are_looked_at_those_that_pv_follows() -> None:
    rng = np.random.default_rng(8)
    feed = np.cumsum(rng.standard_normal(SAMPLES)) / 10.0
    tags = {"feed": feed, **{f"tag{i}": np.cumsum(rng.standard_normal(SAMPLES)) for i in range(6)}}
    loop = replace(recorded(WHITE + 0.9 * feed), extras=tags)
    fit = point_in_search_form(scored(loop), Spec())
    ground = Ground(fit, fit.values[None, :5], 0, replace(POLICY, finalists=1))
    names = [f"measured-disturbance:{tag}" for tag in reversed(tags)]
    tasks = [Task(Spec(effects=(LAG,)), LAG), *(Task(Spec(effects=(n,)), n) for n in names)]
    kept = [t.added for t in keep_followed_tags(ground, tasks)]
    assert len(kept) == 3 and kept[0] == LAG and "measured-disturbance:feed" in kept


def test_valves_are_searched_for_once_where_a_rest_is_not_alone() -> None:
    for names in ((STOP,), (STOP, REST)):
        task = Task(Spec(effects=names), names[-1])
        assert [t.stage for t in task.for_valves(False)] == [VALVES]


def test_two_lags_stand_for_a_process_that_rings_where_they_explain_as_much() -> None:
    lags = {f"{LAG}:second_time_constant_s": 12.0}
    loop = recorded(WHITE[:SHORT], Spec(effects=(LAG,)), lags)
    base = entry(loop)
    lag = entry(loop, LAG, values=lags, parent=base)
    rings = entry(loop, RINGS, parent=base)
    rings.scored, rings.stands_in = lag.scored, True
    search = search_among(base, lag, rings, only=frozenset({LAG}))
    assert simplify_effects(search, rings, ()) is lag


@pytest.mark.parametrize(("seed", "stays"), [(7, False), (6, True)])
def test_a_sine_of_a_few_cycles_must_beat_a_narrow_band_unless_it_halves_the_free_run(seed: int, stays: bool) -> None:
    """Both sines gain more than 20 BIC over the base and less over a band, whose phase wanders."""
    sine, rng, root = "sinusoidal-disturbance", np.random.default_rng(seed), 0.998
    band = lfilter([0.02], [1.0, -2.0 * root * np.cos(2.0 * np.pi / 37.0), root**2], rng.standard_normal(4500))[-150:]
    loop = recorded(band + 0.6 * rng.standard_normal(band.size))
    base = entry(loop)
    best = min((entry(loop, sine, values={f"{sine}:period_s": period}, parent=base) for period in (35.0, 37.0, 39.0)),
               key=lambda e: e.scored.rmse)
    assert best.scored.done.gain_over(base.scored.done) > POLICY.margin
    assert (2 * best.scored.rmse < base.scored.rmse) is stays
    assert prune_effects(search_among(base, best), best) is (best if stays else base)


def test_a_rest_is_asked_beside_an_integrator_that_takes_the_place_of_a_lag() -> None:
    loop, spec = recorded(slow(0.97, samples=SHORT)), other_process(Spec())
    lagging = entry(loop, LAG, values={"time_constant_s": 200.0})
    integrator = entry(loop, spec=spec, parent=lagging)
    search = search_among(lagging, integrator, policy=replace(POLICY, structure_margin=1e6), only=frozenset({REST}))
    search.budget.spent = 3 * POLICY.budget
    found = decide_answer(search, lagging, (LAG,), spans=False)
    assert found.winner is integrator and key(with_effect(spec, REST)) in search.memo


def test_a_node_of_the_same_effects_explains_as_well_however_it_errs() -> None:
    """Only a node that lacks an effect may hide it in noise of long memory."""
    policy, moving = replace(POLICY, alike=1e5), Spec(between="corner", substeps=8)
    loop, other = recorded(slow(0.5)), recorded(slow(0.99, 1.5), moving)
    winner, same = entry(loop), Entry(moving, scored(other, moving), key(Spec()), SWAP, "corner command",
                                       stands_in=True)
    assert same.scored.rmse > 2 * winner.scored.rmse
    assert equivalents(search_among(winner, same, policy=policy), winner) == (same,)
    stop = entry(loop, STOP)
    assert same not in equivalents(search_among(stop, same, policy=policy), stop)


def test_the_tags_behind_a_named_one_are_told() -> None:
    rng = np.random.default_rng(8)
    feed = np.cumsum(rng.standard_normal(SHORT)) / 3.0
    loop = replace(recorded(WHITE[:SHORT] + feed), extras={"feed": feed, "air": feed + rng.standard_normal(SHORT)})
    base = entry(loop)
    named, behind = (entry(loop, f"measured-disturbance:{tag}", parent=base) for tag in ("feed", "air"))
    rows = candidates(search_among(base, named, behind), Decision(named, "", (), ""), named.spec.effects, good().study,
                      {})
    assert rows[0].accepted and "; behind it air (" in rows[0].statement


def test_a_node_with_effects_is_fitted_once_more_from_where_it_stands_unless_it_is_explained() -> None:
    loop, values = recorded(WHITE), {"time_constant_s": 21.0}
    base = entry(loop)
    off, right = entry(loop, LAG, values=values, parent=base), entry(loop, STOP, parent=base)
    search, before = search_among(base, off, right), right.scored
    was = off.scored
    search.settle_node(off)
    search.settle_node(right)
    assert off.settled and right.settled and right.scored is before
    assert off.scored.done.gain_over(was.done) > 20.0 and off.scored.full and off.scored.held is not None
    assert off.scored.done.evaluated.values["S"] == pytest.approx(3.6, rel=0.05)


@pytest.mark.parametrize(("root", "noise"), [(0.6, True), (0.97, False)])
def test_noise_of_short_memory_alone_is_noise(root: float, noise: bool) -> None:
    node = scored(recorded(slow(root)))
    assert not node.is_explained(POLICY) and node.only_noise(POLICY) is noise
    assert pool_of(point_in_search_form(node, Spec()), 0).shape[1] == 5
