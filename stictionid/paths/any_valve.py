"""Valves found along paths alone, from a grid of valves and processes: no start knows the answer.

A free run by the law tells nothing of a valve while slips are missed: on 24 exports, most of them slower than the
controller's scan, it stood at 1.6 to 59 times the noise at the true values. With a scatter of a fifth of f_s every slip
is possible, PV places them, and the cost along them is smooth. So a start may be far off. The scatter then shrinks.

The likeliest valves with the widest scatter are large ones, so the best of each size goes on. The process of the best
path is near the true one; valves near its own begin again beside it. S and the dead time make up for each other; the
last step moves all slips together, along that ridge.

Source: docs/details.md, section 14.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..model.model import Model
from ..model.slips import Paths
from ..typing import FloatArray
from .command_error import errs_by_scan
from .likelihood import likeliest_slips
from .settle import (
    TURNS,
    WORTH,
    Settled,
    at_force,
    climb,
    descend_along,
    in_differences,
    path_by_law,
    score_path,
    settle_path,
)

# Valves to begin with: shares of the largest S, with a slip jump that is this share of it. Then the scatters that
# shrink, as shares of f_s; the first is drawn once a stick, because a wide one by scan puts every slip early.
_SIZES, _JUMP, _SHRINKING = (0.1, 0.2, 0.4, 0.8), 0.5, (0.2, 0.07, 0.02)
# Processes that go on after one turn, valves that go on beside one process and that are settled, and rounds of a step
# along the ridge.
_PROCESSES, _NEAREST, _SETTLED, _ROUNDS = 2, 3, 2, 2
# Valves near one that was found: shares of its S, and slip jumps as shares of S. Times that they begin anew.
_NEAR, _JUMPS, _AGAIN = (0.8, 1.0, 1.25), (0.3, 0.6, 0.9), 3
# Steps along the ridge, in samples; the least is one command.
_RIDGE = (2.0, 1.0, 0.25)


def any_valve(model: Model, processes: Sequence[FloatArray], error: float, most: float = np.inf) -> list[Settled]:
    """Valves of every size settled beside the best of the processes of values (d,), the likeliest first.

    `error` is that of the command in %. None at all where even with the widest scatter every path leaves more than the
    error `most`, in the unit of y: no valve explains the record. None, too, where S or J is fixed.
    """
    model, found = model.along(None), []
    if model.law.one_parameter or not model.space.movable[:2].all():
        return []
    for size in _SIZES:
        once = sorted((_settle_within(_valve(model, process, size * model.s_max, error), _SHRINKING[0], 1)
                       for process in processes), key=lambda s: s.deviance)
        found.append(min((_settle_within(one, _SHRINKING[0]) for one in once[:_PROCESSES]), key=lambda s: s.deviance))
    by_scan = errs_by_scan(model)
    if by_scan:
        found = [score_path(one.model, one.values, replace(one.paths, by_scan=True)) for one in found]
    elif min(one.left for one in found) > most:
        return []
    for width in _SHRINKING[1:]:
        found = [_settle_within(one, width) for one in found]
    # (a force drawn once a stick leaves more than noise of such a record, whatever the valve)
    if by_scan and min(one.left for one in found) > most:
        return []
    return sorted(found, key=lambda s: s.deviance)


def settle_from_any_valve(model: Model, values: FloatArray, error: float, within: tuple[float, float],
                          most: float = np.inf) -> Settled | None:
    """The model settled from valves of every size beside the process of values (d,), or None (see `any_valve`)."""
    found = any_valve(model, (values,), error, most)
    return settle_near(found, error, within) if found else None


def settle_near(found: Sequence[Settled], error: float, within: tuple[float, float], tries: int = _AGAIN) -> Settled:
    """The best of settled models, after valves near to it began anew beside its process as long as that gains.

    `within` are bounds of the error of the command, `tries` the times that they begin anew at most.
    """
    for _ in range(tries):
        before = found[0]
        found = sorted([*found, *_beside_process(before, error)], key=lambda s: s.deviance)
        if not found[0].deviance < before.deviance - WORTH:
            break
    model, (first, *others) = found[0].model, found
    if not model.spec.knots:  # (a level that wanders takes up what moves all slips, unless each is placed well)
        first = climb(first, _steps(model), lambda moved, paths: _shrink_moved(model, moved, paths))
    best = min((settle_path(model, one.values, error=error, begin=one.paths, within=within)
                for one in [first, *others][:_SETTLED]), key=lambda s: s.deviance)
    return climb_slips(best, within, _steps(model)[-1:])


def climb_slips(found: Settled, within: tuple[float, float], steps: Sequence[int] = ()) -> Settled:
    """A settled model, or a likelier one with all its slips moved together, by steps in commands.

    Without `steps` these are two samples, one, and a quarter. `within` are bounds of the error of the command.
    """
    return climb(found, steps or _steps(found.model),
                 lambda moved, paths: _settle_moved(found.model, moved, paths, within))


def _settle_moved(model: Model, values: FloatArray, paths: Paths, within: tuple[float, float]) -> Settled:
    """A moved path settled: its values first, as its slips are where they should be, then both."""
    now = settle_path(model, values, error=paths.error, begin=paths, within=within, rounds=_ROUNDS, seek=False)
    return settle_path(model, now.values, error=now.paths.error, begin=now.paths, within=within)


def _shrink_moved(model: Model, values: FloatArray, paths: Paths) -> Settled:
    """A moved path settled with a scatter that shrinks, with few hypotheses."""
    now = score_path(model, values, paths)
    for width in _SHRINKING[1:]:
        now = _settle_within(now, width)
    return now


def _steps(model: Model) -> tuple[int, ...]:
    """Steps along the ridge in commands, the largest first."""
    return tuple(dict.fromkeys(max(round(samples * model.parts), 1) for samples in _RIDGE))


def _beside_process(found: Settled, error: float) -> list[Settled]:
    """Valves near to one that was found, settled anew beside its process; the likeliest ones with the least scatter."""
    model, values = found.model, found.values
    begin = [_valve(model, values, min(share * values[0], model.s_max), error, jump, by_scan=found.paths.by_scan)
             for share in _NEAR for jump in _JUMPS]
    once = sorted((_settle_within(one, _SHRINKING[1], 1) for one in begin), key=lambda s: s.deviance)
    near = [_settle_within(one, _SHRINKING[1]) for one in once[:_NEAREST]]
    return [_settle_within(one, _SHRINKING[-1]) for one in near]


def _valve(model: Model, values: FloatArray, S: float, error: float, jump: float = _JUMP, *,
           by_scan: bool = False) -> Settled:
    """The path by law of a valve of another S, with a slip jump as a share of it; the process from values (d,)."""
    start = values.copy()
    start[:2] = S, jump * S
    return path_by_law(model, start, _SHRINKING[0] * 0.5 * float(start[0] + start[1]), error, by_scan=by_scan)


def _settle_within(now: Settled, width: float, turns: int = TURNS) -> Settled:
    """Values and path settled with a scatter of this share of the break-away force, with few hypotheses."""
    scatter = width * 0.5 * float(now.values[0] + now.values[1])
    now = score_path(now.model, now.values, replace(now.paths, scatter=scatter))
    for _ in range(turns if np.isfinite(now.deviance) else 0):  # (else this valve can't take the path)
        path = likeliest_slips(now.along, now.values, in_differences(now), few=True)
        after = at_force(descend_along(score_path(now.model, now.values, path)))
        better = after.deviance < now.deviance - WORTH
        now = min(now, after, key=lambda s: s.deviance)
        if not better:
            break
    return now
