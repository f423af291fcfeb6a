"""Intervals of a fitted model's numbers: a cloud around the optimum, and what of it the cost can't tell apart.

Source: CRITICISM.md sections 5 and 7; Hansen 2000 for the threshold.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .descent import normals_at, principal
from .loop import FloatArray
from .model import Model
from .moves import FORCES, ROUGH_FORCES, descended, first_force, movable, spreads
from .noise import autocovariance
from .spec import Evaluated

# Difference for the slopes behind the rays, and how far along them is looked, as shares of the range.
_RAY_DIFFERENCE, _RAY_LADDER = 1e-4, np.geomspace(1e-5, 0.5, 26)
# Longest scan of a usual DCS in seconds; and share of a move of the command to which its rebuilding is exact at slips
# (benchmarks/verdicts.py, seeds below 1000).
_SLOWEST_SCAN_S, _REBUILT = 2.0, 0.35
# Slip jumps (distance as shares of S) and break-aways (factors of S) tried for the interval of J.
_JUMPS = np.array([0.01, 0.02, 0.035, 0.055, 0.08, 0.12, 0.17, 0.25, 0.4])
_BREAKS = 1.0 + np.array([-0.008, -0.004, -0.002, -0.001, -0.0005, 0.0, 0.0005, 0.001, 0.002, 0.004, 0.008])
_BREAKS_KEPT = 3
# Size of the cloud around the optimum from which folds and intervals choose.
CLOUD = 120
# Likelihood-ratio threshold for a 90 % interval of a threshold parameter (Hansen 2000; CRITICISM.md section 5).
INTERVAL_THRESHOLD = 5.94
INTERVAL_LEVEL = 0.90


def region(model: Model, top: FloatArray, rng: np.random.Generator,
           jumps: FloatArray | None = None) -> dict[str, tuple[float, float]]:
    """Intervals of all numbers of a model around a point (d,) that has been polished.

    `jumps` (k, d) are points with other slip jumps where they are known from a narrower model.
    """
    cube, cost = cloud(model, top, rng, None if jumps is None else _jumps_settled(model, jumps))
    best = int(cost.argmin())
    return intervals_of(model, cube, cost, float(cost[best]), model.evaluate(model.values(cube[best:best + 1])[:, 0]))


def cloud(model: Model, top: FloatArray, rng: np.random.Generator,
          jumps: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Points around the optimum, shaped by the points that do nearly as well, and their costs; `jumps` among them.

    Rays along which one number moves and the others follow; a cloud of all numbers together; and one with the
    break-away (S, initial force) held, since on a sampled command its plateau is far narrower than the rest.
    """
    free = movable(model) > 0
    held = free & ~np.isin(np.arange(top.size), (0, *model.forces))
    jumps = jump_profile(model, top) if jumps is None else jumps
    looks = np.concatenate([top[None], _rays(model, top), jumps])
    around, near = _adapted(model, top, free, rng), _adapted(model, top, held, rng)
    return (np.concatenate([looks, around[0], near[0]]),
            np.concatenate([model.costs(looks), around[1], near[1]]))


def jump_profile(model: Model, top: FloatArray) -> FloatArray:
    """Points (k, d) with other slip jumps, each with the break-away and the process that go best with it.

    A held command makes the path of the valve jump between a few shapes as S and the initial force move by little; each
    has another best slip jump, which no ray from the best point reaches.
    """
    if not model.spec.held or model.law.one_parameter or not movable(model)[:3].all():
        return top[None]
    values = model.values(top[None])[:, 0]
    jumps = values[1] + values[0] * np.concatenate([-_JUMPS, _JUMPS])
    jumps = jumps[(jumps >= 0.0) & (jumps <= 1.5 * values[0])]
    if not jumps.size:
        return top[None]
    grid = values[:, None].repeat(jumps.size * _BREAKS.size, axis=1)
    grid[0] *= np.tile(_BREAKS, jumps.size)
    grid[1] = jumps.repeat(_BREAKS.size)
    if len(model.pieces) > 1:
        # The residual force stays what it is, not its share of a break-away force that changes.
        grid[list(model.forces)] *= (values[0] + values[1]) / (grid[0] + grid[1])
        grid[list(model.forces)] = np.clip(grid[list(model.forces)], -1.0, 1.0)
    rough, cost = first_force(model, model.cube(grid), ROUGH_FORCES)
    order = np.argsort(cost.reshape(jumps.size, -1), axis=1, kind="stable")[:, :_BREAKS_KEPT]
    kept = (order + np.arange(jumps.size)[:, None] * _BREAKS.size).ravel()
    near, cost = first_force(model, rough[kept], FORCES)
    best = cost.reshape(jumps.size, -1).argmin(axis=1) + np.arange(jumps.size) * _BREAKS_KEPT
    return _jumps_settled(model, near[best])


def _jumps_settled(model: Model, points: FloatArray) -> FloatArray:
    """Points (k, d) with the process that goes best with each one's valve."""
    return descended(model, points, held=(0, 1, *model.forces), turns=4, settle=1e-3).points


