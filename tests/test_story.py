"""Headline, verdict and what to do: they follow from the last model of a study, whatever the way to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stictionid.model.closed_loop import Setting, preset, simulate, with_stiction
from stictionid.model.model import Model
from stictionid.model.restore import rerun
from stictionid.model.spec import Spec


def setting_of(S: float, J: float, *effects: tuple[str, dict[str, float]], duration_s: float = 900.0) -> Setting:
    """The first-order loop of the presets with a scanning controller, noise 0.1 and hidden effects."""
    made = with_stiction(preset("foptd"), S, J)
    return replace(made, controller=replace(made.controller, scan_s=1.0), noise_sd=0.1, duration_s=duration_s,
                   effects=effects)


# Position ----------------------------------------------------------------------------------------------------------


def test_the_position_of_a_model_is_that_of_the_stem_in_front_of_the_trim() -> None:
    loop = simulate(setting_of(4.0, 2.0, ("valve-characteristic", {"log_rangeability": 3.5}), duration_s=600.0),
                    seed=2).loop
    model = Model(loop, Spec(effects=("valve-characteristic",)), s_max=7.0, period_s=60.0)
    truth = {"S": 4.0, "J": 2.0, "initial_residual_force": 0.0, "time_constant_s": 5.0, "dead_time_s": 5.0,
             "valve-characteristic:log_rangeability": 3.5}
    values = model.vector(truth)
    shown = rerun(loop, model.describe(values)).position
    assert loop.position is not None
    late = slice(300, None)  # behind the first slips, which an unknown start force moves
    assert np.abs(shown - loop.position)[late].max() < 0.1
    assert np.abs(model.evaluate(values).position - loop.position)[late].max() > 10.0
