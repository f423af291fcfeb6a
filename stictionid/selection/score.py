"""Score of a node: the model completed with the noise family, and the BIC of its innovations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..effects import parse
from ..fit.cross_validation import Held
from ..fit.noise.completion import RESONANT, Refit, better, complete, quick
from ..model.model import Model
from ..model.segments import bound
from ..model.spec import FIRST_ORDER, SOFT
from ..typing import FloatArray
from .policy import Policy

WALK, COLOURED, NARROW = "random-walk-disturbance", "coloured-noise", "narrow-band-disturbance"


@dataclass(frozen=True, slots=True)
class Scored:
    """A node's best point: the model completed with its noise, held-out errors, and whether it was fitted in full."""

    done: Refit
    full: bool
    held: Held | None = None

    @property
    def rmse(self) -> float:
        """Free-run error in the unit of y."""
        return self.done.evaluated.rmse

    @property
    def free_run_at_noise(self) -> bool:
        """True where the noise model carries next to nothing."""
        return not self.done.taps.size and not self.done.increments


def glanced(model: Model, values: FloatArray, policy: Policy) -> Refit:
    """The model as it is, completed with the best noise of the family, not refitted to it."""
    found = quick(model, values)
    walk = _as_walk(model, found)
    if walk is None:
        return found
    softened = quick(*walk)
    return softened if softened.gain_over(found) > policy.walk_margin else found


def completed(model: Model, values: FloatArray, rng: np.random.Generator, policy: Policy) -> Refit:
    """The model refitted with the best noise of the family: an autoregression in levels, or one of softened differences.

    A walk must lead by its margin, because estimates of it pile up at the edge of the range.
    """
    found = complete(model, values, None, rng)
    walk = _as_walk(found.model, found)
    if walk is None or quick(*walk).gain_over(found) <= policy.walk_margin:
        return found
    softened = complete(*walk, None, rng)
    return softened if softened.gain_over(found) > policy.walk_margin else found


def _as_walk(model: Model, found: Refit) -> tuple[Model, FloatArray] | None:
    """A first-order model in softened differences; None where it is one already, or integrates."""
    spec = model.spec
    if spec.process != FIRST_ORDER or spec.increments:
        return None
    soft = bound(model.loop, replace(spec, increments=True, taps=SOFT), s_max=model.s_max, period_s=model.period_s,
                 residual=found.evaluated.left)
    return soft, found.values


def noise_name(done: Refit, policy: Policy, rng: np.random.Generator) -> str:
    """The name of the noise model of a completed fit; empty for white noise, or for less than the margin.

    A resonance of more than one cycle is a narrow band where it does better than the autoregression.
    """
    if done.increments and done.model.spec.process == FIRST_ORDER:
        return WALK
    if not done.taps.size:
        return ""
    bare = replace(done.model.spec, taps=SOFT if done.increments else (), increments=done.increments)
    model = bound(done.model.loop, bare, s_max=done.model.s_max, period_s=done.model.period_s,
                  residual=done.evaluated.left)
    if done.gain_over(quick(model, done.values, order=0)) < policy.noise_margin:
        return ""
    band = quick(model, done.values, noise=RESONANT, rng=rng)
    return NARROW if band.gain_over(quick(model, done.values)) > 0.0 else COLOURED


def best_of(*refits: Refit) -> Refit:
    """The refit with the best BIC on common samples."""
    found = refits[0]
    for other in refits[1:]:
        found = better(found, other)
    return found


def is_noise(name: str) -> bool:
    """True for the name of a noise model."""
    return parse(name)[0].noise is not None
