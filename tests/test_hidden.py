"""A hidden effect is named, and brings the error to the noise and S and J back; where none is hidden none is named.

Every effect of the catalogue is hidden, named and added in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from loops_with_effects import NOISE, SMALL, small
from quick_loops import HELD, MOVES, PLAIN, asked_only

from stictionid.effects import catalogue, get
from stictionid.model.closed_loop import Setting, simulate
from stictionid.record.study import Study, study_from_json, to_json
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify

# What the noise effects leave one step ahead, and what the others leave of the free run, as a multiple of the noise.
AT_THE_NOISE = 1.05
# Named here. test_diagnose.py names a step, test_search.py a sine, the walk of README.md a stop. Added by name are a
# step and a sine there, a lag and a noise in test_prompt.py. benchmarks/long names and adds all others.
NAMED = ("asymmetric-stiction",)


def test_every_effect_of_the_catalogue_is_hidden_once() -> None:
    assert set(SMALL) == set(catalogue())


def comes_back(study: Study, name: str, setting: Setting) -> None:
    """The error of the last model is the noise, and S and J are the true ones."""
    last, estimate = study.steps[-1].error, study.estimate
    assert estimate is not None and (study.completed if get(name).noise is not None else study.adequate)
    if get(name).noise is None:
        assert last.rmse <= AT_THE_NOISE * NOISE
        # Eleven slow cycles under a command that moves by 0.1 % a scan: S is known to one of its steps.
        # The length of an overshooting slip trades against S: from 4.05 to 4.14 the squared error differs by 0.03 %.
        assert pytest.approx(setting.S, abs=0.2 if name == "slip-overshoot" else 0.1) == estimate.S
        assert pytest.approx(setting.J, abs=0.05 * setting.J) == estimate.J
    elif name == "coloured-noise":
        assert last.rmse_one_step is not None
        assert last.rmse_one_step <= AT_THE_NOISE * float(SMALL[name][2]["innovation_sd"])


FEW = ("asymmetric-stiction", "extra-lag", "stiction-drift", "travel-limit")


def named(name: str, options: Options = HELD, **more) -> Study:
    """The study of the small loop of an effect, which is named first and brings the loop back; `more` is for `small`.
    """
    setting, loop = small(name, **more)
    after = diagnose(loop, identify(loop, options=options), apply=True)
    assert after.missing[:1] == (name,), after.candidates[:3]
    assert after.steps[1].added == name
    comes_back(after, name, setting)
    return after


def named_and_whole(name: str) -> None:
    """The effect is named on the quick record, and what its candidates say is whole."""
    after = named(name, PLAIN, seed=11, duration_s=450.0, setpoint_moves=MOVES)
    assert study_from_json(to_json(after)) == after
    top = after.candidates[0]
    assert top.accepted and top.effect == name and top.rmse_one_step_holdout is not None
    assert {p.name for p in top.parameters} <= {p.name for p in catalogue()[name].parameters}
    assert all(c.detectable_from for c in after.candidates if c.effect == "extra-lag" and not c.accepted)


@pytest.mark.parametrize("name", NAMED)
def test_the_hidden_effect_is_named_and_the_loop_comes_back(name: str) -> None:
    """Among four effects; benchmarks/long names it among all."""
    with asked_only(*FEW):
        named_and_whole(name)


def test_the_records_of_the_small_loops_are_repeatable() -> None:
    setting, loop = small("step-disturbance")
    again = simulate(replace(setting), seed=21).loop
    assert (loop.process_value == again.process_value).all()
