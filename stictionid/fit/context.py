"""One identification on one record: oscillation, options, shared intermediate results, and study steps from fits."""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256
from typing import Any

import numpy as np

from ..effects import parse
from ..errors import CannotTell
from ..model.model import Model, skipped_samples
from ..model.segments import bind_model
from ..model.spec import INTEGRATOR, Evaluated, Spec
from ..numerics.autoregression import link_samples
from ..numerics.noise.likelihood import Likelihood
from ..numerics.population import refine
from ..options import USUAL_ORDER, Options
from ..record.loop import Finding, Loop
from ..record.preconditions import swing_of, time_scale_s
from ..record.study import EXTRAPOLATES, ErrorSummary, ParameterValue, Range, Restarts, Step
from ..typing import FloatArray, Progress
from .adequacy import noise_floor
from .fit import finish_fit, search
from .intervals.along_path import path_deviance, share_moved
from .intervals.assemble import innovation_rows
from .points.fitted import Fitted
from .points.held_out_blocks import stated_error
from .public_values import public_parameters
from .starts.basins import basins

# A time constant beyond this share of the period suggests an integrator. It must then lower the error of the
# differences by this share.
_LONG_LAG, _INTEGRATOR_GAIN = 0.75, 0.02
# Number of models kept, and the longest record in samples for which they are: each is many times as large as the
# record.
_AT_HAND, _NOT_LONG = 6, 20_000
# Grid of start forces, time constants and dead times (shares of their ranges) for the process of a given valve.
_FORCES, _LAGS, _DEADS = np.linspace(-0.96, 0.96, 13), np.linspace(0.1, 0.9, 14), np.linspace(0.0, 0.95, 12)


