"""Gates on strokes at length: a drift behind a rounded output that puts three strokes right."""

from __future__ import annotations

from plants.run import plant_of
from plants.score import loop_of

from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify


def test_a_drift_that_puts_three_strokes_right_is_not_named() -> None:
    """It gained 149 in BIC, nine tenths of it in three strokes, behind a rounded output."""
    loop = loop_of(plant_of("clean", 14, 43_000))
    assert diagnose(loop, identify(loop), apply=True).missing == ()
