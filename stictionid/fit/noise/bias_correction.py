"""Noise model of a fit's residual, corrected for the noise that the fitted parameters followed (REML).

A residual is the noise less the part that the fitted parameters followed, and they follow slow noise best. An
autoregression of the residual therefore has its root too near to 0 (0.788 for 0.8, with eight parameters and 1200
samples). In the worst tenth of records this makes a third at low frequencies, and intervals that trust it are too
narrow by that third. In a prewhitened least-squares fit the residual's covariance is that of the noise less X C X'. X
are the slopes of the model, C is the covariance of its parameters. Restricted maximum likelihood makes the same
correction.

Source: Patterson and Thompson 1971; Harville 1977.
"""

from __future__ import annotations

import numpy as np

from ...model.model import Model
from ...model.spec import Evaluated
from ...numerics.autoregression import autocovariance, autoregression, filter_residual
from ...numerics.gauss_newton import quotients, sides, trial_points
from ...typing import FloatArray

# Step of the differences for the slopes, as a share of the range; share of the largest slope below which one is
# ignored.
_DIFFERENCE, _NOTHING = 1e-3, 1e-8
# Largest correction, as a share of the residual's variance; a root of 0.8 in 1200 samples needs a twentieth.
_MOST = 0.25


def noise_of(model: Model, evaluated: Evaluated, polynomial: FloatArray, largest: int) -> FloatArray:
    """Taps of the noise under a fit's residual, of an order 0..largest: none by BIC, or a length that AIC chooses.

    `polynomial` is the prewhitening applied before the noise is estimated (differences), the leading 1 included.
    """
    starts, counted = model.loop.starts, evaluated.counted > 0
    signal, good = filter_residual(evaluated.residual, counted, polynomial, starts)
    first = autoregression(signal, good, largest, starts, long=True)
    if not first.size:
        return first
    columns = np.stack([filter_residual(x, counted, polynomial, starts)[0] for x in slopes_of(model, evaluated).T],
                       axis=1)
    whole = np.concatenate([[1.0], first])
    innovation, rows = filter_residual(signal, good, whole, starts)
    white = np.stack([filter_residual(x, good, whole, starts)[0] for x in columns.T], axis=1)[rows]
    size = np.linalg.norm(white, axis=0)
    used = size > _NOTHING * size.max(initial=0.0)
    if not used.any():
        return first  # (a stem between two stops passes nothing on, so that the fit followed no noise)
    _, values, axes = np.linalg.svd(white[:, used] / size[used], full_matrices=False)
    axes = axes[values > _NOTHING * values[0]] / values[values > _NOTHING * values[0], None]
    sd = float(np.sqrt(np.sum(innovation[rows]**2) / max(int(rows.sum()) - len(axes), 1)))
    # The noise that each determined direction follows, one standard deviation of it.
    taken = sd * (columns[:, used] / size[used]) @ axes.T
    missing = np.sum([autocovariance(x, good, largest, starts) for x in taken.T], axis=0)
    # A residual that is mostly misfit says nothing of the noise that a fit followed.
    if missing[0] > _MOST * np.mean(signal[good]**2):
        return first
    return autoregression(signal, good, largest, starts, missing, long=True)


def slopes_of(model: Model, evaluated: Evaluated) -> FloatArray:
    """Slopes (n, c) of a model's y in its smooth parameters, those that stay linear among them."""
    values = model.vector(evaluated.values)
    free = np.flatnonzero(model.space.movable)
    free = free[~np.isin(free, (0, *model.forces))]
    point, step = model.cube(values[:, None]), np.full((1, free.size), _DIFFERENCE)
    trial = trial_points(point, free, step)[0]
    base, offsets = model.responses(model.values(trial), filtered=False)
    own = model.own_columns(base, offsets)
    # A second lag of 0 has no transient, but has one beside 0: it stands last.
    sizes = np.concatenate([evaluated.own, np.zeros(len(own) - evaluated.own.size)])
    y = np.einsum("k,knp->np", sizes, own)
    given = int("gain" in model.spec.fixed)
    slopes = quotients(y, *(w[0] for w in sides(y[:, None], point[:, free], step)))
    return np.concatenate([slopes, own[given:, :, 0].T, model.shared_columns()], axis=1)
