"""Scans between the samples at length: a command that moves stays so beside an effect that the base lacks."""

from __future__ import annotations

from loops_with_effects import loop_of

from stictionid.verbs.identify import Options, identify


def test_a_missing_effect_does_not_make_a_moving_command_a_held_one() -> None:
    _, loop, (kind, bed), _ = loop_of(718, "valve-characteristic", 0.01, 0.0, 1500)
    assert (kind, bed) == ("moving", "second order")
    assert identify(loop, options=Options(base_only=True)).steps[0].model["between"] == "corner"
