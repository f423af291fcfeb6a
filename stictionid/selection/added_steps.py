"""Steps of their own beyond the base model: a further lag, a valve that rests, a load that changes, a stop.

Each must lower the held-out error and BIC clearly; a change of load makes sense of a model that explains nothing.
Source: METHODS.md section 4; CRITICISM.md sections 6 and 7.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects import parse
from ..fit.context import Run, bic_gain, level_holdout
from ..fit.fit import Fitted
from ..fit.moves import descended, search_model, with_start
from ..fit.noise.completion import own_taps, quick
from ..fit.starts.basins import process_grid
from ..fit.starts.beside_effect import RESTING
from ..fit.starts.intersample import (
    QUICK_SETTLE,
    QUICK_TURNS,
    as_moving,
    may_move,
    moved,
    moved_after_all,
    surely_moves,
)
from ..model.spec import FIRST_ORDER, INTEGRATOR, Spec
from ..numerics.population import Found
from ..record.study import Step
from .only_noise import own_noise
from .structure import LAG, QUICK_KEPT, SOFT, Known, first_look, structure

# A step of its own must lower the held-out error by this share and BIC by this much (CRITICISM.md section 7). A second
# lag is a question of the process: not settled, it bends S through the dead time (8 % met), so it needs less.
_STEP_DROP, STEP_BIC = 0.03, 20.0
_LAG_DROP, _LAG_BIC, _LOOK_DROP = 0.002, 10.0, 0.01
# The law of a valve that rests at every sample, whatever it does while it slides. Taken without `diagnose` looking at
# its rivals, it must explain the record nearly alone: its error within the second factor of the irreducible noise; a
# first search beyond the first factor is not followed. (A drifting valve, too, fits better when it may rest: 3 times.)
_RESTING_LAW, _RESTING_TRIED, _RESTING_TAKEN = "he", 2.5, 1.3
# Changes of the load that are tried where a level explains nothing, and the share of the scatter of y that may be left.
_LOADS, _LOAD_LEFT = ("step-disturbance@load", "ramp-disturbance@load"), 0.5
# A stop is asked for where the model without leaves more than the first share of the scatter of y, and looked into
# where a valve without friction at its stop leaves less than the second share of that model's error: y then answers the
# output beyond a level, and not below. (With an oscillation from elsewhere it may seem to, beside coloured noise: it is
# taken only where nothing but white noise is left.)
_STOP, _STOP_ASKED, _STOP_LEAVES = "travel-limit", 0.6, 0.5
# Stickbands, as shares of their range, and slip jumps, as shares of S, that such a valve may have.
_STOP_S, _STOP_J = np.array([0.03, 0.06, 0.12, 0.2, 0.3, 0.45, 0.65]), np.array([0.2, 0.5, 0.8])
# An error below this share of the scatter of y is next to nothing: no plant measures better. Unit: 1.
_NEXT_TO_NOTHING = 0.01
# Below this share of it, a noise-free record is explained to what its sums round to. Unit: 1.
_ROUNDING = 1e-6


def try_resting(run: Run, steps: list[Step], fits: list[Fitted]) -> None:
    """Re-sticking as a step of its own, where a held command leaves errors and the valve may rest between its scans.

    A resting valve has its own basin in S, J and even in the process, which no search from the sliding one reaches;
    so the search starts where the law that rests at every sample (the effect's other end) ends.
    """
    before = fits[-1]
    spec = before.model.spec
    if before.model.law.sliding_state is None or run.adequate(steps[-1])[0]:
        return
    if before.best.rmse < _ROUNDING * float(np.std(run.used_y())) or quick(before.model, before.values).noise_alone:
        return
    if spec.between != "hold" and run.options.between == "auto" and surely_moves(run.loop):
        return  # there are no scans to rest between: one effect like others, to be held against them (diagnose)
    if spec.between != "hold":
        # Under a command that moves between samples the valve slides on most of the way: no basin of its own.
        count = len(steps)
        try_step(run, steps, fits, RESTING, _STEP_DROP, STEP_BIC, _RESTING_TAKEN)
        if len(steps) > count or run.options.between != "auto":
            return
        # A valve that rests under a held command looks as if the command moved, to a search that knows no rest.
        spec = replace(spec, between="hold", substeps=1)
    sliding = None
    if spec.process == FIRST_ORDER:
        sliding = Known(before.best.rmse, _explained(run, steps[-1], _RESTING_TRIED))
    resting = structure(run, replace(spec, law=_RESTING_LAW), known=sliding)
    if resting.evaluated is None or (sliding is not None and sliding.beats(resting)):
        return
    if not _explained(run, steps[-1], _RESTING_TRIED, resting.evaluated.rmse):
        return
    found = run.fit(resting.spec, before=(resting.point[None], np.array([resting.cost])))
    spec = replace(resting.spec, law=run.law, effects=(*spec.effects, RESTING))
    model = run.model(spec)
    at = model.rows_of(RESTING)
    guess = model.effects[model.names.index(RESTING)].guess
    assert guess is not None
    speeds = guess(model.context)
    starts = np.array([model.vector(found.best.values)]).repeat(len(speeds), axis=0)
    starts[:, at] = speeds
    made = [run.fit(spec, model.cube(starts.T))]
    some = [run.step(made[0], RESTING)]
    if LAG not in spec.effects and not run.options.fixed and not _alone(run, some[0], made[0]):
        # A further lag of the process, not yet in the model, may be what is left.
        try_step(run, some, made, LAG)
    after, step = made[-1], some[-1]
    was, now = steps[-1].error.rmse_holdout, step.error.rmse_holdout
    if was is None or now is None or now > (1.0 - _STEP_DROP) * was or not _alone(run, step, after):
        return
    if _clearly_better(before, after):
        steps.extend(some)
        fits.extend(made)


def leave_out(run: Run, steps: list[Step], fits: list[Fitted]) -> None:
    """The base, or it with a lag, alone where other steps had only led to it: with it they explain no more.

    A valve that rests, a lag and noise each imitate what a base in a wrong basin leaves, and end in the basin that it
    had missed; the first two imitate each other. Not for effects that were asked for.
    """
    full = fits[-1]
    spec, base = full.model.spec, fits[0].model.spec
    chosen = [step.added for step in steps[1:]]
    if run.options.fixed or not chosen \
            or not all(name in (LAG, RESTING) or (name and parse(name)[0].noise is not None) for name in chosen):
        return
    for kept in ((), (LAG,)):
        if len(kept) == len(chosen) or not set(kept) <= set(chosen):
            continue
        model = run.model(replace(spec, effects=(*base.effects, *kept), taps=own_taps(spec)))
        coarse = search_model(model)
        start = coarse.cube(coarse.vector(full.model.named(full.values))[:, None])
        near = descended(coarse, start, turns=QUICK_TURNS, settle=QUICK_SETTLE)
        error = coarse.evaluate(coarse.values(near.points[:1])[:, 0]).rmse
        if not _explained(run, steps[-1], _RESTING_TAKEN, error):
            continue
        after = run.fit(model.spec, near.points[:1])
        step = run.step_again(steps[0], after) if not kept else run.step(after, LAG)
        least = _LAG_BIC if LAG in chosen and not kept else STEP_BIC
        if run.adequate(step)[0] and not _clearly_better(after, full, least):
            steps[len(kept):], fits[len(kept):] = [step], [after]
            return


def _clearly_better(before: Fitted, after: Fitted, least_bic: float = STEP_BIC) -> bool:
    """Whether a fit of another structure does clearly better, by so much BIC where both are fitted in the same form.

    Criteria of levels and of differences can't be compared: there the held-out error must fall clearly.
    """
    if after.model.spec.whitening().tolist() == before.model.spec.whitening().tolist():
        return bic_gain(before, after) > least_bic
    was, now = level_holdout(before), level_holdout(after)
    return was is not None and now is not None and now < (1.0 - 3.0 * _STEP_DROP) * was


def _alone(run: Run, step: Step, fit: Fitted) -> bool:
    """Whether a valve that rests explains the record nearly alone: but for noise, which need not be white."""
    return _explained(run, step, _RESTING_TAKEN) or own_noise(run, fit) is not None


def _explained(run: Run, step: Step, within: float, error: float | None = None) -> bool:
    """Whether the error of a step is within so many times its irreducible noise, or next to nothing beside the scatter
    of y. `error` stands for the step's own.

    The noise of a noise-free record is 0, and no model of a valve between its samples is as good as that.
    """
    floor, error = step.error.noise_sd, step.error.rmse if error is None else error
    return floor is not None and error <= within * max(floor, _NEXT_TO_NOTHING * float(np.std(run.used_y())))


def try_step(run: Run, steps: list[Step], fits: list[Fitted], effect: str, least_drop: float = _LAG_DROP,
             least_bic: float = _LAG_BIC, within: float = np.inf) -> None:
    """Add `effect` as a step of its own where held-out error and BIC both fall by the least that is asked for.

    `within` is how many times the irreducible noise the error may be with it.
    """
    before = fits[-1]
    coarse, quick = first_look(run, before.model, before.best.values, effect)
    # The look is taken on a coarser model than the fit: the base gets the same descent on the same model.
    base = search_model(before.model)
    same = descended(base, base.cube(before.values[:, None]), turns=QUICK_TURNS, settle=QUICK_SETTLE)
    if not quick.costs[0] < float(same.costs[0]) * (1.0 - _LOOK_DROP):
        return
    spec = replace(before.model.spec, effects=coarse.spec.effects)
    after = run.fit(spec, quick.points[:QUICK_KEPT])
    step = run.step(after, effect)
    if before.rmse_holdout is None or after.rmse_holdout is None:
        return
    drop = 1.0 - after.rmse_holdout / before.rmse_holdout
    if drop > least_drop and bic_gain(before, after) > least_bic and (within == np.inf
                                                                      or _explained(run, step, within)):
        steps.append(step)
        fits.append(after)


def try_load(run: Run, steps: list[Step], fits: list[Fitted]) -> None:
    """A load that steps or drifts as a step of its own, where the model of an integrator explains nothing without.

    The controller answers a change of the load by another output, and a model that knows of none turns that into a
    ramp of the level: it can't be left for a later step, because there is no valve and no process beside it. What y
    moves must be explained for the most part with it, else nothing is added.
    """
    before = fits[-1]
    spec = before.model.spec
    if spec.process != INTEGRATOR or run.options.fixed or any(name in spec.effects for name in _LOADS):
        return
    bare = replace(spec, increments=True, taps=SOFT)
    sure = surely_moves(run.loop)
    if run.options.between == "auto" and not sure:
        bare = replace(bare, between="hold", substeps=1)
    name, start = min(((name, _with_load(run, bare, before, name)) for name in _LOADS), key=lambda x: x[1].costs[0])
    full = replace(bare, effects=(*bare.effects, name))
    after = run.fit(full, start.points[:QUICK_KEPT])
    step = run.step(after, name)
    # (Softened differences are soon at the noise: how the command moved is seen beyond that.)
    if run.options.between == "auto" and not sure and may_move(run.loop) \
            and (not run.adequate(step)[0] or moved_after_all(after, run.options.scan_s) is not None):
        moving = as_moving(full)
        near = moved(after.model, after.values, moving)
        start = _with_load(run, as_moving(bare), before, name)
        other = run.fit(moving, np.concatenate([near.points[:1], start.points[:QUICK_KEPT]]))
        if other.sse < after.sse:
            after, step = other, run.step(other, name)
    if after.best.rmse <= _LOAD_LEFT * float(np.std(run.used_y())):
        steps.append(step)
        fits.append(after)


def try_stop(run: Run, steps: list[Step], fits: list[Fitted]) -> None:
    """A stop as a step of its own, where it hides most of the movement: y answers the output beyond a level only.

    A model without it finds neither valve nor process, because for most of the record y does not answer at all. A valve
    without friction shows the stop and the process first; with them the stickband is looked for.
    """
    before = fits[-1]
    spec = before.model.spec
    if _STOP in spec.effects or run.options.fixed \
            or before.best.rmse < _STOP_ASKED * float(np.std(run.used_y())):
        return
    spec = replace(spec, process=FIRST_ORDER, increments=False, taps=(), effects=(*spec.effects, _STOP))
    free = search_model(run.model(replace(spec, friction_free=True)))
    rows = free.rows_of(_STOP)
    guess = free.effects[free.names.index(_STOP)].guess
    assert guess is not None
    start = free.values(np.full((1, free.space.size), 0.5))[:, 0]
    tried = []
    for levels in guess(free.context):
        start[rows] = levels
        points, costs = process_grid(free, free.cube(start[:, None])[0])
        tried.append((float(costs.min()), points[costs.argmin()]))
    tried.sort(key=lambda t: t[0])
    seen = descended(free, np.array([point for _, point in tried[:QUICK_KEPT]]))
    if seen.costs[0] > (_STOP_LEAVES * before.best.rmse) ** 2 * free.shared.rows:
        return
    model = search_model(run.model(spec))
    S, J = (axis.ravel() for axis in np.meshgrid(_STOP_S, _STOP_J, indexing="ij"))
    values = model.values(np.full((1, model.space.size), 0.5)).repeat(S.size, axis=1)
    values[:] = model.vector(free.named(free.values(seen.points[:1])[:, 0]))[:, None]
    values[0] = model.space.parameters[0].high * S
    values[1] = values[0] * J
    near = descended(model, with_start(model, model.cube(values)), turns=QUICK_TURNS, settle=QUICK_SETTLE)
    after = run.fit(spec, near.points[:QUICK_KEPT])
    step = run.step(after, _STOP)
    if _explained(run, step, _RESTING_TAKEN):
        steps.append(step)
        fits.append(after)


def _with_load(run: Run, bare: Spec, before: Fitted, name: str) -> Found:
    """A first look at a change of the load beside a structure without any."""
    return first_look(run, run.model(bare), before.best.values, name)[1]
