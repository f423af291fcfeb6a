"""A whole loop whose PV came by swinging door: nothing is named that is not there."""

from __future__ import annotations

from dataclasses import replace

import lossy
import numpy as np
from rounding import setting_of

from stictionid.model.closed_loop import simulate
from stictionid.model.restore import described_segments
from stictionid.verbs.identify import identify


def test_straight_lines_are_no_further_lag() -> None:
    """A clean loop whose PV came by swinging door: nothing is named, and a later command sees the same rows."""
    setting = setting_of(17)[0]
    loop = simulate(replace(setting, duration_s=1500.0), seed=17).loop
    thin = replace(loop, process_value=np.round(lossy.lossy(loop.process_value, "door", 3.0 * setting.noise_sd), 4),
                   position=None)
    study = identify(thin)
    assert study.estimate is not None and abs(study.estimate.S / setting.S - 1.0) < 0.02
    assert not study.steps[-1].effects and study.data.rows_used < 0.3 * thin.samples
    again = described_segments(thin, study.steps[-1].model)[0]
    assert int(again.used.sum()) == study.data.rows_used
