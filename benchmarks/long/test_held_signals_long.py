"""An output that lost its scans has a range of S and no sure answer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import test_held_signals
from quick_loops import PLAIN
from test_held_signals import SETTING, without_scans, written

from stictionid.model.closed_loop import Controller, simulate
from stictionid.record.loop import Loop
from stictionid.verbs.identify import Options, identify

# Fixtures of tests/.
loop = test_held_signals.loop


def test_an_output_that_lost_its_scans_sets_the_step_and_has_no_sure_answer(loop: Loop, tmp_path: Path) -> None:
    found = without_scans(loop, tmp_path)
    study = identify(found.loop, options=Options(base_only=True))
    said = next(f for f in study.steps[0].findings if f.code == "scans-too-noisy")
    assert said.no_intervals and all(p.interval is None for p in study.steps[0].parameters)
    # Along a path the noise that the lost scans had is part of the likelihood.
    low, high = identify(found.loop).estimate.S_interval
    assert low <= 4.0 <= high


def test_a_held_pv_gives_s_j_and_the_dead_time(loop: Loop, tmp_path: Path) -> None:
    e = identify(written(loop.cut(0, 1500), tmp_path, pv=10).loop, options=PLAIN).estimate
    assert e is not None and abs(e.S / 4.0 - 1.0) <= 0.005
    assert e.dead_time_s == pytest.approx(10.0, abs=2.0)  # repeats taken for measurements lengthen it by 4.5 s


def test_a_controller_that_scans_as_slowly_lost_nothing(tmp_path: Path) -> None:
    slow = simulate(replace(SETTING, controller=Controller(0.5, 30.0, scan_s=10.0)), seed=1).loop
    found = written(slow, tmp_path)
    said = [f for f in found.findings if f.code in ("output-slower", "output-sparse")]
    assert [f.code for f in said] == ["output-slower"] and "scans every 10 s" in said[0].statement
    e = identify(found.loop, options=Options(base_only=True)).estimate
    assert found.loop.step_s == 10.0 and e is not None and e.S_interval is not None
    assert e.S_interval[0] <= 4.0 <= e.S_interval[1] and abs(e.J - 2.0) <= 0.2
