"""Effects at length: a search for all of them invents nothing in a loop with nothing hidden."""

from __future__ import annotations

from quick_loops import quick

from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, identify


def test_nothing_is_invented_in_a_loop_with_nothing_hidden() -> None:
    loop = quick()
    study = identify(loop, options=Options(intervals=False))
    found = diagnose(loop, study)
    assert found.missing == () and found.candidates == ()
    searched = diagnose(loop, study, everything=True)
    assert searched.missing == () and len(searched.candidates) > 10
    assert all(c.delta_bic is not None and c.delta_bic < 10 for c in searched.candidates)
