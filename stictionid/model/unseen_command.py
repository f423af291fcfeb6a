"""Uncertainty of a command between the samples of a record, where it shows in the slips of a valve."""

from __future__ import annotations

import numpy as np

from .model import Model
from .spec import Evaluated

# Longest scan of a usual DCS in seconds. Second: error of a rebuilt command at slips, as a share of its move from
# sample to sample (benchmarks/verdicts.py, seeds below 1000).
_SLOWEST_SCAN_S, _REBUILT = 2.0, 0.35


def between_samples(model: Model, best: Evaluated) -> float:
    """Uncertainty of S and J in % from slips between two samples, where the command is not known.

    A record as fast as the scans of a DCS knows its command. A slower one knows the command at a slip to within its
    move from one sample to the next. A command rebuilt between samples (or at the scans there) is known to a share of
    that move.
    """
    share = _REBUILT if model.spec.between != "hold" else 1.0 if model.step_s > _SLOWEST_SCAN_S else 0.0
    moves = []
    for position, output in zip(model.split(best.stem), model.split(model.loop.output), strict=True):
        moved = np.abs(np.diff(position)) > 1e-9
        moves.append(np.abs(np.diff(output))[np.flatnonzero(moved[1:] & ~moved[:-1]) + 1])
    slips = np.concatenate(moves)
    return share * float(np.median(slips)) if slips.size and share else 0.0
