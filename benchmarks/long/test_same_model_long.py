"""One model for the same effects and the same base at length: twelve loops, by hand and by the search."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from test_same_model import a_loop, assert_same, by_hand, by_hand_as_searched, swung

from stictionid.model.closed_loop import Controller
from stictionid.selection.decide import best_without
from stictionid.selection.node import physical_effects
from stictionid.selection.run import resume_search
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify
from stictionid.verbs.remove import remove
from stictionid.verbs.support import support_of

LONGER = {"duration_s": 900.0, "setpoint_moves": ((0.0, 5.0), (450.0, -6.0))}
MOVING = {**LONGER, "controller": Controller(0.1, 5.0)}
Effects = tuple[tuple[str, dict[str, float]], ...]
LOOPS: tuple[tuple[Effects, Mapping[str, Any]], ...] = (
    ((("travel-limit", {"upper": 52.0}),), LONGER),
    ((("sinusoidal-disturbance", {"period_s": 61.0, "amplitude": 1.0}),), LONGER),
    ((("sinusoidal-disturbance", {"period_s": 47.0, "amplitude": 1.0}),), LONGER),
    ((("gain-drift", {"drift": -44.4}),), LONGER),
    ((("step-disturbance", {"time_s": 500.0, "size": 1.2}),), LONGER),
    ((("step-disturbance", {"time_s": 500.0, "size": 1.2}),), MOVING),
    ((("ramp-disturbance", {"start_s": 300.0, "rate": 0.01}),), LONGER),
    ((("asymmetric-stiction", {"jump_up": 1.5, "jump_down": 3.5}),), LONGER),
    ((("extra-lag", {"second_time_constant_s": 3.0}),), LONGER),
    ((("stiction-drift", {"stickband_growth": 0.8, "jump_growth": 0.133}),), {**LONGER, "duration_s": 1500.0}),
    ((("travel-limit", {"upper": 52.0}), ("sinusoidal-disturbance", {"period_s": 61.0, "amplitude": 1.0})), LONGER),
    ((("step-disturbance", {"time_s": 500.0, "size": 1.2}), ("gain-drift", {"drift": -44.4})), LONGER),
)


@pytest.mark.parametrize(("effects", "more"), LOOPS)
def test_effects_added_by_hand_in_either_order_end_as_the_search_does(effects: Effects,
                                                                      more: Mapping[str, Any]) -> None:
    loop = a_loop(*effects, **more)
    study = identify(loop)
    applied = diagnose(loop, study, apply=True)
    names = [step.added + (f"@{step.variant}" if step.variant else "") for step in applied.steps[1:] if step.added]
    assert {name for name, _ in effects} <= {name.partition("@")[0] for name in names}
    have = study.steps[-1].model["effects"]
    for order in (names, names[::-1]):
        by_hand = study
        for name in (n for n in order if n not in have):
            by_hand = add(loop, by_hand, name)
        assert_same(by_hand, applied)
    last = by_hand.steps[-1]
    without = remove(loop, by_hand, last.added or "")
    assert last.added not in without.steps[-1].effects
    assert_same(add(loop, without, order[-1]), applied)


def test_a_stop_added_before_or_after_another_effect_is_the_stop_of_the_search() -> None:
    loop = a_loop(("travel-limit", {"upper": 52.0}), duration_s=900.0, setpoint_moves=((0.0, 5.0), (450.0, -6.0)))
    study = identify(loop, options=Options(base_only=True))
    assert study.evaluations is not None and study.evaluations > 0
    applied = diagnose(loop, study, apply=True)
    assert applied.missing == ("travel-limit",)
    other = add(loop, study, "ramp-disturbance")
    late = add(loop, other, "travel-limit")
    assert [step.added for step in late.steps] == [None, "ramp-disturbance", "travel-limit"]
    assert_same(remove(loop, late, "ramp-disturbance"), applied)
    pruned = add(loop, other, "travel-limit", prune=True)
    assert_same(pruned, applied)
    assert [step.added for step in pruned.steps] == [None, "travel-limit"]


def test_a_sine_added_after_a_search_has_its_tree_and_ranking() -> None:
    loop, study, applied = swung(())
    ranked = diagnose(loop, study)
    assert ranked.missing == ("sinusoidal-disturbance",)
    added = add(loop, ranked, ranked.missing[0])
    assert_same(added, applied)
    # Tree, ranking and what is missing are those of the new model.
    named = [set(n.effects) for n in added.tree if n.status == "named"]
    assert {f"{added.steps[-1].added}@{added.steps[-1].variant}".rstrip("@")} in named
    row = next(c for c in added.candidates if c.effect == ranked.missing[0])
    support = next(f for f in added.steps[-1].findings if f.code == "supported")
    assert row.accepted and row.gain_beyond_noise == pytest.approx(support.evidence["gain_beyond_noise"])
    assert not added.missing and not added.missing_reason and len(added.candidates) >= len(ranked.candidates)


def test_a_sine_added_by_hand_is_the_sine_of_a_search_among_all_effects() -> None:
    by_hand_as_searched(())


def test_an_effect_with_which_the_error_grows_is_never_supported() -> None:
    loop, after = swung(())[0], by_hand(())
    on = resume_search(loop, after, seed=0)
    name = physical_effects(on.here.spec)[0]
    without = best_without(on.search, on.here, "sinusoidal-disturbance")
    assert on.here.scored.done.gain_over(without.scored.done) > 20.0
    assert support_of(on.search, on.here, name).supported is True
    assert support_of(on.search, on.here, name, rose=True).supported is None
    wrong = add(loop, after, "ramp-disturbance")
    step = next(s for s in wrong.steps if s.added == "ramp-disturbance")
    assert step.supported is not True
    grew = wrong.steps[-1].error.rmse > 1.001 * after.steps[-1].error.rmse
    assert grew == ("worse" in {f.code for f in step.findings})
