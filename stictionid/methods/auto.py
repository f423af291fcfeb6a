"""Default method: ARX finds the basin, the free-run error finishes, restarts must agree, the structure is chosen.

Base model: the law asked for, first order with dead time or integrator with lag and dead time, white output noise.
Decides what the command did between samples and whether the process integrates; adds a further lag as a step of its
own where the data ask for it. Wrong where something is missing from the model: `diagnose` then looks for it.

Source: METHODS.md section 4, traps 1 to 5; the paper's Eq. 7 to 21 for the ARX part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import CannotTell
from ..fit import Fitted, descended, one_run, region, search_model, with_process, with_start
from ..gates import SAMPLES_PER_PERIOD
from ..loop import FloatArray
from ..model import Model
from ..noise import autocovariance
from ..oscillation import noise_of
from ..regression import whiten
from ..results import Step
from ..search import Found
from ..spec import FIRST_ORDER, INTEGRATOR, Evaluated, Spec
from ..whitened import Whitened, whitened
from .contract import Method, Outcome
from .run import ADEQUATE, INTEGRATOR_GAIN, LONG_LAG, Run, increment_error, parameters

# Parts of a sampling interval when the command moves between samples.
SUBSTEPS = 8
# A step of its own must lower the held-out error by this share and BIC by this much (CRITICISM.md section 7). A second
# lag is a question of the process: not settled, it bends S through the dead time (8 % met), so it needs less.
_STEP_DROP, _STEP_BIC = 0.03, 20.0
_LAG, _LAG_DROP, _LAG_BIC, _LOOK_DROP = "extra-lag", 0.002, 10.0, 0.01
# First look at a step: turns of descent, when one has settled, and points kept for the fit.
_QUICK_TURNS, _QUICK_SETTLE, _QUICK_KEPT = 8, 1e-3, 4
# The law of a valve that rests at every sample, whatever it does while it slides. Taken without `diagnose` looking at
# its rivals, it must explain the record nearly alone: its error within the second factor of the irreducible noise; a
# first search beyond the first factor is not followed. (A drifting valve, too, fits better when it may rest: 3 times.)
_RESTING_LAW, _RESTING_TRIED, _RESTING_TAKEN = "he", 2.5, 1.3
# Sample-to-sample noise of the command, as a share of its swing, above which nothing is rebuilt between samples.
_ROUGH = 2e-3
# Softened differences (1 - q^-1) / (1 - 0.8 q^-1), cut after 14 samples: white for the errors of slips that an
# integrator adds up together with white noise on y. Plain differences double the noise and leave the slips. Measured
# on continuous itptd, S = 5, J = 3, noise 0.5 to 1 % of the swing of y: S within 0.8 and J within 1.1 %, against 4.3
# and 8.8 % with plain differences, 4 and 5 % with a first-order process of long lag.
SOFT = tuple(0.8**k for k in range(1, 15))
# Correlation of neighbouring differences below which noise fills them. Unit: 1; white noise has -0.5.
_NOISY = -0.25
# Share of the differences' variance that the noise of the record must make to fill them. Unit: 1.
_NOISE_SHARE = 0.5
# A lag beyond this many periods needs no proof that the process integrates: the integrator may even predict this much
# worse, because its slips add up their errors. Units: periods, 1.
_ENDLESS_LAG, _ENDLESS_LOSS = 3.0, 0.05
# The command is taken as continuous only when that lowers the free-run error by this share.
_CORNER_GAIN = 0.05
# A noise of its own has no root beyond this: slower, it is a disturbance. Unit: 1.
NOISE, _SLOWEST_ROOT = "coloured-noise", 0.97
# Its innovations have no kurtosis beyond this (3 if normal), and no stretch of so many is louder by more than this.
_HEAVY, _UNEVEN, _STRETCHES = 4.5, 2.0, 10
# Below this share of the scatter of y an error is no noise of a plant.
_NO_NOISE = 0.002
# Below this share of the period a lag is no integrator in disguise, unless the error is this many times the noise.
_ANY_LAG, _FAR = 0.2, 2.5


@dataclass(frozen=True, slots=True)
class _Tried:
    """One search with one structure: its best point of the unit cube (d,), cost and curves."""

    spec: Spec
    point: FloatArray
    cost: float
    evaluated: Evaluated | None
    increments: float


def _run(run: Run) -> Outcome:
    """Base model with its process and between-samples choice, then what the data ask for beyond it."""
    o = run.options
    spec = Spec(law=run.law, effects=o.effects, fixed=dict(o.fixed),
                between="hold" if o.between == "auto" else o.between,
                substeps=SUBSTEPS if o.between == "corner" else 1)
    run.tell("searching (S, J)", 0.1)
    spec, runs = _choose(run, spec)
    run.tell("restarting until two searches agree", 0.5)
    fit = run.fit(spec, before=runs)
    if fit.best.rmse > 0.995 * float(np.std(run.used_y())):
        raise _explains_nothing(run)
    steps, fits = [run.step(fit, None)], [fit]
    if not o.base_only and "re-sticking" not in spec.effects:
        run.tell("trying a valve that rests between scans", 0.6)
        _try_resting(run, steps, fits)
    if not o.base_only and _LAG not in spec.effects and not o.fixed:
        run.tell("trying a further lag", 0.7)
        _try_step(run, steps, fits, _LAG)
    if not o.base_only and not o.fixed and not run.adequate(steps[-1])[0]:
        run.tell("trying coloured noise", 0.75)
        _try_noise(run, steps, fits)
    if not o.base_only and not o.fixed and _LAG not in fits[-1].model.spec.effects:
        fits[-1] = _whatever_the_order(run, fits[-1])
        steps[-1] = replace(steps[-1], parameters=tuple(parameters(fits[-1])))
    adequate, why = run.adequate(steps[-1])
    return Outcome(tuple(steps), tuple(fits), adequate, why)


def _explains_nothing(run: Run) -> CannotTell:
    """Why the best model is no better than a constant: PV turns too fast for the samples, or OP does not drive it."""
    moves = np.sign(np.diff(run.used_y()))
    moves = moves[moves != 0]
    turns = int((moves[1:] != moves[:-1]).sum())
    per = 2.0 * run.used_y().size / max(turns, 1)
    step = run.loop.step_s
    if per < SAMPLES_PER_PERIOD:
        return CannotTell(f"sampled too slowly: the process value turns every {0.5 * per:.1f} samples of {step:g} s, "
                          f"{per:.1f} samples a period where {SAMPLES_PER_PERIOD} are needed, and no model explains it",
                          f"export at {per * step / SAMPLES_PER_PERIOD:.3g} s or faster", code="too-slow-sampling")
    return CannotTell("the best model explains nothing: its free-run error is no smaller than the scatter of y "
                      "about its mean", "check that OP drives this PV; look at the trend with stictionid read",
                      code="model-explains-nothing")


def _choose(run: Run, spec: Spec) -> tuple[Spec, tuple[FloatArray, FloatArray]]:
    """Process structure and what the command did between samples, by one search each; the best search so far."""
    if run.options.between != "auto" or not _smooth(run):
        best = _structure(run, spec)
    else:
        # Most plants hold their command: at the noise, a moving one is only looked at.
        best = _structure(run, spec)
        moving = replace(spec, between="corner", substeps=SUBSTEPS)
        if not _at_noise(run, best) or _moves_better(run, best, moving):
            run.tell("rebuilding the command between samples", 0.3)
            corner = _structure(run, moving)
            if _of_two(run, corner, best):
                best = corner
    return best.spec, (best.point[None], np.array([best.cost]))


def _moves_better(run: Run, held: _Tried, moving: Spec) -> bool:
    """Whether a command that moves between samples does better from the point where the held one ended."""
    assert held.evaluated is not None
    model = search_model(run.model(replace(moving, process=held.spec.process, increments=held.spec.increments,
                                           taps=held.spec.taps)))
    values = model.vector(held.evaluated.values)[:, None].repeat(3, axis=1)
    values[4] = np.maximum(values[4] + run.loop.step_s * np.array([0.0, 0.5, 1.0]), 0.0)
    found = descended(model, with_start(model, model.cube(values)), turns=_QUICK_TURNS, settle=_QUICK_SETTLE)
    return float(found.costs[0]) < held.cost


def _of_two(run: Run, corner: _Tried, held: _Tried) -> bool:
    """Whether the moving command is the better of two searches.

    Where neither reaches the noise, a second lag, not yet in the model, may round the slips and speak for the wrong
    one, so both may have it.
    """
    stationary = corner.spec.process == held.spec.process == FIRST_ORDER
    noisy = bool(corner.spec.taps or held.spec.taps)

    def error(e: Evaluated) -> float:
        # Plain differences of a noisy record are all noise: nothing could be 5 % better by them.
        return e.rmse if stationary else _soft_error(e) if noisy else increment_error(e)

    if _at_noise(run, corner) or _at_noise(run, held):
        return (corner.evaluated is not None and held.evaluated is not None
                and error(corner.evaluated) < error(held.evaluated))
    return _with_lag(run, corner, error) < (1.0 - _CORNER_GAIN) * _with_lag(run, held, error)


def _soft_error(e: Evaluated) -> float:
    """Root mean square of the softened differences of the free-run residual (see `SOFT`), in the unit of y."""
    soft = whiten(np.nan_to_num(e.residual)[:, None], Spec(increments=True, taps=SOFT).whitening())[:, 0]
    good = np.convolve(e.counted > 0, np.ones(len(SOFT) + 2))[:soft.size] > len(SOFT) + 1.5
    return float(np.sqrt(np.mean(soft[good] ** 2)))


def _with_lag(run: Run, tried: _Tried, error: Callable[[Evaluated], float]) -> float:
    """Error of a search, a second lag allowed where it helps."""
    if tried.evaluated is None:
        return np.inf
    if run.options.fixed or _LAG in tried.spec.effects:
        return error(tried.evaluated)
    coarse, quick = _first_look(run, run.model(tried.spec), tried.evaluated.values, _LAG)
    return min(error(tried.evaluated), error(coarse.evaluate(coarse.values(quick.points[:1])[:, 0])))


def _smooth(run: Run) -> bool:
    """Whether the command is smooth enough to be rebuilt between samples: a noisy one has no corners to find."""
    u = run.loop.output[run.loop.used]
    return noise_of(u) < _ROUGH * float(np.ptp(u))


def _first(run: Run, spec: Spec) -> _Tried:
    model = search_model(run.model(spec))
    point, cost = one_run(model, run.rng, near=run.basins(spec))
    if not np.isfinite(cost):
        return _Tried(spec, point, cost, None, np.inf)
    e = model.evaluate(model.values(point[None])[:, 0])
    return _Tried(spec, point, cost, e, increment_error(e))


def _structure(run: Run, spec: Spec) -> _Tried:
    """First order or integrator: where the lag is long, or leaves errors, the smaller one-step error decides.

    Each is completed with a noise model of its own, so that neither wins by its own yardstick. Where measurement noise
    fills the differences they are softened (see `SOFT`) for the fit of the integrator.
    """
    plain = spec if spec.process == FIRST_ORDER else replace(spec, process=FIRST_ORDER, increments=False, taps=())
    first = _first(run, plain)
    lag = first.evaluated.values["time_constant_s"] if first.evaluated else np.inf
    if "time_constant_s" in spec.fixed or (lag < LONG_LAG * run.period_s and _at_noise(run, first)):
        return first
    # Far from the noise a short lag says little: the valve may be in a wrong basin, and the lag with it.
    if lag < _ANY_LAG * run.period_s and _at_noise(run, first, _FAR):
        return first
    run.tell("trying an integrating process", 0.2)
    second = _first(run, replace(plain, process=INTEGRATOR, increments=True))
    if _noise_fills(run, second):
        second = _first(run, replace(second.spec, taps=SOFT))
    gain = -_ENDLESS_LOSS if lag > _ENDLESS_LAG * run.period_s else INTEGRATOR_GAIN
    return second if _one_step(run, second) < (1.0 - gain) * _one_step(run, first) else first


def _one_step(run: Run, tried: _Tried) -> float:
    """One-step error of a search with a noise model of its own: what levels and differences can be compared by.

    An autoregression on differences can't undo the differencing of white noise, so integrators may stay in levels.
    """
    if tried.evaluated is None:
        return np.inf
    models = [run.model(replace(tried.spec, taps=(), increments=False))]
    if tried.spec.increments:
        models.append(run.model(replace(tried.spec, taps=())))
    return min(whitened(m, m.vector(tried.evaluated.values)).innovation_sd for m in models)


def _noise_fills(run: Run, tried: _Tried) -> bool:
    """Whether the differences of the residual are mostly those of white measurement noise.

    Seen at the residual (correlation -1/2) where the search ended in the right basin, else at the record itself: a
    valve in the wrong basin leaves its own errors, and these made a noisy integrator be searched as a quiet one.
    """
    e = tried.evaluated
    if e is None:
        return False
    r = autocovariance(np.nan_to_num(e.innovation), e.counted > 0, 1)
    noise = noise_of(run.used_y())
    return bool(r[0] > 0 and (r[1] < _NOISY * r[0] or 2.0 * noise**2 > _NOISE_SHARE * tried.increments**2))


def _at_noise(run: Run, tried: _Tried, factor: float = ADEQUATE) -> bool:
    e = tried.evaluated
    floor = run.floor(e.position_means, e.values["dead_time_s"]) if e else None
    return e is not None and floor is not None and e.rmse <= factor * floor


def _try_resting(run: Run, steps: list[Step], fits: list[Fitted]) -> None:
    """Re-sticking as a step of its own, where a held command leaves errors and the valve may rest between its scans.

    A resting valve has its own basin in S, J and even in the process, which no search from the sliding one reaches;
    so the search starts where the law that rests at every sample (the effect's other end) ends.
    """
    before = fits[-1]
    spec = before.model.spec
    if before.model.law.sliding_state is None or run.adequate(steps[-1])[0]:
        return
    if spec.between != "hold":
        # Under a command that moves between samples the valve slides on most of the way: no basin of its own.
        _try_step(run, steps, fits, "re-sticking", _STEP_DROP, _STEP_BIC, _RESTING_TAKEN)
        return
    resting = _structure(run, replace(spec, law=_RESTING_LAW))
    floor = steps[-1].error.noise_sd
    if resting.evaluated is None or floor is None or resting.evaluated.rmse > _RESTING_TRIED * floor:
        return
    found = run.fit(resting.spec, before=(resting.point[None], np.array([resting.cost])))
    spec = replace(resting.spec, law=run.law, effects=(*spec.effects, "re-sticking"))
    model = run.model(spec)
    at = next(rows for rows, name in zip(model._slices, model.names, strict=True) if name == "re-sticking")
    guess = model.effects[model.names.index("re-sticking")].guess
    assert guess is not None
    speeds = guess(model.context)
    starts = np.array([model.vector(found.best.values)]).repeat(len(speeds), axis=0)
    starts[:, at] = speeds
    after = run.fit(spec, model.cube(starts.T))
    step = run.step(after, "re-sticking")
    was, now = steps[-1].error.rmse_holdout, step.error.rmse_holdout
    if was is None or now is None or now > (1.0 - _STEP_DROP) * was:
        return
    if step.error.rmse > _RESTING_TAKEN * (step.error.noise_sd or 0.0):
        return
    # Criteria of levels and of differences can't be compared; a change of structure must lower the error clearly.
    if spec.whitening().tolist() == before.model.spec.whitening().tolist():
        better = (steps[-1].error.bic or 0.0) - (step.error.bic or 0.0) > _STEP_BIC
    else:
        better = now < (1.0 - 3.0 * _STEP_DROP) * was
    if better:
        steps.append(step)
        fits.append(after)


def _try_noise(run: Run, steps: list[Step], fits: list[Fitted]) -> None:
    """An autoregression of the output error as a step of its own, where nothing but noise is left to explain.

    That is where the one-step error with it reaches what a free linear model of y and valve position reaches. Noise
    taken for white bends the process, and through it S, J and the order; so all of them are searched anew with it.
    Slow waves (a root near 1) are left to `diagnose`: drift and disturbances look like noise, too.
    """
    before = fits[-1]
    spec = before.model.spec
    if spec.taps or NOISE in spec.effects or before.best.rmse < _NO_NOISE * float(np.std(run.used_y())):
        return
    local = whitened(before.model, before.values)
    if not local.order or _slowest(local) > _SLOWEST_ROOT or not _even(local, 2.0):
        return
    base = tuple(name for name in fits[0].model.spec.effects)
    found = _noisy(run, replace(spec, effects=(*base, NOISE)), local)
    some, made = [run.step(found, NOISE)], [found]
    if _LAG not in base:
        _try_step(run, some, made, _LAG)
    last = whitened(made[-1].model, made[-1].values)
    floor = run.floor(made[-1].best.position_means, made[-1].best.values["dead_time_s"])
    if floor is None or last.innovation_sd > ADEQUATE * floor or _slowest(last) > _SLOWEST_ROOT or not _even(last):
        return
    if last.order:
        made[-1] = _noisy(run, made[-1].model.spec, last)
        some[-1] = run.step(made[-1], some[-1].added)
    one_step, now = fits[-1].sse / max(fits[-1].best.rows, 1), made[-1].sse / max(made[-1].best.rows, 1)
    rows, more = made[-1].best.rows, len(made[-1].values) - len(fits[-1].values) + last.order
    if rows * float(np.log(one_step / now)) - more * float(np.log(rows)) > _STEP_BIC:
        # What was added for white noise gives way to what coloured noise asks for.
        steps[1:], fits[1:] = some, made


def _noisy(run: Run, spec: Spec, noise: Whitened) -> Fitted:
    """The fit of a spec with the noise model of a whitened model, from that model's own point and from nothing."""
    noisy = replace(spec, taps=tuple(noise.model.spec.taps))
    model = run.model(noisy)
    start = model.cube(model.vector(noise.model.named(noise.values))[:, None])
    local = descended(model, start)
    return run.fit(noisy, before=(local.points, local.costs))


def _even(noise: Whitened, slack: float = 1.0) -> bool:
    """Whether innovations look like noise all along: no heavy tails, no stretch much louder than another.

    `slack` widens both limits: before the model was fitted with the noise its slips, too, are in the innovations.

    What physics leaves unexplained sits in places (at a travel limit, after a step, at the slips): a kurtosis of 9.6
    and a ratio of 12 were met where a travel limit was missing, 3.2 and 1.6 at most in simulated coloured noise.
    """
    x = noise.innovation[noise.good]
    loud = [float(np.mean(part**2)) ** 0.5 for part in np.array_split(x, _STRETCHES)]
    tails = float(np.mean(x**4)) / max(float(np.mean(x**2)) ** 2, 1e-300)
    return tails <= slack * _HEAVY and max(loud) <= slack * _UNEVEN * min(loud)


def _slowest(noise: Whitened) -> float:
    """The largest root of a noise model, by modulus."""
    return float(np.abs(np.roots(np.concatenate([[1.0], noise.model.spec.taps]))).max()) if noise.order else 0.0


def _try_step(run: Run, steps: list[Step], fits: list[Fitted], effect: str, least_drop: float = _LAG_DROP,
              least_bic: float = _LAG_BIC, within: float = np.inf) -> None:
    """Add `effect` as a step of its own where held-out error and BIC both fall by the least that is asked for.

    `within` is how many times the irreducible noise the error may be with it.
    """
    before = fits[-1]
    coarse, quick = _first_look(run, before.model, before.best.values, effect)
    # The look is taken on a coarser model than the fit: the base gets the same descent on the same model.
    base = search_model(before.model)
    same = descended(base, base.cube(before.values[:, None]), turns=_QUICK_TURNS, settle=_QUICK_SETTLE)
    if not quick.costs[0] < float(same.costs[0]) * (1.0 - _LOOK_DROP):
        return
    spec = replace(before.model.spec, effects=coarse.spec.effects)
    after = run.fit(spec, quick.points[:_QUICK_KEPT])
    step = run.step(after, effect)
    if before.rmse_holdout is None or after.rmse_holdout is None:
        return
    drop = 1.0 - after.rmse_holdout / before.rmse_holdout
    gain = (steps[-1].error.bic or 0.0) - (step.error.bic or 0.0)
    if drop > least_drop and gain > least_bic and step.error.rmse <= within * (step.error.noise_sd or np.inf):
        steps.append(step)
        fits.append(after)


def _whatever_the_order(run: Run, fit: Fitted) -> Fitted:
    """The fit with intervals that hold whether or not the process has a second lag too small to be named."""
    model, quick = _first_look(run, fit.model, fit.best.values, _LAG)
    jumps = None
    if fit.jumps is not None:
        values = model.values(quick.points[:1]).repeat(fit.jumps.shape[1], axis=1)
        values[:len(fit.jumps)] = fit.jumps
        jumps = model.cube(values)
    wide = region(model, quick.points[0], run.rng, jumps)
    names = {name: (min(low, wide[name][0]), max(high, wide[name][1]))
             for name, (low, high) in fit.intervals.items() if name in wide}
    return replace(fit, intervals={**fit.intervals, **names})


def _first_look(run: Run, before: Model, values: dict[str, float], effect: str) -> tuple[Model, Found]:
    """The model to search on with `effect` added, and what a short descent finds: from the model so far and anew.

    Made once for every structure.
    """
    key = f"{before.spec} {effect}"
    if key not in run.looks:
        run.looks[key] = _look(run, before, values, effect)
    return run.looks[key]


def _look(run: Run, before: Model, values: dict[str, float], effect: str) -> tuple[Model, Found]:
    model = search_model(run.model(replace(before.spec, effects=(*before.spec.effects, effect))))
    guess = model.effects[model.names.index(effect)].guess
    at = model._slices[model.names.index(effect)]
    guesses = guess(model.context) if guess is not None else np.zeros((1, at.stop - at.start))
    # What is missing bends S and J: fresh basins of the base, too, are tried with it.
    base = search_model(before)
    fresh = base.values(with_process(base, run.basins(before.spec)))
    starts = np.zeros((model.space.size, 1 + fresh.shape[1]))
    starts[:, 0], starts[:len(fresh), 1:] = model.vector(values), fresh
    starts = starts.repeat(len(guesses), axis=1)
    starts[at] = np.tile(guesses.T, starts.shape[1] // len(guesses))
    near = with_start(model, model.cube(starts))
    return model, descended(model, near, turns=_QUICK_TURNS, settle=_QUICK_SETTLE)


METHOD = Method(
    name="auto",
    summary="ARX finds the basin, the free-run error finishes; structure chosen, restarts must agree",
    equation="min over (S, J, e0, T, L) of ||y - K g(T, L) * u_v(S, J, e0) - b||^2 from the basins of Eq. 19",
    source="METHODS.md section 4; paper Eq. 7 to 21",
    checked="this project's own",
    cannot="anything missing from the model (see diagnose); J where the slide is short",
    run=_run, options=frozenset({"law", "effects", "base_only", "between", "fixed"}), restarts=True,
)
