"""Errors of landing along the path of a model: their expected part, and the filter that takes the rest out of PV.

Every slip tells of the errors at both of its ends. With e the error of the command at the slip and w that of the stem
before it, the force at which the record sees it break away lies w - e beside f_s, and the stem lands with the error e.

Source: docs/details.md, section 14.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..laws.contract import LOWER, UPPER
from ..numerics.noise.landing import LandingFilter, expected
from ..process.state_space import Held, held_chain
from ..typing import BoolArray, FloatArray
from .replay import AlongPath
from .response import Response


def chain_of(model: Response, values: FloatArray) -> Held:
    """The process of one candidate (d, 1) from one command to the next, without what changes along the record."""
    plain = replace(model.dynamics(values), closing=None, dead_time_drift=None)
    return held_chain(plain.time_constant_s, plain.dead_time_s, plain.second_time_constant_s, plain.elements,
                      plain.integrating, part_s=model.step_s / model.grid[1], ahead=not model.spec.held)


def landing_of(model: Response, counted: BoolArray) -> tuple[LandingFilter, AlongPath] | None:
    """The filter of a model along slips whose stem lands with an error, and its law with the expected part of that.

    Samples that are not `counted` (n,) tell nothing of the stem. None where it lands exactly, and for softened
    differences, which hide it, and for a path that these values do not take.
    """
    paths, law = model.spec.paths, model.law
    if paths is None or paths.landing is None or not isinstance(law, AlongPath) or model.spec.increments:
        return None
    values = model.vector(dict(paths.landing.values))[:, None]
    friction = model.friction(values)
    found = law.strokes(model.context.command, friction, model.profile, values[2])
    position, slips, error = found.position[:, 0], law.path, paths.error**2
    errors = paths.scan_errors(*model.grid)
    # A stem that rests keeps its error, one that slides has that of the command, and one at a stop has none.
    moved = np.diff(position, prepend=position[0]) != 0.0
    stopped = (position >= friction[UPPER, 0]) | (position <= friction[LOWER, 0])
    carried, drawn = 1.0 - moved, np.where(moved & ~stopped, error if errors is None else errors.command, 0.0)
    force = np.zeros(position.size)
    ways = slips.kind[np.abs(slips.kind) == 1]
    at = slips.at[np.abs(slips.kind) == 1]
    share, alone, mean = found.forces.landings(paths)
    if np.isnan(share).any():
        return None  # (this valve does not take the path, so that nothing is known of where it landed)
    carried[at], force[at] = np.where(stopped[at], 0.0, share), ways * mean
    drawn[at] = np.where(drawn[at] > 0.0, alone, 0.0)
    early = np.zeros(position.size)
    early[at] = paths.jitter**2
    early += np.where(moved, model.late_moves**2, 0.0)
    early *= (paths.landing.ratio / paths.error * np.diff(position, prepend=position[0]))**2
    chain = chain_of(model, values)
    kalman = LandingFilter(chain.keep, chain.take, chain.row, chain.through, chain.late,
                           parts=model.grid[1], carried=carried,
                           drawn=drawn * (paths.landing.ratio**2 / error), early=early, good=counted)
    return kalman, law.landing(expected(carried, force))
