"""One model for the same effects and the same base: `add`, `remove` and `diagnose --apply` end in it.

Errors agree within 1 %, S and J within a tenth of their intervals, the verdict and the effects are equal.
Twelve more loops, one of them in either order, are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from quick_loops import asked_only, quick

from stictionid.effects import catalogue
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify
from stictionid.verbs.remove import remove

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


FEW = ("sinusoidal-disturbance", "narrow-band-disturbance", "ramp-disturbance")


@cache
def swung(among: tuple[str, ...]) -> tuple[Loop, Study, Study]:
    """A loop that a sine swings, its study, and the study with what the search found among these effects.

    `identify` gives the residual a narrow band. Without `among` the search asks for all effects.
    """
    loop = replace(quick(effects=(("sinusoidal-disturbance", {"period_s": 61.0, "amplitude": 1.0}),), noise_sd=NOISE),
                   position=None)
    with asked_only(*(among or catalogue())):
        study = identify(loop, options=Options(between="hold"))
        return loop, study, diagnose(loop, study, apply=True)


@cache
def by_hand(among: tuple[str, ...]) -> Study:
    """The study of the swung loop with a sine added by hand, without a search before."""
    loop, study, _ = swung(among)
    with asked_only(*(among or catalogue())):
        return add(loop, study, "sinusoidal-disturbance")


def by_hand_as_searched(among: tuple[str, ...]) -> None:
    """The sine that is added by hand ends in the model of the search among these effects."""
    loop, study, applied = swung(among)
    (name,), noise, added = applied.missing, study.steps[-1].added, by_hand(among)
    assert (name, noise) == ("sinusoidal-disturbance", "narrow-band-disturbance")
    assert_same(added, applied)
    assert added.steps[-1].supported is True and added.steps[-1].error.rmse < 0.1 * study.steps[-1].error.rmse
    told = [f.statement for f in added.steps[-1].findings if f.code == "gave-way"]
    assert told == [f"left out: {noise}, needless beside {name}"]
    with asked_only(*(among or catalogue())):
        back = remove(loop, added, name)
    assert_same(back, study)
    worth = next(f for f in back.steps[-1].findings if f.code == "removed")
    assert worth.suggests == (name,) and f"worth {worth.evidence['bic']:.0f} BIC" in worth.statement


def test_a_sine_added_by_hand_is_the_sine_of_the_search() -> None:
    """A search among all effects, and a sine that is added after it, are in benchmarks/long."""
    by_hand_as_searched(FEW)
