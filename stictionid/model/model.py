"""Model of a loop from command to measurement: stiction law, effects, process, and the part fitted linearly.

command -> [law with friction effects] -> [stem and trim effects] -> [process] -> gain * response + shared columns

`Model` evaluates many candidates at once (points of the unit cube) and describes one of them fully. Gain, offset,
start-up transient and the sizes of linear effects never join the search: they are fitted by separable least squares in
numerics/varpro.py. For integrators, and where a noise model says so, response, columns and data are prewhitened alike.
Source: Shang et al., Eq. 7 to 19; docs/details.md, sections 6.1, 6.2, 6.4 and 6.5.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace
from typing import Any, Self, cast

import numpy as np

from ..effects.contract import Context, Record
from ..laws import get as law_of
from ..laws.contract import Law
from ..numerics.autoregression import first_rows, link_samples, whole_past
from ..numerics.fixed_point import fixed_point
from ..numerics.jit import FULL, LANES, output
from ..numerics.varpro import REJECTED, Shared
from ..numerics.varpro_segments import Blockwise
from ..process.intersample import kick_rows, rebuild
from ..process.linear import free_run
from ..process.rounded import command_sd
from ..process.scan import DECIMATED, answers, command_at_scans
from ..record.loop import Loop, bridged, fingerprint
from ..system import evaluations
from ..typing import BoolArray, FloatArray
from .landing import landing_of
from .replay import doubts, law_along
from .response import Response
from .slips import Paths
from .spec import Evaluated, Spec

# Size of a block of candidates evaluated together: their positions take 8 MB. Smaller blocks would stay in the cache
# but take a quarter longer (measured at 1,000 to 40,000 rows), because every row of a kernel has a fixed cost.
# Unit: numbers.
_BLOCK = 1 << 20
_FEWEST_LANES = 16
# Samples left out of the cost at the start, as a share of the record and at most this many periods.
_SKIP_SHARE, _SKIP_PERIODS = 0.05, 0.5
# Number of initial residual forces tried for a guide, the model whose y helps to rebuild another one's command.
_GUIDE_FORCES = 13
# Most rounds of the iteration for the model's own y, which some effects follow, and the change that ends it, first of a
# y within bounds (share of the error).
_FOLLOWED, _NEAR, _STILL = 40, 0.1, 6e-3
# Share of its first value below which a start-up transient has decayed on all counted samples. Unit: 1. With a higher
# share the cost has a column that the full run lacks: 24 % of the squared error with lags of 4 and 6 s.
_DEAD = 1e-8


class Model(Response):
    """A `Spec` bound to one record: maps points of the unit cube to costs. Immutable after construction."""

    # What was evaluated last: values (d,) as bytes.
    _evaluated: tuple[bytes, Evaluated] | None = None

    def __init__(self, loop: Loop, spec: Spec, *, s_max: float, period_s: float,
                 residual: FloatArray | None = None, command: FloatArray | None = None,
                 record: Record | None = None) -> None:
        # `residual` (n,) is that of the model so far: effects find their guesses in it, and y less it is their guide.
        self._name(loop, spec, s_max, period_s)
        self.thinned = command is not None
        y = bridged(loop.process_value)
        if command is None:
            command = self._command_on_grid()
        self.context = Context(command, y, loop.setpoint, loop.step_s, period_s, s_max,
                               dict(loop.extras), residual, None if residual is None else y - residual, record,
                               spec.held)
        self.kicked = kick_rows(bridged(loop.output), 1 if spec.held else spec.substeps, loop.setpoint)
        # Where u answers y between two samples, y also follows from u by the controller turned round.
        self._sign = answers(loop)
        self._doubts = 0.0, np.zeros(command.size)
        self.law = law_along(self.law, spec.paths, *self.grid, self.doubts)
        self.profile = self._drift_profile()
        self._range()
        self.skip = skipped_samples(loop.samples, loop.step_s, period_s)
        # Where PV is missing the noise filter goes from one sample that counts to the next.
        self.links = link_samples(self.good())
        self.weight = self._weights()
        self._land()

    def _land(self) -> None:
        """Filter what all candidates share, by the error with which the stem lands along the path of the spec."""
        landing = landing_of(self, self._level_weight() > 0)
        self.landing = None if landing is None else landing[0]
        if landing is not None:
            self.law = cast(Law, landing[1])
        self.target = self.filter_columns(self.context.process_value[:, None])[:, 0]
        columns = self.filter_columns(self.shared_columns())
        self.shared: Shared | Blockwise = Shared.prepare(self.target, columns, self.weight, self._sign)

    def _command_on_grid(self) -> FloatArray:
        """Command on the grid of the valve, by the spec's mode between samples; at its scans once for a record."""
        spec, loop, known = self.spec, self.loop, self.loop.memory.commands
        if spec.between != DECIMATED:
            return rebuild(bridged(loop.output), spec.substeps, spec.between, loop.setpoint)
        question = fingerprint((loop.step_s, loop.starts, loop.begins_s, spec.substeps, spec.guides, spec.fixed,
                                self.s_max, self.period_s), loop.output, loop.process_value, loop.setpoint, loop.used)
        command: FloatArray | None = known.get(question)
        if command is None:
            command = known[question] = self._command_at_scans(spec)
        return command

    def _command_at_scans(self, spec: Spec) -> FloatArray:
        if not spec.guides:
            return command_at_scans(self.loop, spec.substeps)
        *before, last = spec.guides
        guide = Model(self.loop, replace(spec, law=last["law"], process=last["process"], effects=tuple(last["effects"]),
                                         increments=bool(last["increments"]), taps=tuple(last["taps"]),
                                         friction_free=False, guides=tuple(before), paths=None),
                      s_max=self.s_max, period_s=self.period_s)
        # On another record, or a part of this one, the valve starts with another residual force.
        trial = guide.vector(last["values"])[:, None].repeat(_GUIDE_FORCES + 1, axis=1)
        trial[2, 1:] = np.linspace(-0.95, 0.95, _GUIDE_FORCES)
        best = int(np.argmin(guide.costs_of(trial)))
        return command_at_scans(self.loop, spec.substeps, guide._course(trial[:, best]))

    def _course(self, values: FloatArray) -> FloatArray:
        """Response of y (n*parts,) at every value of the command to the valve of values (d,), without start-up."""
        column = values.reshape(-1, 1)
        response = free_run(self.positions(column), self.dynamics(column), step_s=self.step_s / self.parts)
        return self.evaluate(values).gain * response[:, 0]

    def guide(self, values: FloatArray) -> dict[str, Any]:
        """Description of this model, values (d,), by which a later model rebuilds a decimated command better."""
        known = self.describe(values)
        return {key: known[key] for key in ("law", "process", "effects", "increments", "taps", "values")}

    @property
    def pieces(self) -> tuple[Model, ...]:
        """Models of the record's segments: this one alone, unless it is restarted (model/segments.py)."""
        return (self,)

    def of(self, piece: int, values: FloatArray) -> FloatArray:
        """Values (d, P) of one segment's model, taken from those of all."""
        return values

    def along(self, paths: Paths | None) -> Model:
        """The same model with valves that slip where the paths, one for each segment, say; none: where the law does."""
        other = self._copied()
        other.spec = replace(self.spec, paths=paths)
        other.law = law_along(law_of(self.spec.law), paths, *self.grid, self.doubts)
        if self.landing is not None or (paths is not None and paths.landing is not None):
            other._land()
        return other

    def doubts(self, error: float) -> FloatArray:
        """Chance (n,) of `replay.doubts` for the command of this model; kept for the error that was asked for last."""
        known, found = self._doubts
        if known != error:
            parts = 1 if self.spec.held else self.spec.substeps
            found = doubts(self.context.command, error, parts, command_sd(self.loop) if parts > 1 else 0.0)
            self._doubts = error, found
        return found

    @property
    def log_scale(self) -> float:
        """Sum of log F over the samples that count: the part of -2 log L that errors of landing add."""
        return sum(piece.landing.log_scale(piece.weight > 0) for piece in self.pieces if piece.landing is not None)

    @property
    def spread(self) -> float:
        """Free-run error over white noise that errors of landing and that noise make together, 1 or more."""
        alone = [np.ones(piece.loop.samples) if piece.landing is None else piece.landing.alone for piece in self.pieces]
        return float(np.sqrt(np.mean(np.concatenate(alone)[self._level_weight() > 0])))

    def take_out_landings(self, residual: FloatArray) -> FloatArray:
        """Residual (n,) without what errors of landing explain: its scaled innovations; as it is where there are none.
        """
        if all(piece.landing is None for piece in self.pieces):
            return residual
        parts = self.split(np.nan_to_num(residual))
        return np.concatenate([part if piece.landing is None else piece.landing.applied(part[:, None])[:, 0]
                               for piece, part in zip(self.pieces, parts, strict=True)])

    def starting(self, extra: int = 0) -> BoolArray:
        """Samples (n,) in which the unknown start shows: the first `skip` and `extra` more of every segment."""
        return np.concatenate([np.arange(m.loop.samples) < m.skip + extra for m in self.pieces])

    def _weights(self) -> FloatArray:
        if self.links is not None:
            weight = self.links.samples_in_reach(self.taps.size)
        else:
            weight = whole_past(self.good(), self.taps.size)
        weight[:max(self.skip, self.taps.size)] = False
        return weight.astype(np.float64)

    def blocks(self, values: FloatArray) -> Iterator[tuple[slice, FloatArray]]:
        """Blocks of values (d, P) that are evaluated together: the slice of each, and its values (d, >= its width).

        A block is filled up with copies of its last candidate to a multiple of FULL lanes. All blocks have nearly one
        width: eight candidates alone take nearly half as long as 64.
        """
        count = values.shape[1]
        most = min(max(_BLOCK // (self.loop.samples * self.parts) // 16 * 16, _FEWEST_LANES), LANES)
        lanes = -(-count // max(-(-count // most), 1) // FULL) * FULL
        for a in range(0, count, max(lanes, 1)):
            part = values[:, a:a + lanes]
            missing = -part.shape[1] % FULL
            if missing:
                part = np.concatenate([part, part[:, -1:].repeat(missing, axis=1)], axis=1)
            yield slice(a, min(a + lanes, count)), part

    def costs(self, cube: FloatArray) -> FloatArray:
        """Sum of squared residuals (P,) of points (P, d) of the unit cube; inf for a valve that never moves."""
        return self.costs_of(self.values(cube))

    def costs_of(self, values: FloatArray, position: FloatArray | None = None) -> FloatArray:
        """Costs as in `costs` for physical values (d, P), which may all share one known valve path (rows, 1)."""
        out = np.empty(values.shape[1])
        evaluations.add(values.shape[1], self.loop.samples, self.parts)
        for rows, part in self.blocks(values):
            base, offsets = self.responses(part, position, lent=True)
            costs = (self._fixed_gain_costs(base, offsets) if "gain" in self.spec.fixed
                     else self.shared.costs(base, offsets))
            out[rows] = costs[:rows.stop - rows.start]
        return out + self.least_cost

    def residuals(self, cube: FloatArray, *, lent: bool = False) -> FloatArray:
        """Weighted residuals (n, P) of points (P, d) after their linear part was fitted; Gauss-Newton descends on them.

        Zero where a sample does not count; not a number for a valve that never moves. `lent` ones hold until the next
        call (see `scratch` in numerics/jit.py).
        """
        values = self.values(cube)
        evaluations.add(values.shape[1], self.loop.samples, self.parts)
        out: FloatArray | None = None
        for rows, part in self.blocks(values):
            base, offsets = self.responses(part, lent=True)
            found = (self._fixed_gain_residuals(base, offsets) if "gain" in self.spec.fixed
                     else self.shared.residuals(base, offsets, lent=True))
            if lent and found.shape[1] == values.shape[1]:
                return found
            if out is None:
                out = output("all residuals", self.loop.samples, values.shape[1], lent)
            out[:, rows] = found[:, :rows.stop - rows.start]
        return np.empty((self.loop.samples, 0)) if out is None else out

    def _fixed_gain_residuals(self, base: FloatArray, offsets: tuple[int, ...]) -> FloatArray:
        """Residuals with the gain of the process given: the response joins the target instead of the columns."""
        n, w = self.loop.samples, self.weight
        out = np.full((n, base.shape[1]), REJECTED)
        own = self.own_columns(base, offsets)
        for p in range(base.shape[1]):
            if np.ptp(base[:n, p][w > 0]) > 0:
                rest = self.target - self.spec.fixed["gain"] * base[:n, p]
                # The transient joins the shared columns: it is the only other own column of this candidate.
                columns = np.concatenate([self.shared.basis, np.ascontiguousarray(own[1:, :, p].T)], axis=1)
                out[:, p] = Shared.prepare(rest, columns, w).target
        return out

    def _fixed_gain_costs(self, base: FloatArray, offsets: tuple[int, ...]) -> FloatArray:
        return np.einsum("np,np->p", r := self._fixed_gain_residuals(base, offsets), r)

    def evaluate(self, values: FloatArray) -> Evaluated:
        """One candidate in full, physical values (d,); an effect that follows y follows the model's own.

        A disturbance at the output acts on the process, or behind it (a shift of the sensor) without changing a gain.
        The reading with the smaller error is taken. The last candidate is kept: one point is completed with several
        noise models.
        """
        asked = values.tobytes()
        if self._evaluated is None or self._evaluated[0] != asked:
            self._evaluated = asked, min(self.readings(values), key=lambda e: e.sse)
        return self._evaluated[1]

    def _copied(self) -> Self:
        other = copy(self)
        other._evaluated = None
        return other

    def readings(self, values: FloatArray) -> list[Evaluated]:
        """One candidate with its disturbances at the output on the process, and behind it where that may differ."""
        if not self.follows_y:
            return [self._evaluate(values)]
        found = [self._run_on_own_y(values, behind=False)]
        if any(e.columns and not e.enters_ahead(o) for e, o in zip(self.effects, self.options, strict=True)):
            found.append(self._run_on_own_y(values, behind=True))
        return found

    def _run_on_own_y(self, values: FloatArray, behind: bool) -> Evaluated:
        """One candidate whose effects follow the model's own y; without disturbances at the output where `behind`."""
        column = values.reshape(-1, 1)
        before = self._before_y(column)
        seen = self.context.process_value[self._level_weight() > 0]
        low, high = seen.min(), seen.max()

        def evaluate(guide: FloatArray) -> tuple[Evaluated, FloatArray]:
            model = self.follow_guide(guide)
            found = model._evaluate(values, model._beside_y(before, column))
            return found, self._y_that_effects_follow(found, values, behind)

        def near(guide: FloatArray) -> tuple[Evaluated, FloatArray]:
            found, felt = evaluate(guide)
            return found, np.clip(felt, low - (high - low) / 2, high + (high - low) / 2)

        def moves_less(share: float) -> Callable[[Evaluated, FloatArray], bool]:
            return lambda found, residual: bool(np.sqrt(np.mean(residual**2)) < share * max(found.rmse, 1e-300))

        # The iteration starts at a constant: a guess that contains the record could become its own prediction. First y
        # keeps to the record's range and half of it on either side: far beyond, a gain that follows y runs away.
        start = np.full(self.loop.samples, self.context.centre)
        start = self._y_that_effects_follow(fixed_point(near, start, moves_less(_NEAR), _FOLLOWED), values, behind)
        found = fixed_point(evaluate, start, moves_less(_STILL), _FOLLOWED)
        return replace(found, followed=self._y_that_effects_follow(found, values, behind)) if behind else found

    def _y_that_effects_follow(self, found: Evaluated, values: FloatArray, behind: bool) -> FloatArray:
        """Process value (n,) that the effects of a candidate follow: without disturbances `behind` the process."""
        return found.model - self.disturbance(values, found.own, loads=False) if behind else found.model

    def follow_guide(self, guide: FloatArray) -> Model:
        """The same model with effects that follow a given y (n,)."""
        other = self._copied()
        other.context = replace(self.context, guide=guide)
        return other

    def _evaluate(self, values: FloatArray, position: FloatArray | None = None) -> Evaluated:
        values = np.asarray(values, dtype=np.float64)
        column = values.reshape(-1, 1)
        position = self.positions(column) if position is None else position
        level, offsets = self.responses(column, position, filtered=False)
        own = np.ascontiguousarray(self.own_columns(level, offsets)[:, :, 0].T)
        shared = self.shared_columns()
        y = self.context.process_value
        w = self.weight > 0
        design = np.concatenate([own, shared], axis=1)
        fixed_gain = self.spec.fixed.get("gain")
        target = y - (fixed_gain * own[:, 0] if fixed_gain is not None else 0.0)
        free = design[:, 1:] if fixed_gain is not None else design
        filtered, goal = self.filter_columns(free), self.filter_columns(target[:, None])[:, 0]
        k = own.shape[1]
        lags = self.starts_of(values) * len(self.pieces)
        # A transient that decayed before the first counted sample can't be fitted: it would be noise extrapolated back.
        dead = [i for i in range(k - lags, k) if np.abs(own[w, i]).max(initial=0.0) < _DEAD]
        filtered[:, [i - (fixed_gain is not None) for i in dead]] = 0.0
        solution = _sizes(filtered[w], goal[w])
        if fixed_gain is None and self.shared.sign * solution[0] < 0.0:
            filtered[:, :k] = 0.0
            solution = _sizes(filtered[w], goal[w])
        innovation = goal - filtered @ solution
        sse = float(np.sum(innovation[w] ** 2)) + self.least_cost
        if self.spec.taps and not self.spec.increments:
            last = k - (fixed_gain is not None)
            solution = self._start_from_level(solution, slice(last - lags, last), free, target, filtered[w], goal[w])
        coefficients = np.concatenate([[fixed_gain], solution]) if fixed_gain is not None else solution
        model = design @ coefficients
        if self.taps.size:
            # Differences carry no information on the level: offset and drift are fitted to y itself.
            level_w = self._level_weight() > 0
            rest = (y - own @ coefficients[:k])[level_w]
            tail, *_ = np.linalg.lstsq(shared[level_w], rest, rcond=1e-12)
            levelled = np.concatenate([coefficients[:k], tail])
            if self.spec.increments or self._as_likely(levelled[coefficients.size - solution.size:] - solution,
                                                       filtered[w], innovation[w]):
                coefficients = levelled
                model = design @ coefficients
        # A decayed transient is shown as the step from the model to the first measured value of its segment.
        for piece, first in enumerate(self.loop.starts if len(self.pieces) > 1 else (0,)):
            mine = [i for i in dead if (i - k + lags) % len(self.pieces) == piece]
            if mine and np.isfinite(self.loop.process_value[first]):
                coefficients[mine[0]] = y[first] - model[first]
                model = model + coefficients[mine[0]] * own[:, mine[0]]
        stem = self.stem(column, position)[::self.parts, 0]
        # Mean position over the interval that each sample begins, the last held.
        later = np.concatenate([np.append(part[1:], part[-1]) for part in self.split(position[:, 0])])
        means = later.reshape(-1, self.parts).mean(axis=1)
        return Evaluated(self.named(values), float(coefficients[0]), float(coefficients[k]),
                         coefficients[:k], own[:, k - lags:] @ coefficients[k - lags:k], lags, model,
                         np.where(np.isfinite(self.loop.process_value), y - model, np.nan),
                         innovation, position[::self.parts, 0], stem, means, int(w.sum()), sse, self._level_weight(),
                         starts=self.loop.starts)

    @staticmethod
    def _as_likely(change: FloatArray, white: FloatArray, innovation: FloatArray) -> bool:
        """True where a change of the coefficients (c,) costs less than a parameter does: the noise hides the level.

        `white` (m, c) are the filtered columns. An autoregression with a root next to 1 takes any level for noise.
        """
        left, before = innovation - white @ change, float(innovation @ innovation)
        return innovation.size * float(np.log(max(float(left @ left), 1e-300) / max(before, 1e-300))) < 1.0

    def _start_from_level(self, solution: FloatArray, starts: slice, design: FloatArray, y: FloatArray,
                          white: FloatArray, goal: FloatArray) -> FloatArray:
        """Coefficients (c,) of a design (n, c) with those of the start-up transients (`starts`) from the level, too.

        The noise filter removes a transient that decays like the noise, so `white` rows and their `goal` may leave its
        size undetermined. The first samples of every segment, which contain the level, determine it.
        """
        head, at, long = first_rows(self.taps), 0, self.taps.size
        rows, wanted = [white], [goal]
        for piece in self.pieces:
            counted = np.flatnonzero(piece._level_weight())
            links = link_samples(piece._level_weight() > 0)
            runs = np.flatnonzero(counted[long - 1:] - counted[:counted.size - long + 1] == long - 1
                                  if links is None else links.depth[long - 1:] >= long - 1)
            if runs.size:
                first = at + counted[runs[0]:runs[0] + long]
                rows.append(head @ design[first])
                wanted.append(head @ y[first])
            at += piece.loop.samples
        known, settled = np.where(white.any(axis=0), np.concatenate(rows), 0.0), solution.copy()
        rest = np.concatenate(wanted) - known @ solution + known[:, starts] @ solution[starts]
        settled[starts] = np.linalg.lstsq(known[:, starts], rest, rcond=1e-12)[0]
        return settled

    def _level_weight(self) -> FloatArray:
        return (self.good() & ~self.starting()).astype(np.float64)


def skipped_samples(samples: int, step_s: float, period_s: float) -> int:
    """Samples left out of the cost at the start of a segment, where the unknown initial state still shows."""
    return max(2, int(min(_SKIP_SHARE * samples, _SKIP_PERIODS * period_s / step_s)))


def _sizes(columns: FloatArray, goal: FloatArray) -> FloatArray:
    """Sizes (c,) of columns (n, c) by least squares; 0 for a column that is hardly there.

    LinAlgError for a column that is no number: a valve that can't take its path has such a response.
    """
    scale = np.linalg.norm(columns, axis=0)
    if not np.isfinite(scale).all():
        raise np.linalg.LinAlgError("a response is not finite")  # (LAPACK would print a line of its own)
    scale[scale < 1e-12 * max(scale.max(initial=0.0), 1e-300)] = np.inf
    solution, *_ = np.linalg.lstsq(columns / scale, goal, rcond=1e-12)
    return solution / scale
