"""Records with gaps at length: three segments against the longest of them on six loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from quick_loops import PLAIN
from test_segments import scanned, with_gaps

from stictionid.model.restore import rerun
from stictionid.record.loop import Loop
from stictionid.record.segments import chosen
from stictionid.verbs.identify import identify


@pytest.mark.parametrize(("name", "loops"), [("foptd", 1), ("foptd", 3), ("itptd", 3)])
def test_segments_together_tell_more_than_the_longest_alone(name: str, loops: int) -> None:
    together_and_alone(name, range(loops))


def test_a_long_stretch_in_manual_ends_a_segment_and_a_short_one_does_not() -> None:
    before, after = scanned(S=5.0, J=3.0, seed=1, noise=0.2, duration_s=700.0), scanned(
        S=5.0, J=3.0, seed=2, noise=0.2, duration_s=700.0)
    manual, level = 300, 6.0  # a disturbance came while the controller was in manual
    loop = Loop(output=np.concatenate([before.output, np.full(manual, 47.0), after.output]),
                process_value=np.concatenate([before.process_value, np.linspace(50.0, 56.0, manual),
                                              after.process_value + level]),
                setpoint=np.concatenate([before.setpoint, np.full(manual, 56.0), after.setpoint + level]),
                used=np.repeat([True, False, True], [before.samples, manual, after.samples]))
    piece, notes = chosen(loop)
    assert piece.starts == (0, 700) and piece.begins_s == (0.0, 1000.0) and piece.used.all()
    assert notes[0].code == "segments-restarted" and notes[0].evidence["rows"] == [[0, 700], [1000, 700]]
    study = identify(loop, options=PLAIN)
    assert abs(study.estimate.S / 5.0 - 1.0) < 0.005 and study.steps[-1].error.rmse < 0.22
    curves = rerun(loop, study.steps[-1].model)
    assert np.isnan(curves.model[700:1000]).all() and np.isfinite(curves.model[[690, 1090]]).all()
    assert np.sqrt(np.nanmean(curves.residual**2)) == pytest.approx(study.steps[-1].error.rmse, rel=1e-6)
    short = replace(loop, used=np.arange(loop.samples) // 30 != 25)
    assert chosen(short) == (short, ())
    ended = replace(loop, used=np.arange(loop.samples) >= 700)
    assert chosen(ended) == (ended, ())


def together_and_alone(name: str, seeds: range) -> None:
    """Three segments give smaller errors of S and J than the longest of them, on average over loops."""
    errors = {"together": [], "longest": []}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        S = float(rng.uniform(4.0, 7.0))
        J = S * float(rng.uniform(0.3, 0.8))
        whole = scanned(name, S=S, J=J, seed=seed, noise=0.2, duration_s=1300.0 if name == "foptd" else 700.0)
        n = whole.samples
        a, b = int(n * rng.uniform(0.28, 0.33)), int(n * rng.uniform(0.6, 0.65))
        loop = with_gaps(whole, (a, a + 29), (b, b + 67))
        study = identify(loop, options=PLAIN)
        found = {"together": study.estimate, "longest": identify(loop.longest_segment(), options=PLAIN).estimate}
        finding = next(f for f in study.data.findings if f.code == "segments-restarted")
        assert finding.evidence["used"] == 3 and finding.evidence["samples"] == loop.samples
        assert [first for first, _ in finding.evidence["rows"]] == list(loop.starts)
        for which, e in found.items():
            # Without an answer nothing is known but the range of the search.
            errors[which].append((1.0, 1.0) if e is None else (abs(e.S / S - 1.0), abs(e.J - J) / S))
    together, longest = (np.array(errors[which]) for which in ("together", "longest"))
    assert (together.mean(axis=0) < longest.mean(axis=0)).all()
    assert together[:, 0].max() < 0.005
