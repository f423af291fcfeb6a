"""Units and scaling of OP and PV: per cent of travel or not, spans to per cent, split range, reversed output."""

from __future__ import annotations

import numpy as np

from ...errors import UsageError
from ...record.loop import Finding
from ...typing import FloatArray
from .findings import finding

PERCENT_LOW, PERCENT_HIGH = -6.9, 106.9
"""Range of a controller output in per cent; many systems drive -5 to 105 or -6.9 to 106.9 (Honeywell)."""
MIN_CENTRE_RATIO = 0.5
"""A signal whose mean is nearer to zero than this share of its standard deviation is normalised, not a per cent."""
MILLIAMPERES = (3.6, 21.0)
"""Range of a 4-20 mA signal with the margins of NAMUR NE 43."""
MAX_SPAN = 1e12
"""Largest bound of a span, and its inverse the smallest width: beyond that no instrument has a range."""
LIVE_ZERO = (4.0, 20.0)
"""Range of an output in mA that drives a valve."""
OTHER = "unit of OP"
TIED = (
    r"%|pct|percent|°[CFK]|deg\s?[CFK]|bar[ga]?|mbar|[kM]?Pa[ga]?|psi[ga]?|mmH2O|inH2O|atm|mA|Hz|rpm|kg/cm2|pH|ppm|"
    r"(?:[kM]?N?m[³3]|[kM]?g|k?t|l|L|scf|gal|kmol|bbl|t)\s?/\s?(?:h|hr|min|s|d|sec)|mol\s?%|vol\s?%|m3|m³"
)
"""Pattern of the units that a name may end in without a bracket: "PV mA", "OP_%"."""
_RANGES = (
    (0.0, 1.0),
    (0.0, 10.0),
    (0.0, 1000.0),
    (0.0, 1023.0),
    (0.0, 4095.0),
    (0.0, 10_000.0),
    (0.0, 16_383.0),
    (0.0, 27_648.0),
    (0.0, 32_767.0),
    (0.0, 65_535.0),
)
"""Output ranges of controllers and cards in use, for the hint."""


def check_span(span: tuple[float, float] | None, flag: str) -> None:
    """UsageError for a span that is empty or upside down."""
    if span is not None and not (max(map(abs, span)) <= MAX_SPAN and span[1] - span[0] >= 1 / MAX_SPAN):
        raise UsageError(
            f"{flag} {span[0]:g},{span[1]:g} is no range", f"give LO,HI with LO below HI, for example {flag} 0,100"
        )


def to_percent(values: FloatArray, span: tuple[float, float]) -> FloatArray:
    """Values as per cent of a span."""
    return (values - span[0]) / (span[1] - span[0]) * 100.0


def drives_in_milliamperes(values: FloatArray, unit: str) -> bool:
    """True for an output in mA whose values stay within 4 to 20."""
    known = values[~np.isnan(values)]
    return unit.strip().lower() == "ma" and known.size > 0 and bool(
        MILLIAMPERES[0] <= known.min() and known.max() <= MILLIAMPERES[1])


def output_unit(values: FloatArray, unit: str) -> tuple[str, Finding | None]:
    """Unit of OP ("%" or "unit of OP") by its values and its unit cell, with a finding where it is no per cent."""
    known = values[~np.isnan(values)]
    if not known.size:
        return OTHER, None
    low, high = float(known.min()), float(known.max())
    text = unit.strip().lower()
    if text not in ("pct", "percent", "op", "-", "eu", "") and not text.startswith("%"):
        return OTHER, _finding(
            low, high, f"its unit is {unit!r}", "--span-op 0,20" if text == "ma" else "--span-op LO,HI"
        )
    if text.startswith("%") and low >= PERCENT_LOW and high <= PERCENT_HIGH:
        return "%", None
    if low < PERCENT_LOW or high > PERCENT_HIGH:
        span = next((r for r in _RANGES if low >= r[0] and high <= r[1] and r[1] > 100), None)
        hint = (
            f"--span-op {span[0]:g},{span[1]:g}, or another range, if it drives a valve"
            if span and low >= 0
            else "--span-op LO,HI"
        )
        return OTHER, _finding(
            low, high, "it leaves 0 to 100 %: the setpoint of a slave loop (cascade master), or another range", hint
        )
    if MILLIAMPERES[0] <= low and high <= MILLIAMPERES[1] and high - low > 0 and not text:
        return "%", finding("output-perhaps-ma", {"low": low, "high": high}, low=low, high=high)
    if low >= 0 and high <= 1.0 and high > low:
        return OTHER, _finding(low, high, "it stays within 0 to 1", "--span-op 0,1 if 1 means fully open")
    if low < 0 and abs(float(known.mean())) < max(MIN_CENTRE_RATIO * float(known.std()), 1e-12):
        return OTHER, _finding(
            low, high, "it swings about zero: normalised data", "--span-op LO,HI if the range is known"
        )
    return "%", None


def _finding(low: float, high: float, why: str, hint: str) -> Finding:
    return finding("output-not-percent", {"low": low, "high": high}, low=low, high=high, why=why, hint=hint)