class Run:
    """One identification on one stretch: record, oscillation, options, and the law and order to use."""

    def __init__(self, loop: Loop, found: Range, options: Options, *, law: str, rng: np.random.Generator,
                 tell: Progress, order: int = USUAL_ORDER) -> None:
        self.loop, self.found, self.options, self.rng, self.tell = loop, found, options, rng, tell
        self.law, self.order = law, order
        self.period_s, self.s_max = time_scale_s(loop, found), swing_of(loop, found)
        # Results that several stages ask for. Basins are kept by valve, noise by position.
        self._basins: dict[tuple[Any, ...], FloatArray] = {}
        self._floors: dict[tuple[bytes, int], float | None] = {}
        self._models: dict[str, Model] = {}

    def model(self, spec: Spec) -> Model:
        """The spec bound to this record. The last few models are kept unless the record is long."""
        key = repr(spec)
        model = self._models.pop(key, None) or bind_model(self.loop, spec, s_max=self.s_max, period_s=self.period_s)
        if self.loop.samples <= _NOT_LONG:
            self._models[key] = model
            if len(self._models) > _AT_HAND:
                del self._models[next(iter(self._models))]
        return model

    def basins(self, spec: Spec) -> FloatArray:
        """Basins (k, d) of the spec's valve on the ARX cost, searched once for all structures of the process.

        The search uses a held command: a command that moves between samples has the same basins.
        """
        key = (spec.law, spec.effects)
        if key not in self._basins:
            self._basins[key] = basins(self.model(replace(spec, between="hold", substeps=1)), self.rng)
        return self._basins[key]

    def used_y(self) -> FloatArray:
        """The process values in use (m,). With several segments the mean of each is removed."""
        y, used = self.loop.process_value, self.loop.used
        if len(self.loop.starts) == 1:
            return y[used]
        parts = [y[part][used[part]] for part in self.loop.segments]
        return np.concatenate([part - part.mean() for part in parts])

    def fit(self, spec: Spec, starts: FloatArray | None = None,
            before: tuple[FloatArray, FloatArray] | None = None) -> Fitted:
        """Search, restarts and last polish of one model; CannotTell where no candidate valve moves.

        The intervals are left to `fit.widen_intervals`, since most fitted models are not the last one.
        """
        model = self.model(spec)
        points, costs = search(model, self.rng, starts=starts, before=before)
        if not np.isfinite(costs[0]):
            raise CannotTell("no valve model moves under this command", "look at the trend with stictionid read",
                             code="valve-never-moves")
        return finish_fit(model, points, costs, self.rng, reach=False)

    def floor(self, position: FloatArray, dead_time_s: float, disturbance: FloatArray | None = None) -> float | None:
        """Irreducible noise in the unit of y for a valve position (n,), None where the record is too short.

        A `disturbance` (n,) that the model knows is subtracted first. A step would otherwise count as noise of its own
        size.
        """
        delay = int(dead_time_s / self.loop.step_s)
        key = (sha256(np.ascontiguousarray(position).data).digest(), delay)
        if disturbance is None and key in self._floors:
            return self._floors[key]
        good = np.isfinite(self.loop.process_value) & self.loop.used
        for part in self.loop.segments:
            left_out = skipped_samples(part.stop - part.start, self.loop.step_s, self.period_s)
            good[part.start:part.start + left_out] = False
        floor = noise_floor(self.loop, position, good, dead_time_s, disturbance)
        if disturbance is None:
            self._floors[key] = floor
        return floor

    def delays(self) -> tuple[int, ...]:
        """Delays in samples that a difference equation tries: the one given, or all up to a third of the period."""
        if self.options.delay is not None:
            return (self.options.delay,)
        period = self.period_s / self.loop.step_s
        return tuple(range(int(np.clip(0.35 * period, 1, 40)) + 1))

    def step(self, fit: Fitted, added: str | None) -> Step:
        """A fit as a step of the study, with the noise that a free linear model leaves."""
        e = fit.best
        y = self.used_y()
        known = fit.model.disturbance(fit.values, e.own) if any(x.columns for x in fit.model.effects) else None
        floor = self.floor(e.position_means, e.values["dead_time_s"], known)
        innovation = float(np.sqrt(fit.sse / max(e.rows, 1)))
        rows = innovation_rows(fit.model, fit.best)
        likelihood = Likelihood(fit.sse * rows / e.rows, rows)
        span = float(np.linalg.norm(y - y.mean()))
        fitted = 100.0 * (1.0 - e.rmse * np.sqrt(y.size) / span) if span else None
        placed = fit.model.spec.paths is not None
        free = fit.model.along(None).evaluate(fit.values).rmse if placed else e.rmse
        spread = fit.model.spread
        held = level_holdout(fit)
        level, ahead = (stated_error(fit.model, error) for error in (held, fit.rmse_holdout))
        error = ErrorSummary(free, level, innovation, ahead, floor, fitted,
                             likelihood.bic(_count(fit)) + path_deviance(fit.model, fit.values),
                             e.rmse if placed else None, share_moved(fit.model, fit.values),
                             innovation * float(np.sqrt(spread**2 - 1.0)) if spread > 1.0 else None)
        findings = []
        if fit.agree < 2 <= fit.runs:
            findings.append(Finding(
                "restarts-disagree", "warning",
                f"only {fit.agree} of {fit.runs} independent searches ended in this optimum: it may be a wrong basin",
                {"runs": fit.runs, "agree": fit.agree}, (), "docs/details.md, section 6.3"))
        if held is not None and level is None:
            findings.append(Finding(
                EXTRAPOLATES, "warning", "on stretches held out of its fit the model errs by more than 1,000 times the "
                "swing of PV: it extrapolates there, and no held-out error is stated", {}, (),
                "docs/details.md, section 11"))
        effect, variant = parse(added) if added else (None, "")
        return Step(effect.name if effect else None, tuple(x.name for x in fit.model.effects), parameters(fit), error,
                    Restarts(fit.runs, fit.agree), tuple(findings), fit.model.describe(fit.values), variant=variant)

    def step_again(self, before: Step, fit: Fitted) -> Step:
        """A step with a better fit of the same model; the findings of the step before stay, but that on its blocks."""
        again, stay = self.step(fit, before.added), tuple(f for f in before.findings if f.code != EXTRAPOLATES)
        codes = {f.code for f in stay}
        return replace(again, variant=before.variant, findings=(
            *stay, *(f for f in again.findings if f.code not in codes)))

    def with_valve(self, S: float, J: float) -> Fitted:
        """The free-run process that fits best with a valve whose S and J in % are given and stay fixed.

        It serves methods that find S and J in another way and still owe a model that runs. The process is first order,
        or an integrator where the time constant gets long and the differences of y then fit better. No held-out error,
        no intervals.
        """
        first = self._with_valve(Spec(law=self.law), S, J)
        if first.best.values["time_constant_s"] < _LONG_LAG * self.period_s:
            return first
        second = self._with_valve(Spec(law=self.law, process=INTEGRATOR, increments=True), S, J)
        better = increment_error(second.best) < (1.0 - _INTEGRATOR_GAIN) * increment_error(first.best)
        return second if better else first

    def _with_valve(self, spec: Spec, S: float, J: float) -> Fitted:
        model = self.model(spec)
        T, L = np.meshgrid(_LAGS, _DEADS, indexing="ij")
        cube = np.zeros((T.size, model.space.size))
        cube[:, 3], cube[:, 4] = T.ravel(), L.ravel()
        grid = model.values(cube)
        grid[0], grid[1] = S, J
        found: list[tuple[float, FloatArray]] = []
        for force in _FORCES:
            grid[2] = force
            costs = model.costs_of(grid, model.positions(grid[:, :1]))
            found.append((float(costs.min()), grid[:, int(costs.argmin())].copy()))
        found.sort(key=lambda f: f[0])
        if not np.isfinite(found[0][0]):
            raise CannotTell(f"a valve with S = {S:.4g} % never moves under this command",
                             "the method's estimate is no valve of this record; use --method auto",
                             code="valve-never-moves")

        def values_of(points: FloatArray) -> FloatArray:
            values = model.values(np.concatenate([np.zeros((len(points), 2)), points], axis=1))
            values[0], values[1] = S, J
            return values

        starts = model.cube(np.stack([f[1] for f in found[:3]], axis=1))[:, 2:]
        best = refine(lambda c: model.costs_of(values_of(c)), starts, self.rng, spread=0.03, rounds=60, settle=1e-4)
        values = values_of(best.points[:1])[:, 0]
        evaluated = model.evaluate(values)
        return Fitted(model, values, float(best.costs[0]), 1, 1, evaluated, None, {}, np.array([[S, J]]))


