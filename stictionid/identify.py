"""From a record to S and J, or to the reason why they can't be told.

`identify` checks what the record can hold (gates), finds period and S_max, fits the base model (Chen's law, first
order with dead time or integrator with lag, white output noise), decides what the command did between samples and
whether the process integrates, and adds a further lag as a step of its own where the data ask for it.
Source: METHODS.md section 4.
"""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from . import laws as law_room
from ._version import __version__
from .arx import Arx, continuous
from .errors import CannotTell, UsageError
from .fit import (
    INTERVAL_LEVEL, Fitted, effective_rows, finish, one_run, process_costs, search, search_model, with_process,
)
from .gates import check, swing_of, time_scale_s
from .loop import Finding, FloatArray, Loop
from .model import FIRST_ORDER, INTEGRATOR, Evaluated, Model, Spec, skipped
from .noise import irreducible
from .oscillation import find_range, noise_of
from .position import from_position
from .regression import bic
from .results import (
    CostMap, CreatedBy, DataRecord, ErrorSummary, Estimate, ParameterValue, Range, Restarts, Step, Study, Verdict,
)
from .search import refine, swarm

METHODS = ("auto", "arx")
BETWEEN = ("auto", "hold", "corner")
# Parts of a sampling interval when the command moves between samples.
SUBSTEPS = 8
# A step of its own must lower the held-out error by this share and BIC by this much (CRITICISM.md section 7).
_STEP_DROP, _STEP_BIC = 0.03, 20.0
# Sample-to-sample noise of the command, as a share of its swing, above which nothing is rebuilt between samples.
_ROUGH = 2e-3
# The command is taken as continuous only when that lowers the free-run error by this share.
_CORNER_GAIN = 0.05
# A lag beyond this share of the period looks like an integrator; that must then lower the error of differences so much.
_LONG_LAG, _INTEGRATOR_GAIN = 0.75, 0.02
# Free-run error within this factor of the irreducible noise is adequate (CRITICISM.md section 7, step 1).
ADEQUATE = 1.05
# Share of PV's variance that friction must explain, and drop of the error, for "stiction"; below the second pair
# "no stiction" (provisional calibration on METHODS.md section 4's real records).
_STICKS, _CLEAN = (0.02, 0.15), (0.005, 0.05)
_MAP_S, _MAP_J = 41, 31
_FEWEST_FOR_TRUST = 10

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Options:
    """How to identify; see the command's help. `fixed` may hold gain, time_constant_s and dead_time_s."""

    method: str = "auto"
    law: str = "chen"
    effects: tuple[str, ...] = ()
    base_only: bool = False
    between: str = "auto"
    fixed: dict[str, float] = field(default_factory=dict)
    seed: int = 0
    order: int = 2
    delay: int | None = None
    command: str = ""

    def check(self) -> None:
        """Refuse values that do not exist, naming those that do."""
        if self.method not in METHODS:
            raise UsageError(f"unknown method '{self.method}'", "methods: " + ", ".join(METHODS))
        if self.between not in BETWEEN:
            raise UsageError(f"unknown way between samples '{self.between}'", "choose one of " + ", ".join(BETWEEN))
        if not 1 <= self.order <= 6:
            raise UsageError(f"--order {self.order} is outside 1 to 6", "give 1 or 2")
        if self.delay is not None and self.delay < 0:
            raise UsageError(f"--delay {self.delay} is negative", "give the dead time in samples, 0 or more")
        if not law_room.get(self.law).searchable:
            raise UsageError(f"the law '{self.law}' simulates only, it can't be searched",
                             "searchable: " + ", ".join(n for n, x in law_room.catalogue().items() if x.searchable))
        for name, value in self.fixed.items():
            if not np.isfinite(value) or (name != "gain" and value < 0) or (name == "gain" and value == 0):
                raise UsageError(f"--{name.removesuffix('_s').replace('_', '-')} {value:g} is out of range",
                                 "give a positive number")


