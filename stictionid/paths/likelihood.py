"""Likelihood of a model along a path of slips: the free run along it, and the break-away forces that it asks for.

-2 log L = rows ln(SSE / rows) - 2 sum over strokes of ln P(the force lies where the path says), with the forces drawn
from N(f_s, scatter^2). The model along the path is the model with another law (`AlongPath`): effects, process, noise
filter and least squares are the same. A path by the law with a scatter near 0 gives today's sum of squares.

Source: docs/details.md, section 14.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..laws.contract import lanes_by_change
from ..model.forces import Forces
from ..model.landing import chain_of
from ..model.model import Model
from ..model.replay import AlongPath, Replayed, by_law, replay_slips, supports_replay
from ..model.slips import Landing, Paths, Slips
from ..model.spec import Evaluated
from ..process.linear import free_run
from ..typing import FloatArray
from .beam import beam

# Hypotheses that a beam keeps, and those for each value of the command where PV shows only one in so many. With 14 the
# likeliest slips of exports at every fifth and tenth scan were lost: they left up to twice the noise.
_KEPT, _EACH = 14, 24
# Nodes of a beam's tree for every value of the command, for each hypothesis, and at most. Up to 40 were used.
_NODES_EACH, _NODES = 2, 64


def path_possible(model: Model, values: FloatArray) -> bool:
    """True where the law of the model, with its effects at values (d,), slips and lands as a path says."""
    return not model._follows and supports_replay(model.law, model.friction(values[:, None]))


def law_paths(model: Model, values: FloatArray) -> tuple[Slips, ...]:
    """The slips of a valve at values (d,) that breaks away exactly at f_s, for each segment."""
    return tuple(by_law(piece.law, piece.context.command, piece.friction(own), piece.profile, own[2])
                 for piece, own in _pieces_apart(model, values[:, None]))


def strokes(model: Model, values: FloatArray, paths: Paths, *, lent: bool = True) -> list[Replayed]:
    """The strokes of every segment for values (d, P); of `lent` ones the positions of the last segment only hold."""
    return [replay_slips(piece.law, piece.context.command, piece.friction(own), piece.profile, own[2], slips, lent=lent,
                         doubt=piece.doubts(paths.error), errors=paths.scan_errors(*piece.grid))
            for (piece, own), slips in zip(_pieces_apart(model, values), paths.slips, strict=True)]


def forces(along: Model, values: FloatArray) -> list[Forces]:
    """The forces of the strokes of every segment for values (d, P), of a model along paths."""
    paths = along.spec.paths
    assert paths is not None
    return [piece.law.forces(piece.context.command, piece.friction(own), piece.profile, own[2])
            if isinstance(piece.law, AlongPath) else strokes(piece, own, paths.of(i))[0].forces
            for i, (piece, own) in enumerate(_pieces_apart(along, values))]


def log_prior(found: Sequence[Forces], scatter: float) -> FloatArray:
    """Logarithm (P,) of the chance of the break-away forces and turns of all segments."""
    return np.sum([one.log_chance(scatter) for one in found], axis=0)


def log_chance(found: Sequence[Forces], paths: Paths) -> FloatArray:
    """Logarithm (P,) of the chance of all paths that PV allows, from that of one and its share; chances add up to one.

    A share belongs to the values at which the path was sought; along the path other values may explain PV better.
    """
    return np.minimum(log_prior(found, paths.scatter) - paths.share, 0.0)


def deviance(along: Model, values: FloatArray) -> FloatArray:
    """-2 log L (P,) of values (d, P), but for a constant, for a model along paths; infinite where it can't be."""
    rows, paths = along.shared.rows, along.spec.paths
    assert paths is not None
    noise = rows * np.log(along.costs_of(values) / rows) + along.log_scale
    found = noise - 2.0 * log_chance(forces(along, values), paths)
    return np.where(np.isnan(found), np.inf, found)


def likeliest_slips(along: Model, values: FloatArray, seen: Evaluated | None = None, *, few: bool = False) -> Paths:
    """The likeliest slips of every segment at values (d,), sought from a model along paths.

    Gain, noise and all that is beside the valve are those of the model, or as `seen` in another form of it.
    The beam's process lacks a lag that differs by direction, and effects behind the valve. Their part of y comes from
    the model along its paths, which is right for paths near to them. With `few` hypotheses a path is found that is near
    to the likeliest one, in a fraction of the time.
    """
    assert along.spec.paths is not None
    found = seen or along.evaluate(values)
    noise = float(np.sqrt(found.sse / max(found.rows, 1)))
    # The error of a landing is that of the command; a model fitted to differences of y does not show it.
    ratio = abs(found.gain / noise) * along.spec.paths.error
    told = 0.0 < ratio < np.inf and not along.spec.increments
    now = replace(along.spec.paths, landing=Landing(ratio, tuple(along.named(values).items())) if told else None)
    each = [_beam_slips(piece, own, y, found.gain, noise, now, few) for (piece, own), y in
            zip(_pieces_apart(along, values[:, None]), along.split(found.model), strict=True)]
    return replace(now, slips=tuple(slips for slips, _ in each), share=sum(share for _, share in each))


def _beam_slips(model: Model, column: FloatArray, predicted: FloatArray, gain: float, noise: float,
                paths: Paths, few: bool) -> tuple[Slips, float]:
    """The likeliest slips at values (d, 1) of a model along its slips so far, which gives `predicted` (n,).

    Second: the log of the share that they have in all slips that PV allows.
    """
    friction, dynamics = model.friction(column), model.dynamics(column)
    command = model.context.command
    position = model.law.positions(command, friction, profile=model.profile, share=column[2])
    _, parts = model.grid
    plain = replace(dynamics, closing=None, dead_time_drift=None)
    start = float(model.law.start(float(command[0]), friction, column[2])[0, 0])
    # (before its first value the command left the stem where it starts: it may slip at once)
    position = np.concatenate([np.full((parts, 1), start), position])
    response = free_run(position, plain, step_s=model.step_s, substeps=parts, ahead=not model.spec.held)[1:, 0]
    chain = chain_of(model, column)
    target = (model.context.process_value - predicted + gain * response) / noise
    kept = _KEPT if few or parts == 1 else _EACH * parts
    errors = paths.scan_errors(*model.grid)
    nodes = min(_NODES_EACH * kept, _NODES) * command.size
    parent, at, kind = (np.empty(nodes, np.int64) for _ in range(3))
    (_, profile), = lanes_by_change(friction, model.profile)
    _, share, node, known = beam(command, np.ascontiguousarray(friction[:, 0]), profile, start,
                          model.law.slips == "rests", paths.scatter, model.doubts(paths.error), parts, chain.late,
                          *chain.over(parts), chain.through, gain / noise, target, model.good(),
                          model.weight > 0, model.taps, paths.error if paths.landing else 0.0, paths.own_variance,
                          np.empty(0) if errors is None else errors.command, paths.jitter, model.late_moves, kept,
                          parent, at, kind)
    path: list[int] = []
    while node >= 0:
        path.append(node)
        node = int(parent[node])
    order = np.array(path[::-1], dtype=np.int64)
    return Slips(at[order], kind[order], known, command.size), min(share, 0.0)


def _pieces_apart(model: Model, values: FloatArray) -> list[tuple[Model, FloatArray]]:
    """The model of every segment and its values (d, P)."""
    return [(piece, model.of(i, values)) for i, piece in enumerate(model.pieces)]