def _count(fit: Fitted) -> int:
    """Number of parameters that a fit has estimated."""
    return fit.model.space.size - len(fit.model.spec.fixed) + fit.model.shared.freedom + len(fit.best.own)


def increment_error(e: Evaluated) -> float:
    """Root mean square of the differences of the free-run residual, in the unit of y."""
    good = e.counted > 0
    links = link_samples(good, e.starts)
    if links is not None:
        return float(np.sqrt(np.mean(np.diff(e.residual[links.rows])[links.depth[1:] > 0] ** 2)))
    both = good[1:] & good[:-1]
    return float(np.sqrt(np.mean(np.diff(np.nan_to_num(e.residual))[both] ** 2)))


def level_holdout(fit: Fitted) -> float | None:
    """Held-out error in the unit of y; where the model is fitted prewhitened, scaled from that form."""
    if fit.rmse_holdout is None or not fit.model.spec.whitening().size:
        return fit.rmse_holdout
    inner = float(np.sqrt(fit.sse / max(fit.best.rows, 1)))
    return fit.best.rmse * fit.rmse_holdout / inner if inner else fit.rmse_holdout


def parameters(fit: Fitted) -> tuple[ParameterValue, ...]:
    """The parameters of a fit as rows of the study, those of effects under their public names."""
    e, model = fit.best, fit.model
    # The unit is not % where the output is not in % of its span (normalised data).
    of_u = model.loop.unit("output", "%")
    rows = []
    for p, (name, value) in zip(model.space.parameters, e.values.items(), strict=True):
        owner, _, own = name.rpartition(":")
        span = fit.intervals.get(name)
        bound = p.at_bound(value / max(e.values["S"], 1e-12) if name == "J" else value)
        fixed = name in model.spec.fixed
        rows.append(ParameterValue(owner or None, own, value, of_u if name == "J" else p.unit.replace("%", of_u),
                                   None if fixed else span, bound and not fixed, True,
                                   "slip jump" if name == "J" else p.meaning))
    unit = f"unit of y / {of_u}" + (" / s" if model.spec.process == INTEGRATOR else "")
    rows.insert(5, ParameterValue(None, "gain", e.gain, unit, fit.intervals.get("gain"), False, True,
                                  "gain of the process"))
    rows.insert(6, ParameterValue(None, "offset", e.offset, "unit of y", None, False, True,
                                  "value of y with the valve at its first position"))
    return public_parameters(fit, rows)


def process_numbers(fit: Fitted) -> dict[str, Any]:
    """The process as an estimate reports it: gain, time constants and dead time with their intervals, and its kind."""
    values, fixed = fit.best.values, fit.model.spec.fixed
    spans = {name: span for name, span in fit.intervals.items() if name not in fixed}
    lags = [name for name in values if name == "time_constant_s" or name.endswith(":second_time_constant_s")]
    return {"gain": fit.best.gain, "time_constants_s": tuple(values[name] for name in lags),
            "dead_time_s": values["dead_time_s"], "integrating": fit.model.spec.process == INTEGRATOR,
            "gain_interval": spans.get("gain"), "time_constants_intervals": tuple(spans.get(name) for name in lags),
            "dead_time_interval": spans.get("dead_time_s")}
