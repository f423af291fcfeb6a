"""Whole studies whose headline, verdict and next steps were once wrong, from the search to the page."""

from __future__ import annotations

from dataclasses import replace

import loops
import pytest

from stictionid.model.closed_loop import Setting, preset, simulate, with_stiction
from stictionid.record.loop import Loop
from stictionid.reports.facts import facts
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose, whole_study
from stictionid.verbs.identify import Options, identify
from stictionid.verbs.remove import remove

DRIFT = ("stiction-drift", {"stickband_growth": 0.8, "jump_growth": 0.133})
SINE = ("sinusoidal-disturbance", {"period_s": 80.0, "amplitude": 2.0})


def loop_of(S: float, J: float, seed: int, *effects: tuple[str, dict[str, float]], scan_s: float = 1.0,
            duration_s: float = 1500.0, position: bool = False) -> Loop:
    made: Setting = with_stiction(preset("foptd"), S, J)
    setting = replace(made, controller=replace(made.controller, scan_s=scan_s), noise_sd=0.1, duration_s=duration_s,
                      effects=effects)
    loop = simulate(setting, seed=seed).loop
    return loop if position else replace(loop, position=None)


def told(study) -> str:
    said = facts(study)
    return " ".join((said.headline, *said.then))


@pytest.mark.parametrize("position", [False, True])
@pytest.mark.parametrize("seed", [63, 64, 65])
def test_a_drifting_valve_sticks_and_has_no_neighbour(seed: int, position: bool) -> None:
    study = whole_study(loop_of(4.0, 2.0, seed, DRIFT, position=position), options=Options())
    assert study.verdict.stiction == "stiction"
    assert "neighbour" not in told(study) and "the valve's friction" in told(study)


@pytest.mark.parametrize("effect", ["asymmetric-stiction", "stiction-drift", "slip-overshoot"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_an_effect_on_friction_makes_no_neighbours_cycle_a_sticking_valve(seed: int, effect: str) -> None:
    loop = loops.clean(seed, "elsewhere", samples=700).loop
    study = identify(loop, options=Options(base_only=True))
    assert add(loop, study, effect).verdict.stiction != "stiction"


def test_a_drift_added_by_hand_has_one_verdict_with_and_without_what_it_replaces() -> None:
    loop = loop_of(4.0, 2.0, 63, DRIFT)
    study = diagnose(loop, identify(loop, options=Options()))
    after = add(loop, study, "stiction-drift")
    assert after.verdict.stiction == "stiction"
    for name in [n for n in after.steps[-1].effects if n != "stiction-drift"]:
        after = remove(loop, after, name)
        assert after.verdict.stiction == "stiction" and "neighbour" not in told(after)


@pytest.mark.parametrize(("scan_s", "duration_s"), [(0.0, 1000.0), (1.0, 1000.0)])
def test_a_sine_beside_a_healthy_valve_leaves_no_step(scan_s: float, duration_s: float) -> None:
    loop = loop_of(0.0, 0.0, 8, SINE, scan_s=scan_s, duration_s=duration_s)
    study = whole_study(loop, options=Options())
    assert study.verdict.stiction == "no stiction" and "Service the valve" not in told(study)
    assert not {"step-disturbance", "ramp-disturbance"} & set(study.steps[-1].effects)
    above = study.verdict.evidence.S_excluded_above
    assert above >= study.estimate.S and above >= (study.estimate.S_interval or (0.0, 0.0))[1]


def test_a_positioner_that_is_not_found_is_not_said_to_be_unknown() -> None:
    loop = loop_of(4.0, 2.0, 61, ("positioner", {"integral_rate": 0.05}), duration_s=1000.0, position=True)
    study = whole_study(loop, options=Options())
    assert "catalogue does not hold" not in study.missing_reason
    if study.adequate is False:
        bullets = next(s for s in facts(study).sections if s.key == "next").bullets
        assert any("The measured position gives S" in b for b in bullets)
