"""Long records: choice of the excerpt, agreement with the answer of the whole record, errors over all of it.

An excerpt beside the whole record, and one of several segments, are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import naive
import numpy as np
import pytest
from quick_loops import PLAIN

from stictionid.model.closed_loop import preset, simulate
from stictionid.record.loop import Loop
from stictionid.record.oscillation import crossings, find_range, reversals
from stictionid.verbs import long_records as room
from stictionid.verbs.identify import Options, identify

FOPTD = preset("foptd")
SCANNED = replace(FOPTD, S=4.0, J=2.0, controller=replace(FOPTD.controller, scan_s=1.0), noise_sd=0.05,
                  duration_s=3000.0)


def wave(periods: list[float], samples: int) -> Loop:
    """A command whose period changes from stretch to stretch of `samples`."""
    phase = np.cumsum(np.repeat([2 * np.pi / p for p in periods], samples))
    return Loop(output=50.0 + np.sin(phase), process_value=np.cos(phase))


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "SEARCHED", 1000)
    monkeypatch.setattr(room, "POLISHED", 2000)
    monkeypatch.setattr(room, "PERIODS", 8.0)


def test_the_stretch_with_the_most_reversals_is_searched_and_more_around_it_polished(short) -> None:
    loop = wave([100.0, 20.0, 100.0], 1500)
    view = room.excerpt(loop, replace(find_range(loop), period_median_s=20.0), Options())
    assert view is not None
    assert view.searched.start >= 1490 and view.searched.stop <= 3010
    assert view.count(view.searched) == pytest.approx(100, abs=1)
    more = view.polished(1)
    assert more.start <= view.searched.start and more.stop >= view.searched.stop and more.stop - more.start == 2000
    assert view.polished(2) == view.searched  # so few rows more would not pay
    assert view.loop.samples == 1000


def test_an_excerpt_stays_within_one_segment_and_sees_enough_periods(short) -> None:
    loop = replace(wave([20.0], 4000), starts=(0, 700, 1600))
    view = room.excerpt(loop, find_range(loop), Options())
    assert view is not None and view.searched.start >= 1600 and view.polished(1).stop <= 4000
    slow = wave([200.0], 4000)
    view = room.excerpt(slow, find_range(slow), Options())
    assert view is not None and view.loop.samples == pytest.approx(1600, abs=20)


def test_short_records_and_effects_that_run_by_the_clock_are_searched_whole(short) -> None:
    loop = wave([20.0], 4000)
    found = find_range(loop)
    assert room.excerpt(loop.cut(0, 1000), found, Options()) is None
    for name in ("stiction-drift", "ramp-disturbance"):
        assert room.excerpt(loop, found, Options(effects=(name,))) is None
    assert room.excerpt(loop, found, Options(effects=("extra-lag",))) is not None


def test_a_loop_that_changed_on_the_way_is_said_to(short) -> None:
    one = simulate(replace(SCANNED, duration_s=2000.0), seed=1).loop
    centre = float(one.process_value.mean())
    steeper = centre + 1.5 * (one.process_value - centre)  # the process gain has grown
    loop = Loop(output=np.tile(one.output, 2), process_value=np.append(one.process_value, steeper))
    study = identify(loop, options=PLAIN)
    note = next(f for f in study.data.findings if f.code == "searched-on-excerpt")
    assert note.severity == "warning" and note.evidence["rmse"] > 1.25 * note.evidence["rmse_polished"]
    assert "not the same throughout" in note.statement


@pytest.mark.parametrize("band", [0.0, 0.4])
def test_crossings_and_reversals_are_those_of_the_written_rules(band: float) -> None:
    signal = np.cumsum(np.random.default_rng(4).standard_normal(3000)) * 0.3
    signal -= signal.mean()
    np.testing.assert_array_equal(crossings(signal, band), naive.crossings(signal, band))
    turns = reversals(signal, 0.5)
    assert len(turns) > 20
    for a, b in pairwise(turns):
        assert np.ptp(signal[a:b + 1]) > 0.5