def identify(loop: Loop, *, options: Options | None = None, progress: Progress | None = None) -> Study:
    """S, J, process, errors and verdict of one loop as a study; an abstention is a study too, with its reason.

    Deterministic for a seed. Raises UsageError for options that do not exist. Needs u and y; r where it is given.
    """
    options = options or Options()
    options.check()
    tell = progress or (lambda text, share: None)
    tell("looking for the oscillation", 0.02)
    found = find_range(loop)
    piece, notes = _whole(loop)
    try:
        check(piece, found)
        rng = np.random.default_rng(options.seed)
        run = _Run(piece, found, options, rng, tell)
        steps, fits, adequate, why = run.arx() if options.method == "arx" else run.auto()
    except CannotTell as reason:
        return _abstained(loop, found, options, reason)
    last = fits[-1]
    unit = loop.unit("output", "%")
    position = from_position(piece, law=options.law, s_max=swing_of(piece, found), rng=rng)
    verdict = run.verdict(last)
    tell("done", 1.0)
    return Study(_made(options), _data(loop, piece, notes), found, verdict,
                 _estimate(last, options, unit, steps[-1], position, run.arx_process), tuple(steps), adequate=adequate,
                 adequate_reason=why, cost_map=_cost_map(last), command=options.command)


def _whole(loop: Loop) -> tuple[Loop, tuple[Finding, ...]]:
    piece = loop.longest_segment()
    if piece.samples == loop.samples:
        return piece, ()
    return piece, (Finding("longest-segment", "info",
                           f"the record has {len(loop.starts)} stretches; the longest, {piece.samples} of "
                           f"{loop.samples} samples, is used", {"segments": len(loop.starts)}),)


@dataclass(frozen=True, slots=True)
class _Tried:
    """One search with one structure: its best point of the unit cube (d,), cost and curves."""

    spec: Spec
    point: FloatArray
    cost: float
    evaluated: Evaluated | None
    increments: float


