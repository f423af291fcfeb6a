"""Masks of the valve's phases (stick, slip, slide) and directions, and their delay to the process value."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..typing import BoolArray, FloatArray
from .model_run import Ground

# A slip shows in y for one time constant after the dead time, at most this share of a period.
_LONGEST_SLIP = 0.1
# The position has moved when it changed by more than this share of S.
_REST = 1e-6


def delayed(ground: Ground, mask: BoolArray) -> BoolArray:
    """A mask of the valve (n,) as y shows it, one dead time later."""
    return _later(mask, round(ground.evaluated.values["dead_time_s"] / ground.step_s) + 1, ground.loop.segments)


def _later(mask: BoolArray, samples: int, segments: Sequence[slice]) -> BoolArray:
    out = np.zeros_like(mask)
    for part in segments:
        if samples < part.stop - part.start:
            out[part.start + samples:part.stop] = mask[part.start:part.stop - samples]
    return out


def valve_phases(ground: Ground) -> dict[str, BoolArray]:
    """Masks (n,) "stick", "slip" and "slide", at the valve."""
    change = _changes(ground)
    moves = change != 0.0
    before = np.concatenate([[False], moves[:-1]])
    start = moves & ~before
    lag = ground.evaluated.values["time_constant_s"]
    length = max(1, round(min(lag, _LONGEST_SLIP * ground.period_s) / ground.step_s))
    slip = np.convolve(start.astype(float), np.ones(length))[:moves.size] > 0.5
    return {"stick": ~moves & ~slip, "slip": slip, "slide": moves & ~slip}


def directions(ground: Ground) -> dict[str, BoolArray]:
    """Masks (n,) "opening" and "closing": the direction of the valve's last move."""
    sign = np.sign(_changes(ground))
    at = np.where(sign != 0, np.arange(sign.size), 0)
    np.maximum.accumulate(at, out=at)
    last = sign[at]
    return {"opening": last > 0, "closing": last < 0}


def _changes(ground: Ground) -> FloatArray:
    position = ground.evaluated.stem
    change = np.diff(position, prepend=position[0])
    change[list(ground.loop.starts)] = 0.0
    rest = _REST * max(ground.evaluated.values["S"], 1e-12)
    return np.where(np.abs(change) > rest, change, 0.0)
