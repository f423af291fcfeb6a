"""Long records at length: an excerpt gives the answer of the whole record and its errors."""

from __future__ import annotations

from dataclasses import replace

import naive
import numpy as np
import pytest
import test_excerpt
from quick_loops import PLAIN
from test_excerpt import SCANNED

from stictionid.model.closed_loop import simulate
from stictionid.model.restore import rerun
from stictionid.record.controller import Controller
from stictionid.verbs import long_records as room
from stictionid.verbs.identify import Options, identify
from stictionid.verbs.screen import screen
from stictionid.verdict.severity import perfect_valve

# Fixtures of tests/.
short = test_excerpt.short


def test_an_excerpt_gives_the_answer_of_the_whole_record_and_its_errors(short, monkeypatch) -> None:
    loop = simulate(SCANNED, seed=4).loop
    study = identify(loop, options=Options(base_only=True, between="hold"))
    monkeypatch.setattr(room, "SEARCHED", 10_000)
    whole = identify(loop, options=Options(base_only=True, between="hold"))
    a, b = study.estimate, whole.estimate
    assert a.S_interval[0] <= b.S <= a.S_interval[1] and a.J_interval[0] <= b.J <= a.J_interval[1]
    assert b.S_interval[0] <= a.S <= b.S_interval[1] and b.J_interval[0] <= a.J <= b.J_interval[1]
    note = next(f for f in study.data.findings if f.code == "searched-on-excerpt")
    assert note.severity == "info" and note.evidence["samples"] == 3000 and "3,000 samples" in note.statement
    assert not [f for f in whole.data.findings if f.code == "searched-on-excerpt"]
    # The errors are those of all samples: of the described model, run again.
    curves = rerun(loop, study.steps[-1].model)
    assert study.steps[-1].error.rmse == pytest.approx(np.sqrt(np.nanmean(curves.residual**2)), rel=1e-9)
    assert study.steps[-1].error.rmse == pytest.approx(whole.steps[-1].error.rmse, rel=0.01)
    assert study.adequate and study.verdict.stiction == whole.verdict.stiction == "stiction"
    monkeypatch.setattr(room, "SEARCHED", 1000)
    quick = screen(loop)
    assert quick.verdict.stiction == "stiction" and quick.data.findings[-1].evidence["searched"] == [
        *note.evidence["searched"]]


def test_of_several_segments_one_is_searched_and_the_slips_of_all_settle_the_break_away(short) -> None:
    whole = simulate(SCANNED, seed=4).loop
    loop = replace(whole, starts=(0, 900, 2100), begins_s=(0.0, 1500.0, 4000.0))
    study = identify(loop, options=Options(base_only=True))
    note = next(f for f in study.data.findings if f.code == "searched-on-excerpt")
    assert note.severity == "info" and note.evidence["searched"][0] >= 900
    assert study.steps[-1].error.rmse == pytest.approx(0.05, rel=0.05)  # the noise; 0.071 where slips came early
    assert pytest.approx(4.0, rel=1e-3) == study.estimate.S


def test_the_loop_without_friction_is_the_plain_recursion() -> None:
    loop = simulate(SCANNED, seed=3).loop.cut(0, 400)
    study = identify(loop, options=PLAIN)
    residual = np.random.default_rng(0).standard_normal(400) * 0.01
    law = Controller("PI", 0.1, 5.0, None)
    for changed in ({}, {"integrating": True, "gain": 0.05}, {"time_constants_s": ()},
                    {"time_constants_s": (5.0, 2.0)}):
        estimate = replace(study.estimate, **changed)
        ours = perfect_valve(loop, estimate, law, loop.setpoint, residual, float(loop.process_value[0]),
                             float(loop.output[0]))
        assert ours[2]
        theirs = naive.repaired(loop.setpoint, residual, estimate, law, float(loop.output[0]),
                                float(loop.process_value[0]), loop.step_s)
        np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-9)
        np.testing.assert_allclose(ours[1], theirs[1], rtol=1e-9)
