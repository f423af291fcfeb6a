"""One model for the same effects and the same base: `add`, `remove` and `diagnose --apply` end in it.

Errors agree within 1 %, S and J within a tenth of their intervals, the verdict and the effects are equal.
Twelve more loops, one of them in either order, are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from quick_loops import quick

from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.selection.decide import best_without
from stictionid.selection.node import physical_effects
from stictionid.selection.run import resume_search
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify
from stictionid.verbs.remove import remove
from stictionid.verbs.support import support_of

ERROR, OF_INTERVAL = 0.01, 0.1
# Of the loops here, in the unit of y.
NOISE = 0.05


def a_loop(*effects: tuple[str, dict[str, float]], **more) -> Loop:
    """A plain loop with S 4 and J 2.5 %, without its valve position."""
    base = Setting(Plant(3.0, 5.0, 5.0), Controller(0.1, 5.0, scan_s=1.0), S=4.0, J=2.5, duration_s=600.0,
                   setpoint_moves=((0.0, 5.0), (300.0, -6.0)), noise_sd=NOISE, effects=effects)
    return replace(simulate(replace(base, **more), seed=1).loop, position=None)


def assert_same(one: Study, other: Study) -> None:
    assert one.estimate is not None and other.estimate is not None
    assert sorted(one.steps[-1].effects) == sorted(other.steps[-1].effects)
    assert one.steps[-1].error.rmse == pytest.approx(other.steps[-1].error.rmse, rel=ERROR)
    for name in ("S", "J"):
        low, high = getattr(other.estimate, f"{name}_interval")
        assert getattr(one.estimate, name) == pytest.approx(getattr(other.estimate, name),
                                                            abs=OF_INTERVAL * (high - low))
    assert one.verdict.stiction == other.verdict.stiction


@cache
def swung() -> tuple[Loop, Study, Study]:
    """A loop that a sine swings, its study, and the study with what the search found.

    `identify` gives the residual a narrow band.
    """
    loop = replace(quick(effects=(("sinusoidal-disturbance", {"period_s": 61.0, "amplitude": 1.0}),), noise_sd=NOISE),
                   position=None)
    study = identify(loop, options=Options(between="hold"))
    return loop, study, diagnose(loop, study, apply=True)


@cache
def by_hand() -> Study:
    """The study of the swung loop with a sine added by hand, without a search before."""
    loop, study, _ = swung()
    return add(loop, study, "sinusoidal-disturbance")


def test_a_sine_added_by_hand_is_the_sine_of_the_search() -> None:
    """One that is added after a search is in benchmarks/long."""
    loop, study, applied = swung()
    (name,), noise, added = applied.missing, study.steps[-1].added, by_hand()
    assert (name, noise) == ("sinusoidal-disturbance", "narrow-band-disturbance")
    assert_same(added, applied)
    assert added.steps[-1].supported is True and added.steps[-1].error.rmse < 0.1 * study.steps[-1].error.rmse
    told = [f.statement for f in added.steps[-1].findings if f.code == "gave-way"]
    assert told == [f"left out: {noise}, needless beside {name}"]
    back = remove(loop, added, name)
    assert_same(back, study)
    worth = next(f for f in back.steps[-1].findings if f.code == "removed")
    assert worth.suggests == (name,) and f"worth {worth.evidence['bic']:.0f} BIC" in worth.statement


def test_an_effect_with_which_the_error_grows_is_never_supported() -> None:
    loop, after = swung()[0], by_hand()
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
