"""Scans between the samples at length: a command that moves stays so beside an effect that the base lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loops_with_effects import loop_of
from test_scan import POINTS, SETTING, thinned

from stictionid.model.restore import rebuild_model, rerun
from stictionid.record.study import study_from_json, to_json
from stictionid.verbs.identify import Options, identify


def test_a_missing_effect_does_not_make_a_moving_command_a_held_one() -> None:
    _, loop, (kind, bed), _ = loop_of(718, "valve-characteristic", 0.01, 0.0, 1500)
    assert (kind, bed) == ("moving", "second order")
    assert identify(loop, options=Options(base_only=True)).steps[0].model["between"] == "corner"


def test_auto_finds_the_scans_and_with_them_s_and_j() -> None:
    loop, _ = thinned(5, replace(SETTING, noise_sd=0.01))
    study = identify(loop, options=POINTS)
    model = study.steps[0].model
    assert (model["between"], model["substeps"], len(model["guides"])) == ("decimated", 5, 2)
    assert pytest.approx(3.0, rel=0.01) == study.estimate.S and pytest.approx(1.5, abs=0.1) == study.estimate.J
    note = next(f for f in study.steps[0].findings if f.code == "scans-between-samples")
    assert note.evidence["integral_time_s"] == pytest.approx(12.0, rel=0.02) and "held-out" in note.statement
    # The study alone runs the very same model again.
    again = study_from_json(to_json(study))
    error = study.steps[0].error.best
    left = rerun(loop, again.steps[0].model).residual
    assert np.sqrt(np.nanmean(left**2)) == pytest.approx(error, rel=1e-6)
    held = identify(loop, options=replace(POINTS, between="hold"))
    assert abs(held.estimate.S - 3.0) > 3.0 * abs(study.estimate.S - 3.0)
    assert rebuild_model(loop, model)[0].context.command.size == 5 * loop.samples


def test_noise_between_samples_is_said_and_ends_in_an_abstention() -> None:
    loop, _ = thinned(5, replace(SETTING, noise_sd=0.3))
    told = identify(loop, options=Options(base_only=True))
    warning = next(f for f in told.steps[0].findings if f.code == "scans-too-noisy")
    assert warning.evidence["noise_to_pace"] > warning.evidence["limit"]
    assert told.steps[0].model["between"] != "decimated"
    # By the law what the samples can't show bends S beyond any interval that they would give.
    assert told.estimate.S_interval is None and all(p.interval is None for p in told.steps[0].parameters)
    asked = identify(loop, options=Options(between="decimated", base_only=True))
    assert asked.estimate is None and asked.verdict.evidence.code == "moves-between-samples"
    # Along a path that noise is part of the likelihood.
    along = identify(loop).estimate
    assert along.S_interval[0] <= 3.0 <= along.S_interval[1] < 2.0 * 3.0
