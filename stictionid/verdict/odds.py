"""Odds that a valve sticks against one that follows, from the likelihoods that a verdict compares.

On either side the best model stands for all bases and noises that were tried: the sum of their likelihoods is at most
their number times that of the best one. Bayes' rule gives the odds, with Schwarz's approximation for the free numbers
of friction. The likelihood takes the noise for independent from sample to sample, which no real noise is. So the ratio
is known only as well as the blocks of the record agree about it, and the odds are a mean over what it may be. Wrong
where something else makes slips in every block, as a neighbour's cycle does. Source: docs/details.md, section 9;
Schwarz 1978.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..fit.friction_free import gains_of_friction, numbers_of_friction
from ..fit.noise.prewhitening import Whitened
from ..typing import FloatArray

BLOCKS = 5
"""Blocks of a record that are compared apart."""
PRIOR = 1.0 / 3.0
"""Share of oscillating loops whose valve sticks, before their record is seen; the seed paper says nearly 30 %."""
# Quantiles that the mean over the ratio is taken from.
_QUANTILES = 1000


@dataclass(frozen=True, slots=True)
class FrictionGain:
    """Likelihood ratio of friction by block (BLOCKS,) in 2 log L, with its free numbers and the samples compared."""

    blocks: FloatArray
    numbers: int
    samples: int

    @property
    def ratio(self) -> float:
        """Likelihood ratio of the whole record, 2 log L."""
        return float(self.blocks.sum())

    def probability(self, S_left: float | None = None) -> float:
        """The posterior probability that the valve sticks.

        Each free number costs ln(samples). `S_left` is the share of the output's swing that S is not excluded from; the
        cost of S is then that of this share.
        """
        cost = (self.numbers - (S_left is not None)) * np.log(self.samples)
        cost -= 0.0 if S_left is None else 2.0 * np.log(S_left)
        scatter = float(np.std(self.blocks, ddof=1)) * np.sqrt(self.blocks.size)
        log_odds = np.log(PRIOR / (1.0 - PRIOR)) + 0.5 * (self.ratio - cost + scatter * quantiles())
        return float(np.mean(1.0 / (1.0 + np.exp(-np.clip(log_odds, -700.0, 700.0)))))


def friction_gain(sticking: Whitened, free: Whitened) -> FrictionGain:
    """The likelihood ratio of a model with friction against one without, on the samples that both predict."""
    gains = gains_of_friction(sticking, free)
    return FrictionGain(np.array([part.sum() for part in np.array_split(gains, BLOCKS)]),
                        numbers_of_friction(sticking.model), gains.size)


def quantiles() -> FloatArray:
    """Quantiles (_QUANTILES,) of Student's distribution with the four degrees of freedom that five blocks leave a mean.

    Four degrees have a closed form. Source: Shaw 2006.
    """
    share = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    spread = np.sqrt(4.0 * share * (1.0 - share))
    return np.sign(share - 0.5) * 2.0 * np.sqrt(np.cos(np.arccos(spread) / 3.0) / spread - 1.0)
