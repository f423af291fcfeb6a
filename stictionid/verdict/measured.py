"""Numbers by which a model with friction differs from the best one without: likelihood ratio and falls of the errors.

Both models are completed with noise and have the same samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..fit.context import Run
from ..fit.cross_validation import held_out_of
from ..fit.noise.prewhitening import Whitened
from .odds import BLOCKS, FrictionGain, friction_gain

# Ratio of two errors on a held-out block at most: a model that errs more often extrapolates there. Unit: 1.
MOST_TIMES = 1e3


@dataclass(frozen=True, slots=True)
class Measured:
    """Likelihood ratio, blocks won, share of the variance of y explained, and falls of both errors.

    Ratio and blocks use the one-step errors on common samples. `drop` and `one_step` are shares of the free-run and
    one-step errors.
    """

    gain: FrictionGain
    won: int
    explained: float
    drop: float
    one_step: float


@dataclass(frozen=True, slots=True)
class Gain:
    """Share by which friction lowers the one-step error of the middle held-out block, and the number of blocks won."""

    share: float
    won: int
    blocks: int


def measure(run: Run, sticking: Whitened, free: Whitened) -> Measured:
    """Measure the friction of a model against one without it."""
    good = sticking.good & free.good
    a, b = sticking.innovation[good], free.innovation[good]
    won = sum(float(b[p] @ b[p]) > float(a[p] @ a[p]) for p in np.array_split(np.arange(a.size), BLOCKS))
    variance = float(np.var(run.used_y()))
    # The free-run error of the friction-free model counts as no more than the scatter of y, which a constant leaves.
    rmse = min(free.rmse, float(np.sqrt(variance)))
    # What unknown moves of OP make of the landings is no error of the friction.
    unknown = (sticking.model.spread**2 - 1.0) * sticking.innovation_sd**2
    left = float(np.sqrt(max(sticking.rmse**2 - unknown, min(sticking.rmse, sticking.innovation_sd)**2)))
    explained = (rmse**2 - left**2) / variance if variance else 0.0
    drop = 1.0 - left / rmse if rmse else 0.0
    one_step = 1.0 - float(np.sqrt((a @ a) / max(float(b @ b), 1e-300)))
    return Measured(friction_gain(sticking, free), won, explained, drop, one_step)


def held_out_gain(sticking: Whitened, free: Whitened) -> Gain | None:
    """The gain on blocks held out of both models alike; None where the record is too short to hold any out."""
    a, b = (held_out_of(w.model, w.values, w.evaluated) for w in (sticking, free))
    if a is None or b is None or not b.rmse_one_step > 0.0:
        return None
    # The middle block: one bad block would ruin the mean (docs/details.md, section 11).
    ratio = np.minimum(a.blocks / np.maximum(b.blocks, 1e-300), MOST_TIMES)
    return Gain(1.0 - float(np.median(ratio)), int((ratio < 1.0).sum()), ratio.size)
