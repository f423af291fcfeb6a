"""Format of numbers and foreign text: rounding, intervals, durations, severity words, harmless one-liners.

Only this file and `facts` decide digits and words, so that terminal, markdown, HTML and alt texts agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..record.swing import band, touched_bands

Pieces = Sequence[tuple[float, float]] | None
NOTHING = "-"

# Pieces of an interval that are said one by one.
_MOST_PIECES = 2
# Most decimals of a number of 1 or more, however narrow its interval; no positioner resolves 0.001 %. Unit: digits.
_MOST_DECIMALS = 3
# Longest foreign text (tag, unit, file name) shown in full. Unit: characters; a line of an 80 column terminal.
LONGEST_NAME = 60
# Longest foreign sentence shown in full. Unit: characters; about ten lines.
LONGEST_SENTENCE = 800
DIRECTION_MARKS = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


def clean(text: object, limit: int = LONGEST_SENTENCE) -> str:
    """Foreign text on one line: control characters and direction marks as escapes, the middle of long ones cut."""
    shown = "".join(_harmless(c) for c in str(text)[: 2 * limit + 10_000])
    if len(shown) <= limit:
        return shown
    head = (limit - 1) * 2 // 3
    return f"{shown[:head]}…{shown[-(limit - 1 - head):]}"


def name(text: object) -> str:
    """A tag, unit or file name as `clean` writes it, at most LONGEST_NAME characters."""
    return clean(text, LONGEST_NAME)


def _harmless(c: str) -> str:
    if c in "\u00a0\u202f\u2009":
        return " "
    if c.isprintable() and c not in DIRECTION_MARKS:
        return c
    return c.encode("unicode_escape").decode()


def number(value: float | None, digits: int = 3) -> str:
    """A number with `digits` significant digits; scientific only for very large and very small ones."""
    if value is None or not math.isfinite(value):
        return NOTHING
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if size >= 7 or size < -4:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(digits - 1 - size, 0)}f}"


def times(error: float | None, noise: float | None) -> str:
    """An error in times the irreducible noise."""
    return number(error / noise) if error is not None and noise else NOTHING


def count(value: int | None) -> str:
    """A whole number with thousands separated by commas."""
    return NOTHING if value is None else f"{value:,}"


def with_unit(value: float | None, unit: str, digits: int = 3) -> str:
    """A number and its unit, the unit made harmless."""
    shown = number(value, digits)
    return shown if shown == NOTHING or not unit else f"{shown} {name(unit)}"


def decimals_for(interval: tuple[float, float] | None, value: float) -> int:
    """Decimals so that half the interval keeps two significant digits (three digits of the value without one)."""
    width = abs(interval[1] - interval[0]) / 2 if interval else 0.0
    if not math.isfinite(width) or width <= 0:
        return max(0, 2 - math.floor(math.log10(abs(value)))) if value else 2
    most = _MOST_DECIMALS
    if value:
        most = max(most, 2 - math.floor(math.log10(abs(value))))
    return min(max(0, 1 - math.floor(math.log10(width))), most)


def apart(value: float, interval: tuple[float, float] | None, pieces: Pieces = None) -> tuple[str, str]:
    """`1.80` and `1.52 to 2.21` (or a dash), digits chosen by the interval so that its ends differ where they can.

    An interval with a gap is said in pieces: `1.52 to 1.61, or 2.10 to 2.21`. The narrowest then chooses the digits.
    One with more gaps is said as a whole.
    """
    if pieces and len(pieces) <= _MOST_PIECES and interval is not None:
        least = min(pieces, key=lambda piece: piece[1] - piece[0])
        return apart(value, least)[0], ", or ".join(apart(value, piece)[1] for piece in pieces)
    if interval is None or not math.isfinite(interval[1] - interval[0]):
        return number(value, 4), NOTHING
    largest = max(abs(value), abs(interval[0]), abs(interval[1]))
    if largest >= 1e7 or largest < 1e-3:
        return number(value, 4), f"{number(interval[0], 4)} to {number(interval[1], 4)}"
    places = decimals_for(interval, value)
    return f"{value:.{places}f}", f"{interval[0]:.{places}f} to {interval[1]:.{places}f}"


def estimate(value: float, interval: tuple[float, float] | None, unit: str, pieces: Pieces = None) -> str:
    """`1.80 % (1.52 to 2.21)`: a value with its interval, digits chosen by the interval."""
    shown, ends = apart(value, interval, pieces)
    shown += f" {name(unit)}" if unit else ""
    return shown if ends == NOTHING else f"{shown} ({ends})"


def jump(value: float, interval: tuple[float, float] | None, unit: str, pieces: Pieces = None, *, known: bool) -> str:
    """J as `estimate` words it; its range alone where it is not `known`."""
    shown, ends = jump_apart(value, interval, pieces, known=known)
    if known:
        return estimate(value, interval, unit, pieces)
    return f"{ends} {name(unit)}".rstrip() if ends != NOTHING else shown


def jump_apart(value: float, interval: tuple[float, float] | None, pieces: Pieces = None, *,
               known: bool) -> tuple[str, str]:
    """J as `apart` words it; "unknown" in place of a value that is not `known`."""
    shown, ends = apart(value, interval, pieces)
    return shown if known else "unknown", ends


def listed(words: list[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def percent(value: float | None, digits: int = 2) -> str:
    """A share already in per cent."""
    return NOTHING if value is None else f"{number(value, digits)} %"


def duration(seconds: float | None) -> str:
    """Seconds, with minutes, hours or days added where those read better."""
    if seconds is None or not math.isfinite(seconds):
        return NOTHING
    plain = f"{number(seconds)} s"
    for size, unit in ((172_800, "days"), (7_200, "h"), (120, "min")):
        if seconds >= size:
            return f"{plain} ({number(seconds / {'days': 86400, 'h': 3600, 'min': 60}[unit])} {unit})"
    return plain


def severity_sentence(stickband: float, interval: tuple[float, float] | None) -> str:
    """`moderate, could be significant`: judged by the interval, not by the number alone."""
    word = band(stickband)
    if interval is None:
        return f"{word}, though without an interval the band may be wrong"
    others = [other for other in touched_bands(stickband, interval) if other != word]
    return word + (", could be " + " or ".join(others) if others else "")


def sentence(text: str) -> str:
    """Text that ends in a full stop and starts with a capital."""
    text = clean(text).strip()
    if not text:
        return ""
    return text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")
