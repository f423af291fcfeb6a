"""Which structure a record asks for: the process, and what the command did between its samples.

One search for each; the better one is kept. Source: METHODS.md section 4, traps 4 and 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import CannotTell, UsageError
from ..fit.context import ADEQUATE, INTEGRATOR_GAIN, LONG_LAG, Run, increment_error
from ..fit.fit import Fitted, held_out_error, one_run
from ..fit.intervals.thresholds import plateaus
from ..fit.moves import behind_valve, descended, search_model, thinned, thinning, with_start
from ..fit.noise.prewhitening import whitened
from ..fit.starts.basins import along_ridge, grown, with_process
from ..fit.starts.intersample import QUICK_SETTLE, QUICK_TURNS, as_moving, may_move, moved, surely_moves
from ..model.model import Model
from ..model.spec import FIRST_ORDER, INTEGRATOR, Evaluated, Spec
from ..numerics.autoregression import autocovariance, linked
from ..numerics.population import Found, together
from ..numerics.varpro import whiten
from ..process.scan import DECIMATED, parts_of, pi_law, ran_between
from ..record.loop import Finding
from ..record.oscillation import noise_of
from ..record.preconditions import SAMPLES_PER_PERIOD
from ..typing import FloatArray

LAG = "extra-lag"
# First look at a step: how many starts go on after the first turns of descent, and how many these are.
QUICK_KEPT, _GLANCE = 4, 2
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
# An integrator whose free run leaves y by more than y moves does not win against a process that follows y to within the
# second of these: a valve in a wrong basin may help it to predict a step ahead. Unit: standard deviations of y.
_RUNS_AWAY, _FOLLOWS = 1.0, 0.5
# Nor does one whose free-run error is so many times that of a process that follows y to within the second share.
_TIMES, _CLOSELY = 4.0, 0.15
# Share of the cost by which another step of S must do better in a first look to be gone on with. Unit: 1.
_STEP_AWAY = 0.01
# The command is taken as continuous only when that lowers the free-run error by this share; where one way leaves less
# than the second share of the other's error a further lag can't change which is better: the most it took was half.
_CORNER_GAIN, _CLEARLY = 0.05, 1.0 / 3.0
# Noise of the scans in between, as a share of the pace of the output, beyond which S and J come out wrong. Measured
# with every third to tenth of the 1 s scans exported: up to 0.3 S within 3 %, from 0.4 on off by 10 to 20 %. Unit: 1.
_CHATTER, _SCANS_UNKNOWN = 0.35, 3
# Records that grow where a valve rests at every sample, each from a scan of its own: one in ten misses the basin.
_GROWS = 2
# The error beyond which a law is searched no further, in times of what another one leaves: by the first search where
# that one is at the noise, and once the record grew. With the law that rests beside the sliding valve: on 180 Karnopp
# valves, noise 1 to 5 %, white and AR(1), at most 1.54 and 1.0; on 42 that slide 1.2 to 10. Unit: 1.
_FAR_WORSE, _WORSE = 2.0, 1.5
# Searches with the course of y between samples taken from the one before. Measured on loops with a 1 s scan exported
# every 5 s: S off by up to 5, 3 and 0.5 % with none, one and two; every 10 s, J by up to 40, 8 and 3 %.
_GUIDED = 2
# Stickbands tried with a dead time that is a scan longer or shorter, as shares of the one found. Unit: 1.
_NEAR_S = np.linspace(0.95, 1.05, 81)
# Below this share of the period a lag is no integrator in disguise, unless the error is this many times the noise.
_ANY_LAG, _FAR = 0.2, 2.5


@dataclass(frozen=True, slots=True)
class TriedStructure:
    """One search with one structure: its best point of the unit cube (d,), cost and curves.

    One that was left early, since a command that moves between samples did clearly better, has that one's `rival`
    points (k, d).
    """

    spec: Spec
    point: FloatArray
    cost: float
    evaluated: Evaluated | None
    increments: float
    rival: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of another law with a first-order process: its free-run error, in the unit of y.

    `at_noise` says that the error may be noise alone: then no law leaves much less, and one that is far from it is
    wrong. Else both may be wrong, and the first search of one that is right may have missed its basin by any distance.
    """

    rmse: float
    at_noise: bool

    def beats(self, tried: TriedStructure, times: float = _WORSE) -> bool:
        """Whether a search leaves so many `times` more that this law can't be the better one."""
        return tried.evaluated is None or tried.evaluated.rmse > times * self.rmse


