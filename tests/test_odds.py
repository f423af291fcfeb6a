"""Posterior odds of friction: their scatter between blocks, the cost of free numbers, and the share that S has left."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from scipy.stats import t

from stictionid.verdict.odds import BLOCKS, PRIOR, FrictionGain, quantiles


def gain_of(*blocks: float) -> FrictionGain:
    """Friction that gains these numbers in the blocks of 1,000 samples, with free S, J and initial force."""
    return FrictionGain(np.array(blocks), 3, 1000)


def test_the_quantiles_are_those_of_a_mean_of_five_blocks() -> None:
    found = quantiles()
    share = (np.arange(found.size) + 0.5) / found.size
    assert found == pytest.approx(t.ppf(share, BLOCKS - 1), rel=1e-9)


@pytest.mark.parametrize("blocks", [(9.0, 7.0, 12.0, 6.0, 8.0), (60.0, 1.0, 2.0, -3.0, 1.0),
                                    (1.0, -2.0, 0.5, 3.0, 1.0)])
@pytest.mark.parametrize("left", [None, 0.1])
def test_the_odds_are_a_mean_over_what_the_ratio_may_be(blocks: tuple[float, ...], left: float | None) -> None:
    wanted = naive.probability_of_sticking(blocks, 3, 1000, PRIOR, left)
    assert gain_of(*blocks).probability(left) == pytest.approx(wanted, abs=2e-3)


def test_blocks_that_agree_say_more_than_one_block_that_holds_the_whole_ratio() -> None:
    agree, one = gain_of(20.0, 20.0, 20.0, 20.0, 20.0), gain_of(100.0, 0.0, 0.0, 0.0, 0.0)
    assert agree.ratio == one.ratio
    assert agree.probability() > 0.999 and 0.6 < one.probability() < 0.9


def test_friction_that_gains_less_than_its_numbers_cost_is_less_likely_than_before_the_record() -> None:
    assert gain_of(4.0, 4.0, 4.0, 4.0, 4.0).probability() < PRIOR < gain_of(5.0, 5.0, 5.0, 5.0, 5.0).probability()


def test_an_S_that_is_nearly_excluded_counts_for_less() -> None:
    gain = gain_of(3.0, 3.0, 3.0, 3.0, 3.0)
    assert gain.probability(0.01) < gain.probability(0.1) < gain.probability(1.0)
