"""The best model without friction, and whether a valve that sticks predicts y any better than one that does not.

A friction-free model with coloured noise explains every smooth oscillation (a sine from elsewhere, tight tuning) as
well as a valve does. Only the slips of a sticking valve stay unpredicted. The friction-free model has a structure of
its own and one more lag, so that friction is not confused with a process of higher order. Source: docs/details.md,
section 7.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects import parse
from ..model.model import Model
from ..model.spec import FIRST_ORDER, INTEGRATOR, Spec, suited_effects
from ..numerics.archived import archived
from ..numerics.autoregression import autoregression, filter_residual
from ..numerics.noise.heavy_tails import likelihood_ratios
from ..process.controller_law import usual_law
from ..typing import BoolArray, FloatArray
from .context import Run
from .noise.prewhitening import (
    ORDER,
    SETTLE,
    STARTS,
    Whitened,
    whiten_in_turns,
    whiten_model,
    whitened,
    with_noise_of,
    without_noise,
)
from .points.fitted import Fitted
from .points.moves import descend_model, descend_values
from .starts.basins import process_grid
from .starts.beside_effect import LAG

# Number of the grid's best processes that are compared again under a noise model.
_NEAREST = 64
# Turns of a first descent, and the factor on the least cost up to which a start goes on.
_GLANCE, _RIVAL = 4, 1.5
# A held command is searched beside a moving one where its one-step error is within this factor. It starts from dead
# times this many samples earlier, and only below this likelihood ratio.
_NEAR, _EARLIER, _NO_DOUBT = 1.02, (0.0, 0.5, 1.0), 1000.0


def gain_of_friction(sticking: Whitened, free: Whitened) -> float:
    """Twice the log-likelihood by which a model with friction predicts better, on the samples that both predict."""
    return float(gains_of_friction(sticking, free).sum())


def gains_of_friction(sticking: Whitened, free: Whitened) -> FloatArray:
    """The same (n,) for each of the samples that both predict.

    Values that a historian filled in follow from their neighbours, and a noise model of all rows is one of straight
    lines. Of a thinned y only the values that were kept count, with a noise model of these alone.
    """
    loop = sticking.model.loop
    thin = archived(loop.process_value, loop.starts, loop.output)
    (a, one), (b, other) = ((w.innovation, w.good) if thin is None else _among(thin.kept, w) for w in (sticking, free))
    return likelihood_ratios(a[one & other], b[one & other])


def _among(kept: BoolArray, w: Whitened) -> tuple[FloatArray, BoolArray]:
    """Innovations (n,) of a model's free run from one value that was kept to the next, and where they count."""
    residual, counted, starts = w.evaluated.residual, kept & (w.evaluated.counted > 0), w.model.loop.starts
    taps = autoregression(residual, counted, ORDER, starts)
    return filter_residual(residual, counted, np.concatenate([[1.0], taps]), starts)


def follows_command(run: Run, fit: Fitted) -> bool:
    """True where a valve without friction explains a record: white noise is left, and friction gains less than BIC.

    Wrong where an effect that is not in the fit hides the slips of a sticking valve, and the noise model makes white
    noise of both.
    """
    sticking, free = with_and_without(run, whiten_model(fit.model, fit.values))
    gains = gains_of_friction(sticking, free)
    cost = numbers_of_friction(fit.model) * float(np.log(max(gains.size, 1)))
    return free.white and float(gains.sum()) < cost


def numbers_of_friction(model: Model) -> int:
    """The free numbers that friction adds to a model: S, J and its initial forces, as far as they are not given."""
    return int(model.space.movable[[0, 1, *model.forces]].sum())


def with_and_without(run: Run, sticking: Whitened) -> tuple[Whitened, Whitened]:
    """A model with friction and the best one without; each gets the noise of either, so that no noise speaks for one.
    """
    free = friction_free(run, sticking)
    return with_noise_of(sticking, free), with_noise_of(free, sticking)