def choose(run: Run, spec: Spec) -> tuple[Spec, tuple[FloatArray, FloatArray], tuple[Finding, ...]]:
    """Process structure and what the command did between samples: the best search so far, and what must be said."""
    if run.options.between == DECIMATED:
        best = _scanned(run, replace(spec, substeps=_scans(run)))
        return best.spec, (best.point[None], np.array([best.cost])), (_said_scans(run, best.spec.substeps),)
    # Most plants hold their command: at the noise, a moving one is only looked at, unless it moves beyond doubt.
    moving, auto = as_moving(spec), run.options.between == "auto"
    sure = auto and surely_moves(run.loop)
    smooth = auto and not sure and may_move(run.loop)
    best = structure(run, moving if sure else spec, rival=moving if smooth else None)
    notes: tuple[Finding, ...] = ()
    if auto:
        corner = None
        if best.rival is not None:
            run.tell("rebuilding the command between samples", 0.3)
            corner = structure(run, moving, starts=best.rival)
            if not _clearly(corner, best):
                best = structure(run, spec)
        if smooth and (corner is not None or not near_noise(run, best) or _moves_better(run, best, moving)):
            run.tell("rebuilding the command between samples", 0.3)
            corner = structure(run, moving) if corner is None else corner
            if _of_two(run, corner, best):
                held = _looked_again(run, best, corner)
                best = corner if held is best or _of_two(run, corner, held) else held
        scans = parts_of(run.loop.step_s, run.options.scan_s)
        if scans > 1 and ran_between(run.loop, scans):
            run.tell("rebuilding the scans between samples", 0.4)
            slow = _scanned(run, replace(spec, between=DECIMATED, substeps=scans))
            chatter = _chatter(run, slow.evaluated, scans)
            errors = _held_out(run, slow), _held_out(run, best)
            if chatter > _CHATTER:
                notes = (_said_chatter(run, scans, chatter),)
            elif errors[0] < errors[1]:
                best, notes = slow, (_said_scans(run, scans, errors),)
    return best.spec, (best.point[None], np.array([best.cost])), notes


def _scans(run: Run) -> int:
    """How many scans `--between decimated` rebuilds in a sample; UsageError where there are none between samples."""
    scans = parts_of(run.loop.step_s, run.options.scan_s)
    if scans < 2:
        raise UsageError(f"--between decimated: the record's step of {run.loop.step_s:g} s is no slower than the "
                         f"controller's scan of {run.options.scan_s:g} s",
                         "leave --between out, or give the scan with --scan SECONDS")
    return scans


def _scanned(run: Run, spec: Spec) -> TriedStructure:
    """The search with the command rebuilt at the scans, twice more with the course of y that it found in between."""
    tried = structure(run, spec)
    if len(run.loop.starts) > 1:
        return tried  # a guide belongs to one stretch
    for _ in range(_GUIDED):
        if tried.evaluated is None:
            break
        model = run.model(tried.spec)
        guide = model.guide(model.vector(tried.evaluated.values))
        tried = _first(run, replace(tried.spec, guides=(*tried.spec.guides, guide)), tried.point)
    return tried if tried.evaluated is None else _beside(run, tried)


def _beside(run: Run, tried: TriedStructure) -> TriedStructure:
    """A search with a guide, or what a scan of dead time away does better with the course of y that belongs there.

    With the guide of a wrong dead time the wrong one stays the best.
    """
    best, model = tried, run.model(tried.spec)
    values = model.values(tried.point[None]).repeat(_NEAR_S.size, axis=1)
    values[0] *= _NEAR_S
    values[1] *= _NEAR_S
    for scans in (-1, 1):
        near = values.copy()
        near[4] = np.maximum(near[4] + scans * model.step_s / model.spec.substeps, 0.0)
        cube = model.cube(near)
        point, there, spec = cube[model.costs(cube).argmin()], model, tried.spec
        for _ in range(_GUIDED):
            guide = there.guide(there.values(point[None])[:, 0])
            spec = replace(spec, guides=(*spec.guides[:-1], guide))
            there = search_model(run.model(spec))
            found = descended(there, with_start(there, point[None]), turns=QUICK_TURNS, settle=QUICK_SETTLE)
            point, cost = found.points[0], float(found.costs[0])
        if cost < best.cost:
            e = there.evaluate(there.values(point[None])[:, 0])
            best = TriedStructure(spec, point, cost, e, increment_error(e))
    return best


