"""Whether what a model leaves is noise alone, once it is completed with a noise model.

An autoregression can imitate much one step ahead, so its innovations must be as small as a free linear model's and look
like noise all along. Source: METHODS.md section 4, trap 2; CRITICISM.md section 7.
"""

from __future__ import annotations

import numpy as np

from ..fit.context import ADEQUATE, Run
from ..fit.fit import Fitted
from ..fit.noise.prewhitening import Whitened, whitened

# Innovations have no kurtosis beyond this (3 if normal), and no stretch of so many is louder by more than this.
_HEAVY, _UNEVEN, _STRETCHES = 4.5, 2.0, 10
# A noise of its own has no root beyond this: slower, it is a disturbance. Unit: 1.
SLOWEST_ROOT = 0.97


def only_noise(run: Run, fit: Fitted) -> Whitened | None:
    """The fit completed with its noise, where nothing but noise is left; None elsewhere."""
    last = whitened(fit.model, fit.values)
    floor = run.floor(fit.best.position_means, fit.best.values["dead_time_s"])
    return None if floor is None or last.innovation_sd > ADEQUATE * floor or not even(last) else last


def own_noise(run: Run, fit: Fitted) -> Whitened | None:
    """The same where that noise is an autoregression too fast for a drift or a disturbance; None elsewhere."""
    last = only_noise(run, fit)
    return None if last is None or slowest(last) > SLOWEST_ROOT else last


def even(noise: Whitened, slack: float = 1.0) -> bool:
    """Whether innovations look like noise all along: no heavy tails, no stretch much louder than another.

    `slack` widens both limits: before the model was fitted with the noise its slips, too, are in the innovations.

    What physics leaves unexplained sits in places (at a travel limit, after a step, at the slips): a kurtosis of 9.6
    and a ratio of 12 were met where a travel limit was missing, 3.2 and 1.6 at most in simulated coloured noise.
    """
    x = noise.innovation[noise.good]
    loud = [float(np.mean(part**2)) ** 0.5 for part in np.array_split(x, _STRETCHES)]
    tails = float(np.mean(x**4)) / max(float(np.mean(x**2)) ** 2, 1e-300)
    return tails <= slack * _HEAVY and max(loud) <= slack * _UNEVEN * min(loud)


def slowest(noise: Whitened) -> float:
    """The largest root of a noise model, by modulus."""
    return float(np.abs(np.roots(np.concatenate([[1.0], noise.model.spec.taps]))).max()) if noise.order else 0.0
