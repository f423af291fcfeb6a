"""Backlash in the linkage ahead of the stem: a known play that widens the deadband.

In u and y a play is deadband: S holds it, and nothing else shows. A position that is measured behind the play shows S
as y does; one that is measured ahead of it shows an S that is smaller by the play. This effect is for a play that is
known, from such a position or from a gauge: `backlash:1.5` is one of 1.5 %, and S is then that of the friction alone.

Equation: f_s and f_d grow by play / 2 each, so that the band grows from S to S + play, and J stays. Source:
docs/details.md, section 3; IEC 60534-4, dead band.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..laws.contract import FD_DOWN, FD_UP, FS_DOWN, FS_UP
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import BY_HAND, Effect, Place, Scales, Values, known_value

_PLAY = Parameter("play", "%", 0.0, 50.0, 0.0, "play of the linkage, known")


def _friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
    table = table.copy()
    for row in (FS_UP, FS_DOWN, FD_UP, FD_DOWN):
        table[row] += 0.5 * theta[0]
    return table


def _known(option: str) -> Effect:
    """The effect with the play that its name gives."""
    given = np.array([known_value("backlash", option, _PLAY)])

    def friction(table: FloatArray, theta: FloatArray, command_step_s: float, held: bool) -> FloatArray:
        return _friction(table, given[:, None], command_step_s, held)

    def report(searched: Mapping[str, float], sizes: FloatArray, base: Mapping[str, float]) -> dict[str, float]:
        return {_PLAY.name: float(given[0])}

    return replace(EFFECT, searched=(), friction=friction, report=report)


def _visible(scales: Scales) -> Values:
    return {"play": 0.3 * scales.S}


EFFECT = Effect(
    name="backlash", kind="F", place=Place.FRICTION,
    summary="a known play of the linkage ahead of the stem widens the deadband",
    equation="f_s and f_d grow by play / 2 each", source="docs/details.md, section 3; IEC 60534-4, dead band",
    parameters=(_PLAY,), needs=("value",), asked=BY_HAND, friction=_friction, known=_known,
    visible=_visible,
    noun="play in the linkage",
    sentence="Play of {play} in the linkage widens the deadband.",
    seen_over="direction",
    action="Tighten or replace the linkage between actuator and stem.",
    settled_by="a position measured ahead of the linkage, beside one behind it",
)