def _held_out(run: Run, tried: TriedStructure) -> float:
    """Held-out error of a search in the unit of y."""
    if tried.evaluated is None:
        return np.inf
    model = run.model(tried.spec)
    error = held_out_error(model, tried.point, run.rng)
    if error is None:
        return tried.evaluated.rmse
    inner = float(np.sqrt(tried.cost / max(tried.evaluated.rows, 1)))
    return tried.evaluated.rmse * error / inner if model.taps.size and inner else error


def _said_scans(run: Run, scans: int, errors: tuple[float, float] | None = None) -> Finding:
    """What is said of a command rebuilt at `scans` scans a sample; `errors` are held out, with it and before."""
    law, step = pi_law(run.loop, scans), run.loop.step_s
    how = ("its corners, because r and y do not give its PI law" if law is None else
           f"the PI law read from r, y and u (gain {law.gain:.3g}, integral time "
           f"{law.gain / law.per_scan * step / scans:.3g} s)")
    why = "" if errors is None else f"; that lowers the held-out error from {errors[1]:.4g} to {errors[0]:.4g}"
    return Finding("scans-between-samples", "info",
                   f"the controller is taken to scan every {step / scans:.3g} s and the export to keep one scan in "
                   f"{scans}: the output in between is rebuilt from {how}{why}",
                   {"scans": scans, "scan_s": step / scans, "gain": law.gain if law else None,
                    "integral_time_s": law.gain / law.per_scan * step / scans if law else None}, (),
                   "METHODS.md section 4, trap 4")


def _chatter(run: Run, e: Evaluated | None, scans: int) -> float:
    """How far noise moves u from scan to scan, as a share of how far u goes anyway; 0 where that can be rebuilt.

    Every second scan exported tells the one in between exactly, noise and all.
    """
    law = pi_law(run.loop, scans)
    floor = run.floor(e.position_means, e.values["dead_time_s"]) if e is not None else None
    pace = float(np.median(np.abs(np.diff(run.loop.output[run.loop.driven])))) / scans
    if law is None or floor is None or scans < _SCANS_UNKNOWN or not pace > 0.0:
        return 0.0
    return abs(law.gain) * floor / pace


def _said_chatter(run: Run, scans: int, chatter: float) -> Finding:
    step = run.loop.step_s
    return Finding("scans-too-noisy", "warning",
                   f"if the controller scans every {step / scans:.3g} s, one scan in {scans} was exported; in "
                   f"between, noise moves the output {chatter:.2g} times as far as it goes anyway: the valve stops and "
                   "starts unseen: S may be off by a fifth, J is hardly known, and intervals would only say how well "
                   "the samples fit, so none are given",
                   {"scans": scans, "noise_to_pace": chatter, "limit": _CHATTER, "no_intervals": True}, (),
                   "benchmarks/decimation.py")


def check_scans(run: Run, fit: Fitted) -> None:
    """CannotTell where the valve of a rebuilt command moves so often between samples that they can't show how."""
    model = fit.model
    if model.spec.between != DECIMATED:
        return
    scans, values = model.spec.substeps, fit.values
    chatter = _chatter(run, fit.best, scans)
    if chatter > _CHATTER:
        raise CannotTell(
            f"the valve moves several times between samples: noise moves the output {chatter:.2g} times as far from "
            f"scan to scan as it goes anyway ({_CHATTER:g} is the most), and one scan in {scans} was exported",
            f"export at {2.0 * run.loop.step_s / scans:.3g} s or faster", code="moves-between-samples")
    moves = np.sign(np.diff(model.positions(values[:, None])[:, 0]))
    moves = moves[moves != 0]
    turns = int((moves[1:] != moves[:-1]).sum())
    per = 2.0 * run.loop.samples / max(turns, 1)
    if per < SAMPLES_PER_PERIOD:
        raise CannotTell(
            f"the valve moves between samples: it turns every {0.5 * per:.1f} samples of {run.loop.step_s:g} s, "
            f"{per:.1f} samples a period where {SAMPLES_PER_PERIOD} are needed",
            f"export at {per * run.loop.step_s / SAMPLES_PER_PERIOD:.3g} s or faster", code="moves-between-samples")


def _moves_better(run: Run, held: TriedStructure, moving: Spec) -> bool:
    """Whether a command that moves between samples does better from the point where the held one ended."""
    assert held.evaluated is not None
    model = run.model(held.spec)
    return float(moved(model, model.vector(held.evaluated.values), moving).costs[0]) < held.cost


