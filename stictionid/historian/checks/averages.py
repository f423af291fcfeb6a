"""Test of signals for averages over the interval instead of snapshots.

Names, digits and setpoints between two levels show averages. So does the noise that a PI law leaves. The means of r, y
and u follow the law of the controller, as snapshots do. The noise within an interval moves the mean of u late in that
interval and early in the next one: what the law leaves are differences of white noise, with a correlation of -0.5 from
one row to the next. What unseen noise leaves between snapshots is not correlated, or positively. Wrong for a controller
with a derivative or a filter: its law fits too badly to be judged. Source: docs/traps.md, export trap 14.
"""

from __future__ import annotations

import numpy as np

from ...numerics.archived import resolution_of
from ...record.loop import Finding
from ...record.oscillation import noise_of
from ...typing import FloatArray
from ..words.cells import shown
from ..words.findings import finding
from .texture import Signals

MIN_AVERAGE_STEP_S = 10.0
"""Sampling step from which averages instead of snapshots are looked for, seconds."""
SHORT_DIGITS = 9
"""Significant digits that single-precision snapshots are written with."""
LONG_DIGITS = 13
"""Digits beyond which a number was computed (a mean of snapshots has about 16), not recorded."""
SCANS_S = (1.0, 2.0, 5.0, 10.0, 0.5, 0.25, 0.2, 0.1)
"""Distances of the snapshots in a mean that are tried, seconds, the usual one first."""
SUM_DIGITS, MIN_SUM_SHARE, MIN_LONG_SHARE = 12, 0.9, 0.5
"""Digits of a sum of snapshots, share of the values that are such sums, and share of them that are long themselves."""
MIN_SHORT_SHARE = 0.01
"""Share of short numbers needed beside long ones: simulated data are long throughout."""
MOST_MOVES = 0.2
"""Share of samples at which a setpoint that steps now and then changes, at most."""
MIN_LAW_ROWS, MIN_LAW_FIT, MIN_SLOW = 150, 0.995, 0.85
"""Rows, share of the moves of OP explained, and correlation of PV from row to row, from which the law is judged."""
MOST_CORRELATED, DEVIATIONS = -0.4, 1.3
"""Correlation of what the law leaves up to which it is that of means, and the standard deviations beyond it. Measured
on 21 scanned PI loops, rows of 10 to 30 s, slow enough: snapshots -0.41 to 0.31, one at -0.45; means -0.48 to -0.68."""
LEAST_LEFT, MOST_LEFT = 0.3, 3.5
"""Size of what the law leaves, in units of what the noise within an interval makes of it: 0.4 to 3.1 in these loops.
A controller with a derivative, or without scans, leaves 4 and more."""
MIN_UNROUNDED = 2.0
"""Size of what the law leaves in units of what the rounding of PV and OP makes of it: rounding is a difference, too."""
_AVERAGE_WORDS = ("avg", "average", "mean", "moyenne", "mittel", "среднее", "平均", "hourly", "min-mean", "aggregat")


def averaged(loop: Signals, name_hints: list[str], fractions: float = 0.0) -> Finding | None:
    """Finding on averages over the interval instead of snapshots; `fractions` is the share of fractional mode codes."""
    named = next((n for n in name_hints if any(w in n.lower() for w in _AVERAGE_WORDS)), None)
    evidence: dict[str, object] = {"named": named} if named else {}
    why = f"{shown(named)} names an average" if named else ""
    if not why and fractions > 0:
        why = f"{100 * fractions:.1g} % of the mode codes are no whole numbers"
        evidence = {"fractions_share": fractions}
    if not why and loop.step_s >= MIN_AVERAGE_STEP_S:
        # A change of unit makes long digits, too, but OP is in % as the controller gave it.
        share = min(_long_digits(loop.process_value), _long_digits(loop.output))
        between = _between_levels(loop.setpoint) if loop.setpoint is not None else 0.0
        scans = _scans_in_a_mean(loop.process_value, loop.step_s)
        if scans and _scans_in_a_mean(loop.output, loop.step_s) == scans:
            why, evidence = (
                f"times {scans} PV and OP have as few digits as snapshots, by themselves they have not",
                {"snapshots": scans},
            )
        elif 0.1 < share < 0.98:
            why, evidence = (
                f"{100 * share:.0f} % of the values of PV and OP have more digits than a snapshot has",
                {"long_digits_share": share},
            )
        elif between > 0.5:
            why, evidence = (
                f"{100 * between:.0f} % of the setpoint steps pass through a value in between",
                {"between_share": between},
            )
        elif (left := _law_of_means(loop)) is not None:
            why, evidence = (
                f"the PI law of OP leaves noise that is correlated by {left:.2f} from row to row, as the noise within "
                "means is",
                {"law_leaves_correlated": left},
            )
    if not why:
        return None
    return finding("averaged", evidence, caps_verdict=loop.step_s >= 60.0, step=loop.step_s, why=why)


