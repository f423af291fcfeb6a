"""Measured disturbance: another tag of the export drives the process value, through a lag and a dead time.

Lag and dead time are searched, the gain is linear. The tag is part of the effect's name in a study
("measured-disturbance:TAG"); `simulate` writes the disturbance as column D1. Of many tags only those enter the search
that the residual follows best, at any lag. The best of M tags and lags gains 2 ln M by chance, so that the margin
grows by as much. A tag between this valve and PV, such as its own flow, drives PV as well.

Equation: D(s) = gain e^{-dead_time_s s}/(lag_s s + 1) tag(s). Source: docs/details.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..numerics.spectrum import lagged_gains, whiten_signals
from ..process.linear import Dynamics, free_run
from ..typing import FloatArray
from .contract import Context, Disturbance, Effect, Place, Scales, Values

_LAG = Parameter("lag_s", "s", 1e-3, 1e7, 1.0, "lag from the tag to y", log=True)
_DEAD = Parameter("dead_time_s", "s", 0.0, 1e7, 0.0, "dead time from the tag to y")
_GAIN = Parameter("gain", "unit of y / unit of tag", -1e9, 1e9, 0.0, "static gain from the tag to y")
# Lags of first looks, and the longest lag and dead time. Unit: periods of the loop.
_LAGS, _LONGEST = np.array([0.02, 0.1, 0.4, 1.0]), 2.0
# Least and largest of the longest dead time, as shares of the record.
_LEAST, _MOST = 0.1, 0.25


def _limits(context: Context) -> tuple[Parameter, ...]:
    return (replace(_LAG, low=0.02 * context.step_s, high=_LONGEST * context.period_s),
            replace(_DEAD, high=_longest(context) * context.step_s))


def _longest(context: Context) -> int:
    """Longest dead time in samples."""
    rows = context.process_value.size
    samples = min(max(_LONGEST * context.period_s / context.step_s, _LEAST * rows), _MOST * rows)
    return max(int(samples), 5)


def _picked_from(context: Context) -> float:
    """Number of tags times dead times."""
    return float(max(len(context.extras), 1) * (_longest(context) + 1))


def _gains(context: Context) -> FloatArray:
    """Gain in 2 log L on the residual for each of the first lags and each dead time in samples, (k, m)."""
    tag = next(iter(context.extras.values()))
    residual = np.zeros(tag.size) if context.residual is None else context.residual
    white, others = whiten_signals(residual, tag[:, None])
    return lagged_gains(white, others[:, 0], _LAGS * context.period_s / context.step_s, _longest(context))


def _shown(context: Context) -> float:
    return float(_gains(context).max())


def _columns(theta: FloatArray, context: Context) -> tuple[FloatArray, ...]:
    tag = next(iter(context.extras.values()))
    good = np.isfinite(tag)
    # A segment may lack the tag throughout.
    tag = np.where(good, tag, tag[good].mean() if good.any() else 0.0)
    dynamics = Dynamics(theta[0], theta[1], np.zeros_like(theta[0]), False)
    return (free_run(tag[:, None], dynamics, step_s=context.step_s),)


def _guess(context: Context) -> FloatArray:
    """A grid, and the best dead time of the residual beside each of the first lags."""
    lags, deads = np.meshgrid(_LAGS[:3], [0.0, 0.1, 0.3])
    grid = context.period_s * np.stack([lags.ravel(), deads.ravel()], axis=1)
    best = np.stack([_LAGS * context.period_s, _gains(context).argmax(axis=1) * context.step_s], axis=1)
    return np.concatenate([grid, best])


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    """Feed that steps at random times (a random telegraph), written as tag D1."""
    step = float(time_s[1] - time_s[0])
    moves = rng.random(time_s.size) < step / max(20.0 * values["lag_s"], 60.0 * step)
    tag = np.cumsum(np.where(moves, rng.standard_normal(time_s.size), 0.0))
    dynamics = Dynamics(np.array([values["lag_s"]]), np.array([values["dead_time_s"]]), np.zeros(1), False)
    wave = values["gain"] * free_run(tag[:, None], dynamics, step_s=step)[:, 0]
    return wave, np.zeros_like(wave), {"D1": tag}


def _visible(scales: Scales) -> Values:
    return {"lag_s": 0.5 * scales.lag_s, "dead_time_s": 0.2 * scales.lag_s, "gain": 0.1 * scales.swing}


EFFECT = Effect(
    name="measured-disturbance", kind="L", place=Place.DISTURBANCE,
    summary="another tag of the export drives the process value",
    equation="gain e^{-dead_time_s s}/(lag_s s + 1) applied to the tag", source="docs/details.md, section 5",
    parameters=(_LAG, _DEAD, _GAIN), searched=("lag_s", "dead_time_s"), needs=("extra",), limits=_limits,
    columns=_columns, guess=_guess, shown=_shown, picked_from=_picked_from, disturb=_disturb,
    visible=_visible,
    noun="{tag}",
    sentence="{tag} drives this loop, {dead_time_s+lag_s} ahead: a dead time of {dead_time_s}, a lag of {lag_s} and a "
             "gain of {gain} from the tag to PV.",
    brief="{tag} drives this loop, {dead_time_s+lag_s} ahead",
    seen_over="time",
    action="Feed the tag forward to the controller, or calm its source.",
    settled_by="a deliberate move of that tag",
)
