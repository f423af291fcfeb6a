"""Every effect of the catalogue hidden once: named first, the error falls to the noise, S and J come back.

And loops with nothing hidden, in which nothing may be invented; and pairs, of which both are found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loops_with_effects import NOISE, PHYSICAL, SMALL, small

from stictionid.effects import catalogue, get
from stictionid.model.closed_loop import Controller, Plant, simulate
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify

HELD = Options(base_only=True, between="hold")
# What the noise effects leave one step ahead, and what the others leave of the free run, as a multiple of the noise.
_AT_THE_NOISE = 1.05


def test_every_effect_of_the_catalogue_is_hidden_once() -> None:
    assert set(SMALL) == set(catalogue())


@pytest.mark.parametrize("name", sorted(SMALL))
def test_the_hidden_effect_is_named_and_the_loop_comes_back(name: str) -> None:
    setting, loop = small(name)
    after = diagnose(loop, identify(loop, options=HELD), apply=True)
    assert after.missing[:1] == (name,), after.candidates[:3]
    assert after.steps[1].added == name and after.adequate
    last, estimate = after.steps[-1].error, after.estimate
    assert estimate is not None
    if get(name).noise is None:
        assert last.rmse <= _AT_THE_NOISE * NOISE
        # Eleven slow cycles under a command that moves by 0.1 % a scan: S is known to one of its steps.
        # The length of an overshooting slip trades against S: from 4.05 to 4.14 the squared error differs by 0.03 %.
        assert pytest.approx(setting.S, abs=0.2 if name == "slip-overshoot" else 0.1) == estimate.S
        assert pytest.approx(setting.J, abs=0.05 * setting.J) == estimate.J
    elif name == "coloured-noise":
        assert last.rmse_one_step is not None
        assert last.rmse_one_step <= _AT_THE_NOISE * float(SMALL[name][2]["innovation_sd"])
    assert all(c.detectable_from for c in after.candidates if c.effect == "extra-lag" and not c.accepted)


@pytest.mark.parametrize(("kind", "more"), [
    ("white", {}), ("karnopp", {"law": "karnopp"}), ("no moves", {"setpoint_moves": ((0.0, 3.0),)}), ("coloured", {})])
def test_nothing_is_invented_where_nothing_is_hidden(kind: str, more: dict) -> None:
    if kind == "no moves":
        # The small loop rests without its moves; this one cycles by itself.
        more = more | {"plant": Plant(1.2, 20.0, 4.0), "controller": Controller(0.7, 12.0, scan_s=1.0)}
    setting, loop = small(*(["coloured-noise"] if kind == "coloured" else []), **more)
    study = identify(loop)
    assert study.steps, study.verdict.reason
    after = diagnose(loop, study, apply=True)
    named = {step.added for step in after.steps if step.added}
    assert named <= {"karnopp": PHYSICAL, "coloured": {"coloured-noise"}}.get(kind, set())
    assert setting.effects or after.adequate


@pytest.mark.parametrize("pair", [
    ("step-disturbance", "extra-lag"), ("stiction-drift", "sinusoidal-disturbance"),
    # Coloured noise imitates both of these, and beside it neither shows.
    ("step-disturbance", "asymmetric-stiction")])
def test_two_hidden_effects_are_both_found(pair: tuple[str, str]) -> None:
    setting, loop = small(*pair)
    after = diagnose(loop, identify(loop, options=HELD), apply=True)
    assert set(after.missing) == set(pair) and after.adequate
    assert after.steps[-1].error.rmse <= _AT_THE_NOISE * NOISE
    assert after.estimate is not None and pytest.approx(setting.S, abs=0.1) == after.estimate.S


def test_the_records_of_the_small_loops_are_repeatable() -> None:
    setting, loop = small("step-disturbance")
    again = simulate(replace(setting), seed=21).loop
    assert (loop.process_value == again.process_value).all()


def test_a_travel_limit_short_of_most_of_the_command_is_found() -> None:
    # The controller winds up against the stop: the command is beyond it for more than half of the record.
    limit = ("travel-limit", {"upper": 49.2})
    setting, loop = small(**{"effects": (limit,), "plant": Plant(0.84, 13.0, 4.7), "S": 2.9, "J": 1.6,
                             "duration_s": 1200.0,
                             "controller": Controller(1.2, 13.0, scan_s=1.0),
                             "setpoint_moves": ((0.0, -0.5), (300.0, -1.5), (500.0, 1.8), (800.0, -1.5))})
    assert np.median(loop.output) > 49.2 + 0.6 * setting.S
    after = diagnose(loop, identify(loop, options=HELD), apply=True)
    assert after.missing[:1] == ("travel-limit",)
    assert after.steps[-1].error.rmse <= _AT_THE_NOISE * NOISE
    numbers = {p.name: p for p in after.steps[-1].parameters}
    assert numbers["S"].value == pytest.approx(2.9, rel=0.02) and numbers["J"].value == pytest.approx(1.6, rel=0.05)
    assert numbers["upper"].value == pytest.approx(49.2, abs=0.05)
    assert not numbers["lower"].identifiable and numbers["lower"].interval is None