def _long_digits(values: FloatArray) -> float:
    """Share of values with more digits than any snapshot; 0 unless the others are as short as snapshots are."""
    known = values[np.isfinite(values) & (values != 0)][:100_000]
    if not known.size or _written_with(known, SHORT_DIGITS).mean() <= MIN_SHORT_SHARE:
        return 0.0
    return float((~_written_with(known, LONG_DIGITS)).mean())


def _scans_in_a_mean(values: FloatArray, step_s: float) -> int:
    """Number of snapshots in the means that the values are, by their digits; 0 where that does not show.

    The sum of n short numbers is short, and its n-th part is long where n has a factor other than 2 and 5.
    """
    known = values[np.isfinite(values) & (values != 0)][:100_000]
    if not known.size or _written_with(known, LONG_DIGITS).mean() > 1.0 - MIN_LONG_SHARE:
        return 0
    for scan in SCANS_S:
        scans = round(step_s / scan)
        if scans > 1 and abs(scans * scan - step_s) < 1e-6 * step_s and \
                _written_with(known * scans, SUM_DIGITS).mean() > MIN_SUM_SHARE:
            return scans
    return 0


def _written_with(values: FloatArray, digits: int) -> np.ndarray:
    """True where a value is a decimal number of at most so many significant digits."""
    scale = 10.0 ** np.clip(digits - 1 - np.floor(np.log10(np.abs(values))), -300, 300)
    scaled = values * scale
    return np.asarray(np.abs(scaled - np.rint(scaled)) <= 4 * np.finfo(float).eps * np.abs(scaled))


def _between_levels(setpoint: FloatArray) -> float:
    """Share of the setpoint's steps that take exactly two samples in one direction."""
    moves = np.flatnonzero(np.diff(setpoint) != 0)
    if moves.size < 6 or moves.size > MOST_MOVES * setpoint.size:
        return 0.0
    steps = np.diff(setpoint)[moves]
    pairs = (np.diff(moves) == 1) & (np.sign(steps[1:]) == np.sign(steps[:-1]))
    return 2.0 * float(pairs.sum()) / moves.size


def _law_of_means(loop: Signals) -> float | None:
    """Correlation of what the PI law leaves from row to row, where that is noise within means; None where it is not.

    The sum of the error between two rows is taken from straight lines less their curvature: the same for the means.
    """
    r, y, u = loop.setpoint, loop.process_value, loop.output
    if r is None or len(loop.starts) > 1 or not np.isfinite(y).all() or not np.isfinite(u).all():
        return None
    e = np.nan_to_num(r - y)
    good = np.convolve(np.diff(r, prepend=r[0]) == 0.0, np.ones(4), "valid") > 3.5
    sums = (0.5 * (e[1:-2] + e[2:-1]) - (e[3:] - e[2:-1] - e[1:-2] + e[:-3]) / 24.0)
    design = np.stack([np.diff(e)[1:-1], sums], axis=1)[good]
    change = np.diff(u)[1:-1][good]
    if good.sum() < MIN_LAW_ROWS or not float(np.var(change)) > 0.0:
        return None
    (gain, integral), *_ = np.linalg.lstsq(design, change, rcond=None)
    left = np.zeros(good.size)
    left[good] = change - design @ (gain, integral)
    size, both = float(np.std(left[good])), good[1:] & good[:-1]
    rounding = float(np.hypot(resolution_of(u), gain * resolution_of(y))) / np.sqrt(6.0)
    expected = abs(float(integral)) * noise_of(y) / np.sqrt(6.0)
    if size * size > (1.0 - MIN_LAW_FIT) * float(np.var(change)) or size < MIN_UNROUNDED * rounding \
            or not LEAST_LEFT * expected <= size <= MOST_LEFT * expected:
        return None
    if float(np.corrcoef(y[1:], y[:-1])[0, 1]) < MIN_SLOW:
        return None
    found = float(np.corrcoef(left[1:][both], left[:-1][both])[0, 1])
    return found if found < MOST_CORRELATED - DEVIATIONS / np.sqrt(both.sum()) else None