def _looked_again(run: Run, held: TriedStructure, corner: TriedStructure) -> TriedStructure:
    """The search for a held command, or what it misses: the point beside the end of the moving one, if that is better.

    A held search that ended beside its basin would lose to a moving command that can't reach the noise either. Met on
    a scanned loop with 1 of 16 seeds: dead time off by a sample, 1.5 times the noise.
    """
    if corner.spec.process != held.spec.process or _clearly(corner, held):
        return held
    model = search_model(run.model(held.spec))
    near = np.concatenate([corner.point[None], along_ridge(model, corner.point[None])])
    found = descended(model, with_start(model, near))
    if not found.costs[0] < held.cost:
        return held
    e = model.evaluate(model.values(found.points[:1])[:, 0])
    return TriedStructure(held.spec, found.points[0], float(found.costs[0]), e, increment_error(e))


def _of_two(run: Run, corner: TriedStructure, held: TriedStructure) -> bool:
    """Whether the moving command is the better of two searches.

    Where neither reaches the noise, a second lag, not yet in the model, may round the slips and speak for the wrong
    one, so both may have it.
    """
    error = _yardstick(corner, held)
    if near_noise(run, corner) or near_noise(run, held):
        return (corner.evaluated is not None and held.evaluated is not None
                and error(corner.evaluated) < error(held.evaluated))
    if _clearly(corner, held) or _clearly(held, corner):
        return _clearly(corner, held)
    return _with_lag(run, corner, error) < (1.0 - _CORNER_GAIN) * _with_lag(run, held, error)


def _yardstick(corner: TriedStructure, held: TriedStructure) -> Callable[[Evaluated], float]:
    """The error by which two searches are compared."""
    if corner.spec.process == held.spec.process == FIRST_ORDER:
        return lambda e: e.rmse
    # Plain differences of a noisy record are all noise: nothing could be 5 % better by them.
    return _soft_error if corner.spec.taps or held.spec.taps else increment_error


def _clearly(better: TriedStructure, worse: TriedStructure) -> bool:
    """Whether one search leaves so much less than another that no further lag could turn that round."""
    if better.evaluated is None or worse.evaluated is None:
        return False
    error = _yardstick(better, worse)
    return error(better.evaluated) < _CLEARLY * error(worse.evaluated)


def _soft_error(e: Evaluated) -> float:
    """Root mean square of the softened differences of the free-run residual (see `SOFT`), in the unit of y."""
    taps, links = Spec(increments=True, taps=SOFT).whitening(), linked(e.counted > 0, e.starts)
    soft = whiten(np.nan_to_num(e.residual)[:, None], taps, None if links is None else links.before)[:, 0]
    good = (np.convolve(e.counted > 0, np.ones(len(SOFT) + 2))[:soft.size] > len(SOFT) + 1.5 if links is None else
            links.reached(taps.size))
    return float(np.sqrt(np.mean(soft[good] ** 2)))


def _with_lag(run: Run, tried: TriedStructure, error: Callable[[Evaluated], float]) -> float:
    """Error of a search, a second lag allowed where it helps."""
    if tried.evaluated is None:
        return np.inf
    if run.options.fixed or LAG in tried.spec.effects:
        return error(tried.evaluated)
    coarse, quick = first_look(run, run.model(tried.spec), tried.evaluated.values, LAG)
    return min(error(tried.evaluated), error(coarse.evaluate(coarse.values(quick.points[:1])[:, 0])))


def _first(run: Run, spec: Spec, known: FloatArray | None = None, starts: FloatArray | None = None,
           rival: Spec | None = None) -> TriedStructure:
    """One search from the basins, or from `starts`; a `known` point (d,) of a similar model is polished beside it.

    It ends early where a `rival` whose command moves between samples does clearly better from the same point.
    """
    model = search_model(run.model(spec))
    rivals: list[FloatArray] = []

    def enough(point: FloatArray, cost: float) -> bool:
        assert rival is not None
        found = moved(model, model.values(point[None])[:, 0], rival)
        if found.costs[0] < _CLEARLY**2 * cost:
            rivals.append(found.points)
        return bool(rivals)

    near = run.basins(spec) if starts is None else None
    point, cost = one_run(model, run.rng, starts, near, None if rival is None else enough)
    if known is not None:
        again = descended(model, with_start(model, known[None]))
        if again.costs[0] < cost:
            point, cost = again.points[0], float(again.costs[0])
    if not np.isfinite(cost):
        return TriedStructure(spec, point, cost, None, np.inf)
    e = model.evaluate(model.values(point[None])[:, 0])
    return TriedStructure(spec, point, cost, e, increment_error(e), rivals[0] if rivals else None)


