"""What a fit takes of the noise: autocovariances that are missing from its residual, and the noise model put right.

A residual is the noise less what the fitted numbers followed of it, and they follow slow noise best: an autoregression
of the residual has its root too near to 0 (0.788 for 0.8, with eight numbers and 1200 samples), and intervals that
trust it are too narrow by the third that this makes at low frequencies in the worst tenth of records. For a
least-squares fit in prewhitened form the residual's covariance is that of the noise less X C X', with the slopes X of
the model and the covariance C of its numbers: the same correction that restricted maximum likelihood makes.

Source: Patterson and Thompson 1971; Harville 1977.
"""

from __future__ import annotations

import numpy as np

from ...model.model import Model
from ...model.spec import Evaluated
from ...numerics.autoregression import autocovariance, autoregression, filtered
from ...numerics.gauss_newton import beside
from ...typing import FloatArray
from ..moves import movable

# Difference for the slopes, as a share of the range; and the share of the largest below which a direction says nothing.
_DIFFERENCE, _NOTHING = 1e-3, 1e-8
# The most that a fit may have taken, as a share of what is left: a twentieth at a root of 0.8 in 1200 samples. Unit: 1.
_MOST = 0.25


def noise_of(model: Model, evaluated: Evaluated, polynomial: FloatArray, largest: int) -> FloatArray:
    """Taps of the noise under a fit's residual, of an order 0..largest that BIC chooses.

    `polynomial` is the prewhitening, the leading 1 included, after which the noise is looked for (differences).
    """
    signal, good = filtered(evaluated.residual, evaluated.counted > 0, polynomial)
    starts = model.loop.starts
    first = autoregression(signal, good, largest, starts)
    if not first.size:
        return first
    columns = np.stack([filtered(x, good, polynomial)[0] for x in slopes_of(model, evaluated).T], axis=1)
    whole = np.concatenate([[1.0], first])
    innovation, rows = filtered(signal, good, whole)
    white = np.stack([filtered(x, good, whole)[0] for x in columns.T], axis=1)[rows]
    size = np.linalg.norm(white, axis=0)
    used = size > _NOTHING * size.max(initial=0.0)
    _, values, axes = np.linalg.svd(white[:, used] / size[used], full_matrices=False)
    axes = axes[values > _NOTHING * values[0]] / values[values > _NOTHING * values[0], None]
    sd = float(np.sqrt(np.sum(innovation[rows]**2) / max(int(rows.sum()) - len(axes), 1)))
    # What each direction that the data know takes of the noise, one standard deviation of it.
    taken = sd * (columns[:, used] / size[used]) @ axes.T
    missing = np.sum([autocovariance(x, good, largest, starts) for x in taken.T], axis=0)
    # A residual that is mostly what the model lacks says nothing of what a fit took of the noise.
    if missing[0] > _MOST * np.mean(signal[good]**2):
        return first
    return autoregression(signal, good, largest, starts, missing)


def slopes_of(model: Model, evaluated: Evaluated) -> FloatArray:
    """Slopes (n, c) of a model's y in its smooth numbers, those that stay linear among them."""
    values = model.vector(evaluated.values)
    free = np.flatnonzero(movable(model) > 0)
    free = free[~np.isin(free, (0, *model.forces))]
    trial, width = model.cube(values[:, None]), np.ones((1, 0))
    if free.size:
        trial, width = beside(trial, free, np.full((1, free.size), _DIFFERENCE))
    base, offsets = model.responses(model.values(trial), filtered=False)
    own = model.own_columns(base, offsets)
    # A second lag of 0 has no transient, but has one beside 0: it stands last.
    sizes = np.concatenate([evaluated.own, np.zeros(len(own) - evaluated.own.size)])
    y = np.einsum("k,knp->np", sizes, own)
    f, given = free.size, int("gain" in model.spec.fixed)
    slopes = (y[:, 1:f + 1] - y[:, f + 1:]) / width[0]
    return np.concatenate([slopes, own[given:, :, 0].T, model.shared_columns()], axis=1)
