"""Coloured noise: the output error follows an autoregression instead of being white.

It can't lower a free-run error; it lowers the one-step error. Can't be told from a random walk when a root of its
polynomial lies near 1. Source: the paper's C(q) polynomial (Eq. 4), here as AR(p); METHODS.md section 5.
"""

from .contract import Effect, Place

EFFECT = Effect(
    name="coloured-noise", kind="N", place=Place.NOISE, noise="autoregressive",
    summary="the output error is autocorrelated",
    equation="(1 + c1 q^-1 + … + cp q^-p) error(k) = white(k)",
    source="paper Eq. 4; METHODS.md section 5", confused_with=("random-walk-disturbance",),
)
