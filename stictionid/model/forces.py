"""Break-away forces that the strokes of a path ask for: how likely they are, and where they leave the stem.

Source: docs/details.md, section 14.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from ..numerics.noise.normal import log_between, log_upper, moments_between
from ..typing import FloatArray
from .slips import Paths
from .unseen_scans import LANDED, OTHER_WAY, SHARE, SLIPPED, STAYED

# Rows of a stroke's margins: the largest force before the slip, the force at it, and the largest the other way; all in
# % beyond the break-away force there.
BEFORE, AT, OTHER = range(3)
# A slip is moved where it came at a chance beyond this one, either way.
_ODD = 0.05


@dataclass(frozen=True)
class Forces:
    """Margins (slips + 1, 3, P) of the strokes, the last one unfinished, and log chances (P,) of the turns.

    The force of every stick is drawn once, from N(f_s, scatter^2).
    """

    margins: FloatArray
    turns: FloatArray

    def first(self, lanes: int) -> Self:
        """The forces of the first valves."""
        return replace(self, margins=self.margins[..., :lanes], turns=self.turns[:lanes])

    def log_chance(self, scatter: float) -> FloatArray:
        """Logarithm (P,) of the chance of the forces and the turns."""
        before, at, other = self.margins[:-1, BEFORE], self.margins[:-1, AT], self.margins[:-1, OTHER]
        total = self.turns + log_between(before / scatter, np.maximum(at, before) / scatter).sum(axis=0)
        total += log_upper(other / scatter).sum(axis=0)
        last = self.margins[-1] / scatter
        return np.asarray(total + (log_upper(last[BEFORE]) + log_upper(last[OTHER])))

    def roots(self, scatter: float) -> FloatArray:
        """Rows (r, P): signed roots of what each force costs more than one in the middle of its step."""
        m = self.margins / scatter
        low, high = m[:-1, BEFORE], np.maximum(m[:-1, AT], m[:-1, BEFORE])
        half = 0.5 * np.subtract(high, low, out=np.zeros_like(high), where=high > low)
        lost = log_between(-half, half) - log_between(low, high)
        return np.concatenate([np.copysign(np.sqrt(np.maximum(2.0 * lost, 0.0)), low + high),
                               np.sqrt(-2.0 * log_upper(m[:, OTHER])), np.sqrt(-2.0 * log_upper(m[-1:, BEFORE]))])

    @property
    def moved(self) -> int:
        """Number of slips that the first valve would make at other samples if it broke away at f_s exactly.

        A stem that rests at the end, where that valve would have slipped, counts as one.
        """
        m = self.margins[:, :, 0]
        early_or_late = (m[:-1, BEFORE] > 0.0) | (m[:-1, AT] <= 0.0) | (m[:-1, OTHER] > 0.0)
        return int(early_or_late.sum()) + int(max(m[-1, BEFORE], m[-1, OTHER]) > 0.0)

    def landings(self, paths: Paths) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Share of the last landing's error in the next, its own variance in %^2, and mean force beyond f_s in %.

        All are of every slip of the first valve (slips,), and nan where it does not take the path.
        """
        m = self.margins[:-1, :, 0]
        mean, square = moments_between(m[:, BEFORE], m[:, AT], paths.scatter)
        own, error = paths.own_variance + square - mean**2, paths.error**2
        share = np.where(np.isnan(m[:, AT]), np.nan, error / (error + own))
        return share, error * (1.0 - share), mean


class ScanForces(Forces):
    """Logs of chances (slips + 1, 5, P) under a command that errs at every unseen scan by itself (`unseen_scans.py`).

    The scatter is in them already.
    """

    def log_chance(self, scatter: float) -> FloatArray:
        """Logarithm (P,) of the chance of the forces and the turns."""
        m = self.margins
        return np.asarray(self.turns + m[:-1, :SHARE].sum(axis=(0, 1)) + m[-1, STAYED] + m[-1, OTHER_WAY])

    def roots(self, scatter: float) -> FloatArray:
        """Rows (r, P): roots of what every chance costs."""
        m = self.margins
        rows = np.concatenate([m[:-1, STAYED], m[:-1, SLIPPED], m[:, OTHER_WAY], m[-1:, STAYED]])
        return np.sqrt(np.maximum(-2.0 * rows, 0.0))

    @property
    def moved(self) -> int:
        """Number of slips of the first valve that lie in the first or the last twentieth of their chances."""
        stayed, slipped = (np.exp(self.margins[:-1, row, 0]) for row in (STAYED, SLIPPED))
        return int(((stayed < _ODD) | (stayed * (1.0 - slipped) > 1.0 - _ODD)).sum())

    def landings(self, paths: Paths) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Numbers as of `Forces`; the mean force is in the position of the stem already."""
        m = self.margins[:-1, :, 0]
        return m[:, SHARE], m[:, LANDED], np.zeros(len(m))
