"""Measurement limit: the transmitter is clipped at the ends of its range, so that y rests while the process moves on.

Samples at a limit say nothing but that the process was beyond it; they don't count. The limits are read from the
record: its highest or lowest value, where far more samples share it than lie just below or above. A signal that is
rounded has as many samples at the next values, and is left alone. A short record that turns at one value several times
can't be told from a clipped one; a trend of the transmitter's own range tells. Of a record that was kept by exception
every value counts once, however long it is held.

Equation: y = min(max(x, lower), upper), x the process value. Source: saturation of a 4..20 mA transmitter, NAMUR NE 43.
"""

from __future__ import annotations

import numpy as np

from ..numerics.archived import archived
from ..numerics.parameters import Parameter
from ..typing import BoolArray, FloatArray
from .contract import Effect, Place, Scales, Values

_LOWER = Parameter("lower", "unit of y", -1e12, 1e12, -1e12, "lower end of the transmitter's range")
_UPPER = Parameter("upper", "unit of y", -1e12, 1e12, 1e12, "upper end of the transmitter's range")
# Fewest samples at a limit, as a number and as a share of the record; how many times as many as in the strip beside it,
# which is as wide as the second number times the range.
_FEWEST, _SHARE, _MORE, _STRIP = 6, 0.005, 5.0, 0.01
# Values closer than this share of the range are the same.
_SAME = 1e-9


def _counted(y: FloatArray) -> BoolArray:
    """Samples (n,) that are not at a limit of the transmitter."""
    thin = archived(y)
    there = y[np.isfinite(y) if thin is None else thin.kept & np.isfinite(y)]
    found = np.ones(y.size, dtype=np.bool_)
    if not there.size or not np.ptp(there) > 0.0:
        return found
    span = float(np.ptp(there))
    for end, way in ((float(there.max()), 1.0), (float(there.min()), -1.0)):
        away = way * (end - there)
        here = int((away <= _SAME * span).sum())
        beside = np.sort(away[away > _SAME * span])
        # The strip holds at least the next value that occurs, whatever the rounding.
        wide = max(_STRIP * span, 1.5 * float(beside[0])) if beside.size else _STRIP * span
        if here >= max(_FEWEST, _SHARE * there.size) and here >= _MORE * int((beside <= wide).sum()):
            found &= ~(np.isfinite(y) & (way * (end - y) <= _SAME * span))
    return found


def _measured(y: float, values: Values) -> float:
    return min(max(y, values["lower"]), values["upper"])


def _report(searched: Values, sizes: FloatArray, base: Values) -> dict[str, float]:
    ends = {}
    if base["lowest"] < base["lowest_counted"]:
        ends["lower"] = base["lowest"]
    if base["highest"] > base["highest_counted"]:
        ends["upper"] = base["highest"]
    return ends


def _visible(scales: Scales) -> Values:
    return {"upper": scales.top - 0.2 * scales.swing}


EFFECT = Effect(
    name="measurement-limit", kind="T", place=Place.DISTURBANCE,
    summary="the transmitter is clipped at the ends of its range; samples there don't count",
    equation="y = min(max(x, lower), upper), x the process value", source="saturation of a transmitter, NAMUR NE 43",
    parameters=(_LOWER, _UPPER), searched=(), confused_with=("gain-nonlinearity",), counted=_counted,
    measured=_measured, report=_report,
    visible=_visible,
    leaves={"value": 4},
    noun="a transmitter that is clipped",
    sentence="The transmitter ends at [{lower}|{upper}]; samples there do not count.",
    seen_over="y",
    action="Widen the range of the transmitter.",
    settled_by="the range of the transmitter, or a second one",
    told_apart={
        "gain-nonlinearity": "the range of the transmitter, or a second one",
    },
)
