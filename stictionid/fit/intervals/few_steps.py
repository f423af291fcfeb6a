"""Break-away forces that a few steps of OP leave open: wider intervals of S and J for a manual test.

Steps jump over every force between two of their levels, so that S and J with the same kinetic friction are alike over
a step. Start forces decide no more than the first slip. A ladder of break-away and start forces, all else held, shows
how far both reach. Source: docs/method.md, section 8.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..points.fitted import Fitted
from .assemble import INTERVAL_THRESHOLD, innovation_rows

# Rungs of the break-away force, and start forces as shares of it.
_RUNGS, _STARTS = 400, np.linspace(-0.95, 0.95, 20)


def over_break_away(fit: Fitted) -> Fitted:
    """The fit with the S and J of every break-away force that explains the steps alike."""
    model, values = fit.model, fit.values
    kinetic, most = 0.5 * (values[0] - values[1]), model.space.parameters[0].high
    forces = np.linspace(max(abs(kinetic), 1e-9), most, _RUNGS)
    S, J = forces + kinetic, forces - kinetic
    inside = (most >= S) & (model.space.parameters[1].high * S >= J)
    shares = np.concatenate([np.tile(_STARTS[:, None], (1, _RUNGS)), np.clip(
        values[model.forces[0]] * 0.5 * (values[0] + values[1]) / forces, -1.0, 1.0)[None]])[:, inside]
    trial = values[:, None].repeat(shares.size, axis=1)
    trial[0], trial[1] = np.tile(S[inside], len(shares)), np.tile(J[inside], len(shares))
    trial[list(model.forces)] = shares.ravel()
    near = model.costs_of(trial) <= fit.sse * np.exp(INTERVAL_THRESHOLD / innovation_rows(model, fit.best))
    rung, wider = float(forces[1] - forces[0]), dict(fit.intervals)
    for row, name in enumerate(("S", "J")):
        low, high = fit.intervals.get(name, (values[row], values[row]))
        reach = np.append(trial[row, near], values[row])
        wider[name] = (min(low, max(float(reach.min()) - rung, 0.0)), max(high, float(reach.max()) + rung))
    return replace(fit, intervals=wider)