class _Run:
    """One identification on one stretch: what its stages share."""

    def __init__(self, loop: Loop, found: Range, options: Options, rng: np.random.Generator, tell: Progress) -> None:
        self.loop, self.found, self.options, self.rng, self.tell = loop, found, options, rng, tell
        self.period_s, self.s_max = time_scale_s(loop, found), swing_of(loop, found)
        self.arx_process: tuple[float, tuple[float, ...], float, bool] | None = None

    def model(self, spec: Spec) -> Model:
        return Model(self.loop, spec, s_max=self.s_max, period_s=self.period_s)

    def auto(self) -> tuple[list[Step], list[Fitted], bool, str]:
        """Base model with its process and between-samples choice, then what the data ask for beyond it."""
        o = self.options
        spec = Spec(law=o.law, effects=o.effects, fixed=dict(o.fixed),
                    between="hold" if o.between == "auto" else o.between,
                    substeps=SUBSTEPS if o.between == "corner" else 1)
        self.tell("searching (S, J)", 0.1)
        spec, runs = self._choose(spec)
        self.tell("restarting until two searches agree", 0.5)
        fit = self._fit(spec, before=runs)
        if fit.best.rmse > 0.995 * float(np.std(self._used_y())):
            raise CannotTell("the best model explains nothing: its free-run error is no smaller than the scatter of y "
                             "about its mean", "check that OP drives this PV; look at the trend with stictionid read",
                             code="model-explains-nothing")
        steps, fits = [self._step(fit, None)], [fit]
        if not o.base_only and "extra-lag" not in spec.effects and not o.fixed:
            self.tell("trying a further lag", 0.7)
            self._try_step(steps, fits, "extra-lag")
        adequate, why = self._adequate(fits[-1], steps[-1])
        return steps, fits, adequate, why

    def _used_y(self) -> FloatArray:
        return self.loop.process_value[self.loop.used]

    def _fit(self, spec: Spec, starts: FloatArray | None = None,
             before: tuple[FloatArray, FloatArray] | None = None) -> Fitted:
        model = self.model(spec)
        points, costs = search(model, self.rng, starts=starts, before=before)
        if not np.isfinite(costs[0]):
            raise CannotTell("no valve model moves under this command", "look at the trend with stictionid read",
                             code="valve-never-moves")
        return finish(model, points, costs, self.rng)

    def _choose(self, spec: Spec) -> tuple[Spec, tuple[FloatArray, FloatArray]]:
        """Process structure and what the command did between samples, by one search each; the best search so far."""
        best = self._structure(spec)
        if self.options.between == "auto" and self._smooth() and not self._at_noise(best):
            self.tell("rebuilding the command between samples", 0.3)
            moving = self._structure(replace(best.spec, between="corner", substeps=SUBSTEPS))
            if moving.increments < (1.0 - _CORNER_GAIN) * best.increments:
                best = moving
        return best.spec, (best.point[None], np.array([best.cost]))

    def _smooth(self) -> bool:
        """Whether the command is smooth enough to be rebuilt between samples: a noisy one has no corners to find."""
        u = self.loop.output[self.loop.used]
        return noise_of(u) < _ROUGH * float(np.ptp(u))

    def _first(self, spec: Spec) -> _Tried:
        model = search_model(self.model(spec))
        point, cost = one_run(model, self.rng)
        if not np.isfinite(cost):
            return _Tried(spec, point, cost, None, np.inf)
        e = model.evaluate(model.values(point[None])[:, 0])
        return _Tried(spec, point, cost, e, _increment_error(e))

    def _structure(self, spec: Spec) -> _Tried:
        """First order or integrator: where the lag is long, the smaller error of the differences decides.

        Differences are stationary for both, so that neither wins by its own yardstick.
        """
        first = self._first(spec if spec.process == FIRST_ORDER else replace(spec, process=FIRST_ORDER,
                                                                             increments=False))
        lag = first.evaluated.values["time_constant_s"] if first.evaluated else np.inf
        if "time_constant_s" in spec.fixed or lag < _LONG_LAG * self.period_s:
            return first
        self.tell("trying an integrating process", 0.2)
        second = self._first(replace(spec, process=INTEGRATOR, increments=True))
        return second if second.increments < (1.0 - _INTEGRATOR_GAIN) * first.increments else first

    def _at_noise(self, tried: _Tried) -> bool:
        e = tried.evaluated
        floor = self._floor(e.position_means, e.values["dead_time_s"]) if e else None
        return e is not None and floor is not None and e.rmse <= ADEQUATE * floor

    def _floor(self, position: FloatArray, dead_time_s: float) -> float | None:
        good = np.isfinite(self.loop.process_value) & self.loop.used
        good[:skipped(self.loop, self.period_s)] = False
        y = np.where(good, self.loop.process_value, 0.0)
        return irreducible(y, position, good, int(dead_time_s / self.loop.step_s))

    def _try_step(self, steps: list[Step], fits: list[Fitted], effect: str) -> None:
        """Add `effect` as a step of its own where held-out error and BIC both fall clearly."""
        before = fits[-1]
        spec = replace(before.model.spec, effects=(*before.model.spec.effects, effect))
        model = self.model(spec)
        guesses = model.effects[[e.name for e in model.effects].index(effect)].guess
        values = np.array([model.vector(before.best.values)])
        starts = values.repeat(3, axis=0)
        if guesses is not None:
            g = guesses(model.context)
            starts = values.repeat(len(g), axis=0)
            at = next(s for s, e in zip(model._slices, model.effects, strict=True) if e.name == effect)
            starts[:, at] = g
        coarse = search_model(model)
        quick = refine(coarse.costs, coarse.cube(starts.T), self.rng, spread=0.02, rounds=40, population=14)
        if not quick.costs[0] < before.sse * (1.0 - _STEP_DROP):
            return
        after = self._fit(spec, quick.points)
        step = self._step(after, effect)
        if before.rmse_holdout is None or after.rmse_holdout is None:
            return
        drop = 1.0 - after.rmse_holdout / before.rmse_holdout
        gain = (steps[-1].error.bic or 0.0) - (step.error.bic or 0.0)
        if drop > _STEP_DROP and gain > _STEP_BIC:
            steps.append(step)
            fits.append(after)

    def _step(self, fit: Fitted, added: str | None) -> Step:
        e = fit.best
        y = self._used_y()
        floor = self._floor(e.position_means, e.values["dead_time_s"])
        innovation = float(np.sqrt(fit.sse / max(e.rows - 1, 1)))
        rows = effective_rows(np.nan_to_num(e.innovation), fit.model.weight)
        count = fit.model.space.size - len(fit.model.spec.fixed) + fit.model.shared.freedom + len(e.own)
        span = float(np.linalg.norm(y - y.mean()))
        fitted = 100.0 * (1.0 - e.rmse * np.sqrt(y.size) / span) if span else None
        error = ErrorSummary(e.rmse, self._level_holdout(fit), innovation, fit.rmse_holdout, floor, fitted,
                             bic(fit.sse * rows / e.rows, rows, count))
        findings = []
        if fit.agree < 2:
            findings.append(Finding(
                "restarts-disagree", "warning",
                f"only {fit.agree} of {fit.runs} independent searches ended in this optimum: it may be a wrong basin",
                {"runs": fit.runs, "agree": fit.agree}, (), "METHODS.md section 4, trap 3"))
        return Step(added, tuple(x.name for x in fit.model.effects), tuple(_parameters(fit)), error,
                    Restarts(fit.runs, fit.agree), tuple(findings), fit.model.describe(fit.values))

    @staticmethod
    def _level_holdout(fit: Fitted) -> float | None:
        """Held-out error in the unit of y: as it is, or scaled from the differences that an integrator is fitted in."""
        if fit.rmse_holdout is None or not fit.model.spec.increments:
            return fit.rmse_holdout
        inner = float(np.sqrt(fit.sse / max(fit.best.rows, 1)))
        return fit.best.rmse * fit.rmse_holdout / inner if inner else fit.rmse_holdout

    def _adequate(self, fit: Fitted, step: Step) -> tuple[bool, str]:
        floor, error = step.error.noise_sd, step.error.rmse
        if floor is None:
            return False, "the record is too short to estimate its irreducible noise"
        if error <= ADEQUATE * floor:
            return True, (f"the free-run error {error:.4g} is within {100 * (ADEQUATE - 1):.0f} % of the irreducible "
                          f"noise {floor:.4g}: nothing is left to explain")
        return False, (f"the free-run error {error:.4g} is {error / floor:.3g} times the irreducible noise {floor:.4g}: "
                       "something is missing (stictionid compare, stictionid diagnose)")

    def verdict(self, fit: Fitted) -> Verdict:
        """The best model without friction against the best one with it."""
        self.tell("comparing with a valve that does not stick", 0.85)
        free = self._friction_free(fit)
        y = self._used_y()
        variance = float(np.var(y))
        with_rmse, without = fit.best.rmse, free
        explained = (without**2 - with_rmse**2) / variance if variance else 0.0
        drop = 1.0 - with_rmse / without if without else 0.0
        evidence = {"rmse_without_friction": without, "rmse_with_friction": with_rmse,
                    "share_of_pv_variance": explained, "error_drop": drop}
        said = (f"friction lowers the free-run error from {without:.4g} to {with_rmse:.4g} "
                f"({100 * drop:.0f} %, {100 * explained:.1f} % of the variance of y)")
        capped = 0.6 if self.found.reversals < _FEWEST_FOR_TRUST else 0.95
        if explained < _CLEAN[0] or drop < _CLEAN[1]:
            return Verdict("no stiction", said, min(capped, 0.9), evidence)
        if fit.agree < 2:
            return Verdict("undecided", f"the restarts disagree; {said}", 0.3, evidence)
        if explained >= _STICKS[0] and drop >= _STICKS[1]:
            return Verdict("stiction", said, min(capped, 0.5 + 2.0 * explained + 0.5 * drop), evidence)
        return Verdict("undecided", said, 0.4, evidence)

    def _friction_free(self, fit: Fitted) -> float:
        """Free-run error of the same model with S = J = 0, its process searched anew."""
        model = self.model(replace(fit.model.spec, friction_free=True))
        T, L = np.meshgrid(np.linspace(0.05, 0.95, 24), np.linspace(0.0, 0.95, 20), indexing="ij")
        cube = np.zeros((T.size, model.space.size))
        cube[:, 3], cube[:, 4] = T.ravel(), L.ravel()
        if model.space.size > 5:
            cube[:, 5:] = model.cube(fit.values[:, None])[0, 5:]
        costs = process_costs(model, model.values(cube), model.positions(model.values(cube[:1])))
        starts = cube[np.argsort(costs, kind="stable")[:3]]
        found = refine(model.costs, starts, self.rng, spread=0.03, rounds=40)
        if not np.isfinite(found.costs[0]):
            return float(np.std(self._used_y()))
        return model.evaluate(model.values(found.points[:1])[:, 0]).rmse

    def arx(self) -> tuple[list[Step], list[Fitted], bool, str]:
        """The paper exactly: ARX of the given order, S <= S_max, J <= S, u_v(0) = u(0), deviations from the mean."""
        o = self.options
        period = self.period_s / self.loop.step_s
        delays = (o.delay,) if o.delay is not None else tuple(range(int(np.clip(0.35 * period, 1, 40)) + 1))
        model = self.model(Spec(law=o.law))
        arx = Arx(model, o.order, delays, constant=False)
        middle = np.zeros(model.space.size)
        middle[2:5] = 0.5

        def cube_of(points: FloatArray) -> FloatArray:
            cube = middle[None].repeat(len(points), 0)
            cube[:, 0] = points[:, 0] / 1.2
            cube[:, 1] = points[:, 1] / 1.5
            return cube

        self.tell("searching (S, J) by particle swarm", 0.3)
        found = swarm(lambda c: arx.costs(model.values(cube_of(c)))[0], 2, self.rng, groups=4, particles=24, rounds=50)
        best = cube_of(found.points[:1])
        values = model.values(best)
        _, delay = arx.costs(values)
        a, b, mse = arx.coefficients(values[:, 0], int(delay[0]))
        gain, lags, integrating = continuous(a, b, self.loop.step_s)
        self.arx_process = (gain, lags, float(delay[0]) * self.loop.step_s, integrating)
        cube, costs = self._finish_arx(model, cube_of(found.points), arx, lags, int(delay[0]), integrating)
        fit = finish(model if not integrating else self.model(Spec(law=o.law, process=INTEGRATOR, increments=True)),
                     cube, costs, self.rng, rounds=1, holdout=False)
        exact = replace(fit, values=np.concatenate([values[:3, 0], fit.values[3:]]))
        exact = replace(exact, best=exact.model.evaluate(exact.values), runs=4, agree=_swarm_agreement(found.points))
        step = self._step(exact, None)
        step = replace(step, error=replace(step.error, rmse_one_step=float(np.sqrt(mse))),
                       model={**step.model, "arx": {"a": a.tolist(), "b": b.tolist(), "delay": int(delay[0])}})
        adequate, why = self._adequate(exact, step)
        return [step], [exact], adequate, why

    def _finish_arx(self, model: Model, cube: FloatArray, arx: Arx, lags: tuple[float, ...], delay: int,
                    integrating: bool) -> tuple[FloatArray, FloatArray]:
        """A free-run process for the ARX answer, so that curves can be drawn; S and J stay as ARX found them."""
        target = model if not integrating else self.model(Spec(law=self.options.law, process=INTEGRATOR,
                                                               increments=True))
        values = model.values(cube[:1])
        values[3] = np.clip(max(lags, default=self.loop.step_s), 0.03 * self.loop.step_s, 19 * self.period_s)
        values[4] = delay * self.loop.step_s
        points = with_process(target, target.cube(values))
        return points, target.costs(points)