def structure(run: Run, spec: Spec, starts: FloatArray | None = None, rival: Spec | None = None,
              known: Known | None = None) -> TriedStructure:
    """First order or integrator: where the lag is long, or leaves errors, the smaller one-step error decides.

    Each is completed with a noise model of its own, so that neither wins by its own yardstick. Where measurement noise
    fills the differences they are softened (see `SOFT`) for the fit of the integrator. `starts` (k, d) stand for the
    basins of the first order, whose search ends early where a `rival` is clearly better (see `_first`), and that
    for both where what is `known` of another law is.
    """
    plain = spec if spec.process == FIRST_ORDER else replace(spec, process=FIRST_ORDER, increments=False, taps=())
    first = _first(run, plain, starts=starts, rival=rival)
    if first.rival is not None or (known is not None and known.at_noise and known.beats(first, _FAR_WORSE)):
        return first
    first = _of_resting(run, first, known)
    if known is not None and known.beats(first):
        return first
    lag = first.evaluated.values["time_constant_s"] if first.evaluated else np.inf
    if "time_constant_s" in spec.fixed or (lag < LONG_LAG * run.period_s and near_noise(run, first)):
        return first
    # Far from the noise a short lag says little: the valve may be in a wrong basin, and the lag with it.
    if lag < _ANY_LAG * run.period_s and near_noise(run, first, _FAR):
        return first
    run.tell("trying an integrating process", 0.2)
    second = integrating(run, plain)
    if lag > _ENDLESS_LAG * run.period_s:
        gain = -_ENDLESS_LOSS
    elif _runs_away(run, second, first):
        return first
    else:
        gain = INTEGRATOR_GAIN
    return second if _one_step(run, second) < (1.0 - gain) * _one_step(run, first) else first


def integrating(run: Run, plain: Spec) -> TriedStructure:
    """The search with an integrator in place of a `plain` first-order process."""
    found = _first(run, replace(plain, process=INTEGRATOR, increments=True))
    if _noise_fills(run, found):
        found = _first(run, replace(found.spec, taps=SOFT))
    # Slips add up: the basin is narrow, and the ARX cost of a valve far from it misleads.
    for _ in range(_GROWS if run.model(found.spec).law.sliding_state is None else 1):
        if near_noise(run, found, _FAR):
            break
        again = _first(run, found.spec, starts=grown(search_model(run.model(found.spec)), run.rng))
        found = again if again.cost < found.cost else found
    return found


def other_process(run: Run, spec: Spec) -> TriedStructure:
    """The search with the process that a spec does not have: an integrator for a first order, or the other way."""
    plain = replace(spec, process=FIRST_ORDER, increments=False, taps=(), guides=())
    return integrating(run, plain) if spec.process == FIRST_ORDER else _first(run, plain)