def friction_free(run: Run, sticking: Whitened) -> Whitened:
    """The best model without friction: first order or the structure of the sticking one, whichever predicts better."""
    # (without friction there are no slips, which a path would keep in place)
    spec = replace(sticking.model.spec, paths=None)
    law = usual_law(run.loop.longest_segment(), held=spec.held)
    # A command that moves with y between samples predicts y by the controller's law in reverse, with a gain of the
    # wrong sign. That is no process.
    acts = 0.0 if law is None or law.gain * sticking.evaluated.gain <= 0.0 else float(np.sign(law.gain))
    effects = tuple(name for name in spec.effects if parse(name)[0].kind != "F" and name != LAG)
    lag = () if spec.fixed else (LAG,)
    tried: list[Whitened] = []
    for process in dict.fromkeys((FIRST_ORDER, spec.process)):
        bare = replace(spec, process=process, effects=(*suited_effects(effects, process), *lag), friction_free=True,
                       taps=(), increments=process == INTEGRATOR or (spec.increments and process == spec.process))
        held = replace(bare, between="hold", substeps=1)
        if spec.held:
            tried.append(_whitened_free(run, held, sticking, acts))
            continue
        # Under a command that moves between samples, the friction-free model gets the same command.
        tried.append(_whitened_free(run, bare, sticking, acts))
        other = _held_beside(run, held, tried[-1], sticking, acts)
        if other is not None:
            tried.append(other)
    return min(tried, key=lambda w: w.innovation_sd)


def _held_beside(run: Run, spec: Spec, moving: Whitened, sticking: Whitened, acts: float) -> Whitened | None:
    """The friction-free model with a held command, where the search ran with a moving one; None where it can't matter.

    It can't where a descent from the process and noise model of the moving command ends clearly worse. Where the
    descent leaves no doubt that the valve sticks, its result is returned, because a full search would not change the
    answer.
    """
    model = run.model(replace(spec, taps=moving.model.spec.taps))
    starts = moving.values[:, None].repeat(len(_EARLIER), axis=1)
    starts[4] = np.maximum(starts[4] - np.array(_EARLIER) * model.step_s, 0.0)
    near = whitened(model, descend_values(model, starts, turns=_GLANCE, settle=SETTLE))
    if near.innovation_sd > _NEAR * moving.innovation_sd:
        return None
    if gain_of_friction(sticking, near) < _NO_DOUBT:
        return _whitened_free(run, spec, sticking, acts)
    return replace(near, rmse=min(near.rmse, moving.rmse))


def _whitened_free(run: Run, spec: Spec, sticking: Whitened, acts: float) -> Whitened:
    """The friction-free model, prewhitened and searched in turns: a wrong noise model would bend its process."""
    model, values, near = _friction_free(run, spec, sticking, acts)
    best = whiten_in_turns(whitened(model, values), lambda last, taps: _friction_free(
        run, replace(spec, taps=taps), sticking, acts, last.values, near)[:2])
    walks = spec.increments and spec.process != INTEGRATOR
    return replace(best, rmse=min(best.rmse, without_noise(best.model, best.values))) if walks else best


def _friction_free(run: Run, spec: Spec, sticking: Whitened, acts: float, known: FloatArray | None = None,
                   near: FloatArray | None = None) -> tuple[Model, FloatArray, FloatArray]:
    """The friction-free model of a spec, its best values (d,), and the best points (m, d) of its process grid.

    `acts` is the sign of its gain, 0 where that is not known.

    Effects start as in the `sticking` model: both models know the same disturbances. `known` (d,) are the values under
    another noise model. The polish then starts from them and from the best of the grid's points `near`.
    """
    model = run.model(spec)
    start, found = np.full(model.space.size, 0.5), model.cube(
        model.vector(sticking.model.named(sticking.values))[:, None])[0]
    start[:3] = found[:3] = 0.0
    if known is not None and near is not None:
        starts = np.stack([model.cube(known[:, None])[0], near[model.costs(near).argmin()], found])
        return model, _descend_starts(model, starts, acts), near
    for rows in (model.rows_of(name) for name in model.names if name in sticking.model.names):
        start[rows] = found[rows]
    points, costs = process_grid(model, start)
    points = points[np.argsort(costs, kind="stable")[:_NEAREST]]
    # The process of the sticking model is a start, too, so that a better process is not counted as friction.
    return model, _descend_starts(model, np.concatenate([points[list(STARTS)], found[None]]), acts), points


def _descend_starts(model: Model, starts: FloatArray, acts: float) -> FloatArray:
    """The best values (d,) of descents from several starts (k, d), with a gain of the sign `acts` where one has it."""
    first = descend_model(model, starts, turns=_GLANCE, settle=SETTLE)
    # The other starts have come to the same optimum or are far from it.
    other = (first.costs > first.costs[0] * (1.0 + SETTLE)) & (first.costs < _RIVAL * first.costs[0])
    other[0] = True
    if acts:
        signed = np.array([acts * model.evaluate(v).gain > 0.0 for v in model.values(first.points).T])
        other = other & signed if (other & signed).any() else signed if signed.any() else other
    ends = model.values(descend_model(model, first.points[other]).points)
    return next((v for v in ends.T if acts * model.evaluate(v).gain > 0.0), ends[:, 0])