def _swarm_agreement(points: FloatArray) -> int:
    near = np.abs(points - points[0]).max(axis=1) < 0.02
    return int(min(4, max(1, near.sum() // 12)))


def _increment_error(e: Evaluated) -> float:
    """Root mean square of the differences of the free-run residual, in the unit of y."""
    good = e.counted > 0
    both = good[1:] & good[:-1]
    return float(np.sqrt(np.mean(np.diff(np.nan_to_num(e.residual))[both] ** 2)))


def _parameters(fit: Fitted) -> list[ParameterValue]:
    e, model = fit.best, fit.model
    rows = []
    for p, (name, value) in zip(model.space.parameters, e.values.items(), strict=True):
        owner, _, own = name.rpartition(":")
        span = fit.intervals.get(name)
        bound = p.at_bound(value / max(e.values["S"], 1e-12) if name == "J" else value)
        fixed = name in model.spec.fixed
        rows.append(ParameterValue(owner or None, own, value, "%" if name == "J" else p.unit,
                                   None if fixed else span, bound and not fixed, True, p.meaning))
    unit = "unit of y / %" + (" / s" if model.spec.process == INTEGRATOR else "")
    rows.insert(5, ParameterValue(None, "gain", e.gain, unit, None, False, True, "gain of the process"))
    rows.insert(6, ParameterValue(None, "offset", e.offset, "unit of y", None, False, True,
                                  "value of y with the valve at its first position"))
    return rows


def _estimate(fit: Fitted, options: Options, unit: str, step: Step, position: object,
              arx: tuple[float, tuple[float, ...], float, bool] | None) -> Estimate:
    v = fit.best.values
    gain, lags, dead, integrating = fit.best.gain, (v["time_constant_s"],), v["dead_time_s"], (
        fit.model.spec.process == INTEGRATOR)
    if "extra-lag:second_time_constant_s" in v:
        lags = (*lags, v["extra-lag:second_time_constant_s"])
    if arx is not None:
        gain, lags, dead, integrating = arx
    return Estimate(v["S"], v["J"], unit, fit.intervals.get("S"), fit.intervals.get("J"), INTERVAL_LEVEL, options.law,
                    gain, lags, dead, integrating, v["initial_residual_force"], position)  # type: ignore[arg-type]


def _cost_map(fit: Fitted) -> CostMap:
    """Free-run error over S and J with everything else held at its best, for the picture."""
    S = np.linspace(0.05 * fit.model.s_max, 1.2 * fit.model.s_max, _MAP_S)
    share = np.linspace(0.0, 1.5, _MAP_J)
    J = share * min(float(fit.best.values["S"]) * 1.4, fit.model.s_max)
    grid = np.stack([S.repeat(J.size), np.tile(J, S.size)])
    values = fit.values[:, None].repeat(grid.shape[1], axis=1)
    values[0], values[1] = grid[0], np.minimum(grid[1], 2.0 * grid[0])
    costs = search_model(fit.model).costs_of(values)
    rmse = np.sqrt(costs / max(fit.best.rows, 1))
    rmse[grid[1] > 2.0 * grid[0]] = np.nan
    rows = [tuple(None if not np.isfinite(x) else float(x) for x in row) for row in rmse.reshape(S.size, J.size)]
    return CostMap(tuple(S.tolist()), tuple(J.tolist()), tuple(rows),
                   tuple((float(a), float(b)) for a, b in fit.searched))


def _made(options: Options) -> CreatedBy:
    import numba

    return CreatedBy(__version__, options.seed, platform.python_version(), np.__version__, numba.__version__)


def _data(loop: Loop, piece: Loop, notes: tuple[Finding, ...] = ()) -> DataRecord:
    o = loop.origin
    return DataRecord(o.file, o.sha256, dict(o.columns), dict(o.units or loop.units), o.rows or loop.samples,
                      int(piece.used.sum()), loop.step_s, o.start, o.end, (*o.findings, *notes), loop.name,
                      dict(o.options))


def _abstained(loop: Loop, found: Range, options: Options, reason: CannotTell) -> Study:
    finding = Finding(reason.code, "serious", reason.message, {}, (), reason.hint)
    return Study(_made(options), _data(loop, loop, (finding,)), found,
                 Verdict("undecided", reason.message + (f"; {reason.hint}" if reason.hint else ""), 0.0,
                         {"code": reason.code}), None, command=options.command)