def _of_resting(run: Run, first: TriedStructure, known: Known | None = None) -> TriedStructure:
    """A search for a valve that rests at every sample, or what a record that grows finds, where the first is not at
    the noise; it grows but once where what is `known` of another law stays clearly better.

    Such a valve breaks away several times a stroke, and J decides when: its basin is as narrow as an integrator's.
    The time constant of a search in a wrong basin is good enough to scan with. Measured on 11 Karnopp valves that
    rest, two seeds each: 20 of 22 found, 7 by the first search.
    """
    model = run.model(first.spec)
    if model.law.sliding_state is not None or first.spec.between != "hold" or first.evaluated is None \
            or near_noise(run, first):
        return first
    small = thinned(model, max(thinning(model) // 2, 1))
    for _ in range(_GROWS):
        found = grown(small, run.rng, first.evaluated.values["time_constant_s"])
        again = _first(run, first.spec, starts=model.cube(small.values(found)))
        first = again if again.cost < first.cost else first
        if near_noise(run, first, _FAR) or first.evaluated is None or (known is not None and known.beats(first)):
            break
    return first


def _runs_away(run: Run, integrator: TriedStructure, first: TriedStructure) -> bool:
    """Whether the integrator's free run leaves y altogether, and that of the first order does not."""
    if integrator.evaluated is None or first.evaluated is None:
        return False
    moves = float(np.std(run.used_y()))
    away, error = integrator.evaluated.rmse, first.evaluated.rmse
    return (away > _RUNS_AWAY * moves and error < _FOLLOWS * moves) or (away > _TIMES * error and
                                                                       error < _CLOSELY * moves)


def _one_step(run: Run, tried: TriedStructure) -> float:
    """One-step error of a search with a noise model of its own: what levels and differences can be compared by.

    An autoregression on differences can't undo the differencing of white noise, so integrators may stay in levels.
    """
    if tried.evaluated is None:
        return np.inf
    models = [run.model(replace(tried.spec, taps=(), increments=False))]
    if tried.spec.increments:
        models.append(run.model(replace(tried.spec, taps=())))
    return min(whitened(m, m.vector(tried.evaluated.values)).innovation_sd for m in models)


def _noise_fills(run: Run, tried: TriedStructure) -> bool:
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


def near_noise(run: Run, tried: TriedStructure, factor: float = ADEQUATE) -> bool:
    return tried.evaluated is not None and _is_noise(run, tried.evaluated, factor)


def _is_noise(run: Run, e: Evaluated, factor: float = ADEQUATE) -> bool:
    """Whether a free-run error is within so many times the irreducible noise."""
    floor = run.floor(e.position_means, e.values["dead_time_s"])
    return floor is not None and e.rmse <= factor * floor


def first_look(run: Run, before: Model, values: dict[str, float], effect: str) -> tuple[Model, Found]:
    """The model to search on with `effect` added, and what a short descent finds: from the model so far and, where that
    leaves more than the noise, anew.

    Made once for every structure.
    """
    key = f"{before.spec} {effect}"
    if key not in run.looks:
        run.looks[key] = _look(run, before, values, effect)
    return run.looks[key]


def _look(run: Run, before: Model, values: dict[str, float], effect: str) -> tuple[Model, Found]:
    model = search_model(run.model(replace(before.spec, effects=(*before.spec.effects, effect))))
    guess = model.effects[model.names.index(effect)].guess
    at = model.rows_of(effect)
    guesses = guess(model.context) if guess is not None else np.zeros((1, at.stop - at.start))
    # What is missing bends S and J: fresh basins of the base, too, are tried with it. At the noise nothing is bent.
    base, settled = search_model(before), _is_noise(run, before.evaluate(before.vector(values)))
    fresh = base.values(base.cube(np.empty((base.space.size, 0))) if settled else
                        with_process(base, run.basins(before.spec)))
    same = np.repeat(model.vector(values)[:, None], len(guesses), axis=1)
    same[at] = guesses.T
    starts = np.concatenate([same, _with_guesses(model, at, guesses, fresh)], axis=1)
    near = descended(model, with_start(model, model.cube(starts)), turns=_GLANCE, settle=QUICK_SETTLE).points
    if model.effects[model.names.index(effect)].dynamics is not None:
        behind = behind_valve(model, model.cube(same), at, turns=QUICK_TURNS, settle=QUICK_SETTLE)
        near = np.concatenate([behind.points[:1], near])
    found = descended(model, near[:QUICK_KEPT], turns=QUICK_TURNS - _GLANCE, settle=QUICK_SETTLE)
    if effect != LAG or not model.spec.held or settled:
        return model, found
    if before.spec.process == FIRST_ORDER and not _is_noise(run, model.evaluate(model.values(found.points[:1])[:, 0])):
        # Nor may any basin of one lag be near: valves that were looked for whatever the process does.
        valves = base.values(with_process(base, run.open_valves(before.spec)))
        starts = with_start(model, model.cube(_with_guesses(model, at, guesses, valves)))
        more = descended(model, descended(model, starts, turns=_GLANCE, settle=QUICK_SETTLE).points[:QUICK_KEPT],
                         turns=QUICK_TURNS - _GLANCE, settle=QUICK_SETTLE)
        found = together(found, more)
    # A missing lag makes the dead time too long and, through it, S too small, by several samples: a step away each.
    steps = plateaus(model, found.points[0])
    if steps is None or not steps.costs.min() < found.costs[0] * (1.0 - _STEP_AWAY):
        return model, found
    more = descended(model, steps.points[[steps.costs.argmin()]], turns=QUICK_TURNS - _GLANCE, settle=QUICK_SETTLE)
    return model, together(found, more)


def _with_guesses(model: Model, at: slice, guesses: FloatArray, values: FloatArray) -> FloatArray:
    """Values (d, P*k) of a model with an effect more, from those (fewer, P) without it and guesses (k, numbers)."""
    starts = np.zeros((model.space.size, values.shape[1]))
    starts[:len(values)] = values
    starts = starts.repeat(len(guesses), axis=1)
    starts[at] = np.tile(guesses.T, values.shape[1])
    return starts
