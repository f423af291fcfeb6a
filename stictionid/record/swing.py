"""Parts of a process value, causes of its swing and harm of its valve, as frozen dataclasses of a study."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

BANDS = ((0.5, "negligible"), (1.0, "watch"), (2.0, "moderate"), (5.0, "significant"), (math.inf, "severe"))
"""Upper limits of the severity bands of S in % of travel, with their words. No standard fixes them.

Anchors are digital positioner precision 0.1 % and EnTech nominal backlash + stiction at most 1 %. Others are cycling
from 0.5 % (Ruel, Gerry) and 2 % in the Tennessee Eastman benchmark. Source: docs/details.md, section 13.
"""
BANDS_SOURCE = ("bands 0.5, 1, 2, 5 % of travel are conventions of this tool; EnTech (1998) asks for backlash plus "
                "stiction of 1 % or less, Ruel (2000) sees cycling from 0.5 %")


def band(S: float) -> str:
    """The word for a stickband plus deadband S in % of travel."""
    return next(word for limit, word in BANDS if limit > S)


def touched_bands(S: float, interval: tuple[float, float] | None) -> tuple[str, ...]:
    """The words of all bands that S and its interval in % of travel touch, in order."""
    ends = [S, *(interval or ())]
    words = [word for _, word in BANDS]
    return tuple(words[words.index(band(min(ends))):words.index(band(max(ends))) + 1])


@dataclass(frozen=True, slots=True)
class Share:
    """Share of one part in the variance of y. `part` is VALVE, SETPOINT, NOISE, START or the name of an effect.

    The names of parts that cancel, and are counted as one, are linked by "+".
    """

    part: str
    share: float

    VALVE: ClassVar[str] = "valve"
    SETPOINT: ClassVar[str] = "setpoint"
    NOISE: ClassVar[str] = "noise"
    START: ClassVar[str] = "start"


@dataclass(frozen=True, slots=True)
class Swing:
    """Parts of y and causes of its swing; each list of shares adds up to 1.

    `parts` are those of the fitted model, cov(part, y) / var(y). `causes` come from the same loop with a perfect valve:
    the valve's share is the variance of the deviation from the setpoint that is then gone. They are empty where that
    loop can't be run, and `reason` then says why. `sd` and `sd_perfect` are standard deviations of that deviation, in
    the unit of y. `goes_on` is true where a perfect valve leaves the swing, false where it ends it, and null between.
    """

    parts: tuple[Share, ...]
    causes: tuple[Share, ...] = ()
    sd: float | None = None
    sd_perfect: float | None = None
    goes_on: bool | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Severity:
    """Effect of the friction on the plant: band of S, the bands its interval touches, and the loop with repaired valve.

    `pv_sd` and `pv_sd_repaired` are in the unit of y, travel in % a day. `share_of_pv_variance` is the valve's share
    of the variance of y. Gain and integral time are those of the PI law read from the record. Null where the loop could
    not be run again; `statement` then gives the reason.
    """

    band: str | None
    band_interval: tuple[str, ...]
    pv_sd: float
    pv_sd_repaired: float | None
    share_of_pv_variance: float | None
    travel_per_day: float
    travel_per_day_repaired: float | None
    controller_gain: float | None
    integral_time_s: float | None
    statement: str
    source: str
