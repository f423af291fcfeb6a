"""S and J read directly from a measured valve position: the law fitted to command and position.

Gain, offset and direction of the position signal are free: it may run opposite and in any unit. It may lag the command
by a few samples. The result stands beside the blind estimate and does not enter it, as in Shang et al., Fig. 10.
"""

from __future__ import annotations

import numpy as np

from .. import laws as law_room
from ..effects.contract import Effect
from ..fit.points.fitted import Fitted
from ..laws.contract import neutral_friction
from ..model.response import S_OVER_S_MAX
from ..numerics.population import Found, refine, swarm
from ..numerics.varpro import Shared
from ..record.loop import Loop
from ..record.study import PositionEstimate
from ..typing import FloatArray

# Samples by which a recorded position may lag the command.
_LARGEST_LAG = 3
_FEWEST_SAMPLES = 20
# Three conditions for a position that shows stiction. First, the law leaves less than this share of the error of a
# position in proportion to the output. Second, S exceeds this share of the range of the output. Third, S exceeds this
# multiple of the smallest recorded change (the quantile that stands for it). A valve that moves freely may rest and
# jump in a record, too.
_LEFT, _RELEVANT, _BEYOND, _SMALLEST = 0.5, 0.1, 3.0, 0.05


def from_position(loop: Loop, *, law: str, s_max: float, rng: np.random.Generator,
                  fit: Fitted | None = None) -> PositionEstimate | None:
    """Fit the law to command and measured position (n,) of `loop`; None where the position is absent or dead.

    The friction effects of a `fit` change the law as they do in its model, so that S and J mean the same in both. A
    command that moves between samples is that of its model, too: a slip a sample late would count as wholly wrong.
    The error is in the unit of the position. Wrong where the position signal is filtered or only a demand.
    """
    z = loop.position
    if z is None:
        return None
    good = np.isfinite(z) & loop.used
    if good.sum() < _FEWEST_SAMPLES or np.ptp(z[good]) <= 1e-9 * max(np.abs(z[good]).max(), 1e-30):
        return None
    chosen = law_room.get(law)
    output = np.where(np.isfinite(loop.output), loop.output, np.nanmean(loop.output))
    command = output
    # A command that moves between samples is that of a fit to this record.
    if fit is not None and not fit.model.spec.held and fit.model.loop.samples == loop.samples:
        command = fit.model.context.command
    parts = command.size // loop.samples
    filled = np.where(good, z, 0.0)
    first = max(_LARGEST_LAG, min(loop.samples // 20, 50))
    effects, held = _on_friction(fit)
    shared = Shared.prepare(filled[first:], np.ones((loop.samples - first, 1)), good[first:])

    def values(cube: FloatArray) -> tuple[FloatArray, FloatArray]:
        S = S_OVER_S_MAX * s_max * np.maximum(cube[:, 0], 1e-4)
        return S, S if chosen.one_parameter else S * 1.5 * cube[:, 1]

    def solve(cube: FloatArray) -> tuple[FloatArray, FloatArray]:
        S, J = values(cube)
        friction = neutral_friction(S, J)
        for effect, theta in effects:
            assert effect.friction is not None
            friction = effect.friction(friction, theta[:, None].repeat(S.size, axis=1), loop.step_s, held)
        positions = np.ascontiguousarray(chosen.positions(command, friction, share=2.0 * cube[:, 2] - 1.0)[::parts])
        best, gain = np.full(S.size, np.inf), np.zeros(S.size)
        for lag in range(_LARGEST_LAG + 1):
            cost, own = shared.solve(positions, (first - lag,))
            better = cost < best
            best[better], gain[better] = cost[better], own[0][better]
        return best, gain

    found = swarm(lambda c: solve(c)[0], 3, rng, groups=2, particles=20, rounds=12, scouts=300)
    starts = found.points[:1].repeat(4, axis=0)
    starts[1:, 2] = (0.2, 0.5, 0.8)
    best = refine(lambda c: solve(c)[0], starts, rng, spread=0.02, rounds=60, settle=1e-3)
    # S has a plateau on a sampled command; J settles once S is held (as in `polish_smooth`).
    S_held, force = best.points[0, 0], best.points[0, 2]

    def along(part: FloatArray) -> FloatArray:
        return np.stack([np.full(len(part), S_held), part[:, 0], np.full(len(part), force)], axis=1)

    smooth = refine(lambda c: solve(along(c))[0], best.points[:1, 1:2], rng, spread=0.05, rounds=40, settle=1e-6)
    best = Found(along(smooth.points[:1]), smooth.costs[:1])
    cost, gain = solve(best.points[:1])
    if not np.isfinite(cost[0]):
        return None
    S, J = (float(v[0]) for v in values(best.points[:1]))
    rmse = float(np.sqrt(cost[0] / shared.rows))
    straight = min(float(shared.solve(output[:, None], (first - lag,))[0][0]) for lag in range(_LARGEST_LAG + 1))
    straight = float(np.sqrt(straight / shared.rows))
    shows = rmse < _LEFT * straight and _RELEVANT * float(np.ptp(output[good])) < S \
        and abs(gain[0]) * S > _BEYOND * _resolution(z[good])
    return PositionEstimate(S, J, rmse, float(gain[0]), None, straight, bool(shows))


def _on_friction(fit: Fitted | None) -> tuple[list[tuple[Effect, FloatArray]], bool]:
    """Effects of a fit that change the friction at all times, their values (k,), and whether its command is held."""
    if fit is None:
        return [], True
    model = fit.model
    return [(effect, fit.values[rows]) for effect, rows in zip(model.effects, model.effect_rows, strict=True)
            if effect.friction is not None and effect.profile is None], model.spec.held


def _resolution(z: FloatArray) -> float:
    """The smallest change in the record of a moving position (n,): its quantum, or its reporting deadband."""
    moves = np.abs(np.diff(z))
    return float(np.quantile(moves[moves > 1e-9 * float(np.ptp(z))], _SMALLEST))