def _rays(model: Model, top: FloatArray) -> FloatArray:
    """Points (k, d) along the directions in which a number moves while the others follow it at least cost.

    The direction of each number is its column of the covariance that the slopes of the residuals give: of all numbers,
    and with the break-away (S, initial force) held, since slopes across a held command's plateau mean little. A wide
    ladder both ways finds where the cost leaves each ray.
    """
    free = np.flatnonzero(movable(model) > 0)
    normal = normals_at(model.residuals, top[None], free, np.full((1, free.size), _RAY_DIFFERENCE))[0][0]
    directions = [*np.eye(top.size)[free], *_following(normal, free, top.size)]
    held = ~np.isin(free, (0, *model.forces))
    if held.any() and not held.all():
        directions += _following(normal[np.ix_(held, held)], free[held], top.size)
    ladder = np.concatenate([-_RAY_LADDER, _RAY_LADDER])
    points = top + ladder[:, None, None] * np.array(directions)
    inside = ((points >= 0.0) & (points <= 1.0)).all(axis=2)
    return points[inside]


def _following(normal: FloatArray, free: FloatArray, size: int) -> list[FloatArray]:
    """Directions (size,) along which one of the `free` numbers moves by 1 and the others follow at least cost."""
    values, vectors, scale = principal(normal)
    spread = (vectors / np.maximum(values, 1e-9 * values[-1] + 1e-30)) @ vectors.T / scale / scale[:, None]
    found = []
    for j in range(free.size):
        ray = np.zeros(size)
        ray[free] = spread[:, j] / max(abs(spread[j, j]), 1e-300)
        found.append(ray)
    return found


def _adapted(model: Model, top: FloatArray, free: NDArray[np.bool_],
             rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Points (k, d) around `top` in its free numbers, drawn three times from the spread of the best so far, and costs.
    """
    columns = np.flatnonzero(free)
    d = columns.size
    if not d:
        return top[None], model.costs(top[None])
    wide = spreads(model, 0.3)[columns] * rng.standard_normal((CLOUD, d)) * np.exp(-5.0 * rng.random((CLOUD, 1)))
    cube = top[None].repeat(CLOUD, axis=0)
    cube[:, columns] = np.clip(top[columns] + wide, 0.0, 1.0)
    cost = model.costs(cube)
    for _ in range(3):
        chosen = cube[np.argsort(cost, kind="stable")[:max(4 * d, CLOUD // 8)]][:, columns] - top[columns]
        spread = chosen.T @ chosen / len(chosen)
        root = np.linalg.cholesky(spread + (1e-10 * np.trace(spread) + 1e-18) * np.eye(d))
        more = top[None].repeat(CLOUD, axis=0)
        more[:, columns] = np.clip(top[columns] + 1.7 * rng.standard_normal((CLOUD, d)) @ root.T, 0.0, 1.0)
        cube, cost = np.concatenate([cube, more]), np.concatenate([cost, model.costs(more)])
    return cube, cost


def effective_rows(residual: FloatArray, good: FloatArray) -> float:
    """Rows that count as independent, by the residual's lag-one autocorrelation (n (1-ρ)/(1+ρ))."""
    r = autocovariance(residual, good > 0, 1)  # the first sample of a segment never counts
    rho = float(np.clip(r[1] / r[0], 0.0, 0.999)) if r[0] > 0 else 0.0
    return max(float((good > 0).sum()) * (1.0 - rho) / (1.0 + rho), 5.0)


def intervals_of(model: Model, cube: FloatArray, cost: FloatArray, best_cost: float,
                 best: Evaluated) -> dict[str, tuple[float, float]]:
    """Smallest and largest value of each parameter among points that the likelihood ratio does not exclude."""
    rows = effective_rows(np.nan_to_num(best.innovation), model.weight)
    keep = rows * np.log(np.maximum(cost, 1e-300) / max(best_cost, 1e-300)) <= INTERVAL_THRESHOLD
    if not keep.any():
        keep = cost <= best_cost
    values = model.values(cube[keep])
    found = {name: (float(v.min()), float(v.max())) for name, v in zip(best.values, values, strict=True)}
    margin = _between_samples(model, best)
    for name in ("S", "J"):
        low, high = found[name]
        found[name] = (max(low - margin, 0.0), high + margin)
    return found


def _between_samples(model: Model, best: Evaluated) -> float:
    """How far S and J may be off in % because a slip happened between two samples, where the command is not known.

    A record as fast as the scans of a DCS knows its command. A slower one knows a slip to a whole move of the command
    from one sample to the next; a command rebuilt between samples (or at the scans there) is known to a share of such
    a move.
    """
    share = _REBUILT if model.spec.between != "hold" else 1.0 if model.step_s > _SLOWEST_SCAN_S else 0.0
    moves = []
    for position, output in zip(model.split(best.position), model.split(model.loop.output), strict=True):
        moved = np.abs(np.diff(position)) > 1e-9
        moves.append(np.abs(np.diff(output))[np.flatnonzero(moved[1:] & ~moved[:-1]) + 1])
    slips = np.concatenate(moves)
    return share * float(np.median(slips)) if slips.size and share else 0.0
