"""Run of a model without fitting: from named values to valve positions, process responses and disturbances.

command -> [law with friction effects] -> [stem and trim effects] -> [process] -> responses

Nothing here is fitted: sizes of linear effects, gain, level and start-up transients belong to `Model` in model.py.
Source: Shang et al., Eq. 7 to 19; docs/details.md, sections 6.1, 6.2 and 6.4.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cached_property, partial
from itertools import dropwhile, takewhile
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import effects as effect_room
from .. import laws as law_room
from ..effects.contract import Context, Effect, Place
from ..errors import ModelError
from ..laws.contract import SINCE
from ..numerics.autoregression import Links, pace_of
from ..numerics.noise.landing import LandingFilter
from ..numerics.parameters import Parameter, Space
from ..numerics.varpro import whiten, whiten_stack
from ..process.intersample import CORNER, interval_means
from ..process.linear import Dynamics, free_run, transient
from ..process.scan import DECIMATED, late_moves
from ..process.state_space import modes
from ..record.loop import Loop, fingerprint
from ..typing import BoolArray, FloatArray, IntArray
from .spec import BASE, FIRST_ORDER, INTEGRATOR, Spec

Kind = TypeVar("Kind", bound=np.generic)

# Limits of the search, docs/details.md, section 6: sampled peaks are clipped, so S may exceed S_max by a fifth.
S_OVER_S_MAX = 1.2
J_OVER_S = 1.5
# Smallest S of the search, as a share of S_max: a smaller one can't be told from a linear valve. Unit: 1.
_SMALLEST_S = 0.01
# Places of effects that a measured valve position shows.
_STEM = (Place.FRICTION, Place.STEM)
# A change of friction that comes so little after a command, as a share of its step, comes with it.
_TIE = 1e-9
# Parts of a sample where an effect moves the stem between two values of a held command.
_FINE_PARTS = 4


class Response:
    """A `Spec` with the space of its numbers; a subclass binds it to a record (`context`, `loop`, `target`)."""

    # Positions of the initial residual forces in a point, one for each segment.
    forces: tuple[int, ...] = (BASE.index("initial_residual_force"),)
    context: Context
    taps: FloatArray
    profile: FloatArray
    links: Links | None
    # Filter for a stem that lands a little beside its place; None where it lands exactly.
    landing: LandingFilter | None = None
    # Rows before which a setpoint move kicks the command, and the share of the part that came before it
    # (see process/intersample.py).
    kicked: tuple[IntArray, FloatArray]

    def _name(self, loop: Loop, spec: Spec, s_max: float, period_s: float) -> None:
        """Set what follows from the spec alone, without the record."""
        self.loop, self.spec, self.s_max, self.period_s = loop, spec, s_max, period_s
        self.law = law_room.get(spec.law)
        ordered = effect_room.in_order(spec.effects)
        self.names = tuple(name for name, _, _ in ordered)
        wrong = [e.name for _, e, _ in ordered if "integrator" in e.needs and spec.process != INTEGRATOR]
        if wrong:
            raise ModelError(f"{wrong[0]} belongs to an integrating process, and this one regulates itself",
                             "leave it out; its lag is the time constant of the process")
        self.effects: tuple[Effect, ...] = tuple(effect for _, effect, _ in ordered)
        self.options = tuple(option for _, _, option in ordered)
        # A valve without friction follows the command exactly, unless an effect acts on friction or position.
        self._follows = (spec.friction_free and self.law.supply is None
                         and not any(e.moves or e.friction for e in self.effects))
        self.step_s = loop.step_s
        # Every cost holds the errors of arithmetic, so that no search goes on below them.
        self.least_cost = loop.samples * loop.arithmetic_error**2
        fine = any(effect.fine for effect in self.effects)
        # Each command lasts a whole number of parts; a sample of a thinned record holds several commands.
        self.parts = spec.substeps * (-(-_FINE_PARTS // spec.substeps) if fine and spec.held else 1)
        self.taps = spec.whitening()

    def _range(self) -> None:
        """Set the space of the search for the record in the context."""
        self.space = Space(self._axes())
        self.effect_rows = self._effect_rows()
        axes = list(self.space.parameters)
        self._seen = [(rows, effect.seen) for effect, rows in self._effects_in_order() if effect.seen]
        for rows, seen in self._seen:
            axes[rows] = seen.limits(self.context)
        self._searched = Space(tuple(axes))
        self._scales = self._searched.scales()
        self._logarithmic = np.flatnonzero(self._scales[2]).tolist()
        self._powers = self._searched.powers()
        parameters = self.space.parameters
        self._labels = [p.name for p in parameters[:self.head]]
        for name, rows in zip(self.names, self.effect_rows, strict=True):
            self._labels += [f"{name}:{p.name}" for p in parameters[rows]]

    @property
    def grid(self) -> tuple[int, int]:
        """Samples of the command's grid, and how many of them there are from a row to the next."""
        samples = self.context.command.size
        return samples, samples // self.loop.samples

    @cached_property
    def late_moves(self) -> FloatArray:
        """Standard deviation (n,) of the time at which a command (n,) moves with its setpoint, in steps of its grid."""
        loop, held, (samples, parts) = self.loop, self.spec.held, self.grid
        if self.spec.between not in (DECIMATED, CORNER):
            return np.zeros(samples)
        question = fingerprint(("late", parts, held, loop.step_s, loop.starts), loop.output, loop.process_value,
                               loop.setpoint, loop.used)
        return loop.memory.answer(question, lambda: late_moves(loop, parts, held=held))

    @property
    def pace(self) -> float:
        """Mean distance in samples from one PV that counts to the next: the length of a lag of the noise model."""
        return pace_of(self.good(), self.loop.starts)

    @property
    def head(self) -> int:
        """Number of entries of a point before those of the effects."""
        return len(BASE) + len(self.forces) - 1

    def filter_columns(self, columns: FloatArray) -> FloatArray:
        """Columns (n, c) passed through the noise filter of the model, which starts anew with every segment."""
        landed = columns if self.landing is None else self.landing.applied(columns)
        return whiten(landed, self.taps, None if self.links is None else self.links.before)

    def own_columns(self, base: FloatArray, offsets: tuple[int, ...]) -> FloatArray:
        """Columns (k, n, P) stacked by `responses`; a column of one segment is zero in all others."""
        return np.stack([base[o:o + self.loop.samples] for o in offsets])

    def _axes(self) -> tuple[Parameter, ...]:
        step, period, fixed = self.step_s, self.period_s, self.spec.fixed
        hi_T = 20.0 * period if self.spec.process == FIRST_ORDER else 2.0 * period
        reach = S_OVER_S_MAX * self.s_max * max((e.reach for e in self.effects), default=1.0)
        base = [
            Parameter("S", "%", _SMALLEST_S * self.s_max, reach, 0.0, "stickband plus deadband"),
            Parameter("J", "S", 0.0, 1.0 if self.law.one_parameter else J_OVER_S, 0.0, "slip jump"),
            Parameter("initial_residual_force", "f_s", -1.0, 1.0, 0.0, "e(0) as a share of f_s"),
            Parameter("time_constant_s", "s", 0.02 * step, hi_T, 0.0, "lag of the process", log=True),
            Parameter("dead_time_s", "s", 0.0, max(0.6 * period, 5.0 * step), 0.0, "dead time of the process"),
        ]
        base = [replace(p, low=fixed[p.name], high=fixed[p.name], log=False) if p.name in fixed else p for p in base]
        if self.spec.friction_free:
            base[:3] = [replace(p, low=0.0, high=0.0) for p in base[:3]]
        further = [replace(base[2], name=f"{BASE[2]}_{i + 1}") for i in range(1, len(self.forces))]
        return tuple(base) + tuple(further) + tuple(p for e in self.effects for p in e.parameters_for(self.context))

    def _drift_profile(self) -> FloatArray:
        """Profile of the friction along the record, per unit of the drift rows; at most one effect may set it."""
        drifting = [(effect.name, effect.profile) for effect in self.effects if effect.profile]
        if len(drifting) > 1:
            raise ModelError(f"{drifting[0][0]} and {drifting[1][0]} both change friction with time",
                             "keep one of them")
        at = np.arange(self.context.command.size, dtype=np.float64)
        if not drifting:
            return np.zeros(at.size)
        return drifting[0][1](self.context.start_s + at * self.context.command_step_s)

    def context_of(self, option: str) -> Context:
        """Context for one effect: a measured disturbance gets its own tag only."""
        if option in self.context.extras:
            return replace(self.context, extras={option: self.context.extras[option]})
        return self.context

    def _effect_rows(self) -> list[slice]:
        at, rows = self.head, []
        for effect in self.effects:
            count = len(effect.parameters_for(self.context))
            rows.append(slice(at, at + count))
            at += count
        return rows

    def good(self) -> BoolArray:
        """Samples (n,) that may count: used, and with a finite process value."""
        y = self.loop.process_value
        counted = self.loop.used & np.isfinite(y)
        for effect in self.effects:
            if effect.counted:
                counted = counted & effect.counted(y)
        return counted

    def shared_columns(self) -> FloatArray:
        """Columns that all candidates share (n, q): the level, and the drift of an integrator out of balance.

        Tents make a level that wanders.
        """
        t = self.loop.time_s
        columns = [np.ones_like(t)]
        if self.spec.process == INTEGRATOR:
            columns.append(t / max(t[-1], 1.0))
        if self.spec.knots:
            at = t / max(t[-1], 1.0) * (self.spec.knots + 1)
            columns += [np.maximum(1.0 - np.abs(at - i), 0.0) for i in range(1, self.spec.knots + 2)]
        return np.stack(columns, axis=1)

    def values(self, cube: FloatArray) -> FloatArray:
        """Physical values (d, P) of points (P, d) in the unit cube; J in %, within the law's validity."""
        low, span, _ = self._scales
        cube = np.atleast_2d(cube)
        # One row in memory for each parameter: every kernel takes whole rows.
        values = np.empty((span.size, cube.shape[0]))
        values[:] = cube.T
        for row, power in self._powers:
            values[row] **= power
        values *= span[:, None]
        values += low[:, None]
        for row in self._logarithmic:
            np.exp(values[row], out=values[row])
        values[1] = values[0] if self.law.one_parameter else values[1] * values[0]
        for rows, seen in self._seen:
            values[rows] += seen.offset(values[0], values[1])
        return values

    def cube(self, values: FloatArray) -> FloatArray:
        """Points of the unit cube for physical values (d, P) with J in %."""
        moved = np.array(values, dtype=np.float64)
        for rows, seen in self._seen:
            moved[rows] -= seen.offset(moved[0], moved[1])
        moved[1] = moved[1] / np.maximum(moved[0], 1e-12)
        return self._searched.to_cube(moved)

    def positions(self, values: FloatArray, *, lent: bool = False) -> FloatArray:
        """Valve positions (n*substeps, P) in % of travel, stem and trim effects included.

        `lent` ones hold until the next call (see `scratch` in numerics/jit.py).
        """
        return self._beside_y(self._before_y(values, lent=lent), values)

    def _before_y(self, values: FloatArray, *, lent: bool = False) -> FloatArray:
        """Positions (n*substeps, P) before the first effect that follows y: they are the same for every guide."""
        return self._move_stem(self._by_law(values, lent=lent), values, takewhile(_ignores_y, self._effects_in_order()))

    def stem(self, values: FloatArray, position: FloatArray) -> FloatArray:
        """Positions (n*substeps, P) of the stem, before the trim; `position` are those after all effects."""
        if not any(effect.moves and effect.place not in _STEM for effect in self.effects):
            return position
        return self._move_stem(self._by_law(values), values, takewhile(_on_stem, self._effects_in_order()))

    def _by_law(self, values: FloatArray, *, lent: bool = False) -> FloatArray:
        """Positions (n*substeps, P) by the law and the effects on its friction."""
        if self._follows:
            return self._frictionless_path()[:, None].repeat(values.shape[1], axis=1)
        table = self.friction(values)
        position = self.law.positions(self.context.command, table, profile=self.profile, share=values[2],
                                      lent=lent)
        if not self.spec.held:
            rows, before = self.kicked
            after = position[rows]
            interval_means(self.context.command, table, self.profile, position)
            position[rows] = before[:, None] * position[rows - 1] + (1.0 - before)[:, None] * after
        repeat = self.loop.samples * self.parts // position.shape[0]
        return np.repeat(position, repeat, axis=0) if repeat > 1 else position

    def friction(self, values: FloatArray) -> FloatArray:
        """Friction table (ROWS, P) of the law for values (d, P), with the effects that change it."""
        table = self.law.searched_friction(values[0], values[1])
        for effect, rows in self._effects_in_order():
            if effect.friction:
                table = effect.friction(table, values[rows], self.context.command_step_s, self.spec.held)
        # (effects give the time of a change in seconds of the whole record)
        table[SINCE] = np.ceil((table[SINCE] - self.context.start_s) / self.context.command_step_s - _TIE)
        return table

    def _beside_y(self, position: FloatArray, values: FloatArray) -> FloatArray:
        """Positions (n*substeps, P) after all effects, from those of `_before_y`."""
        return self._move_stem(position, values, dropwhile(_ignores_y, self._effects_in_order()))

    def _effects_in_order(self) -> Iterator[tuple[Effect, slice]]:
        """The effects in the order in which they act, each with its rows in values (d, P)."""
        return zip(self.effects, self.effect_rows, strict=True)

    def _move_stem(self, position: FloatArray, values: FloatArray,
                   effects: Iterable[tuple[Effect, slice]]) -> FloatArray:
        """Positions (n*substeps, P) after some of the effects."""
        for effect, rows in effects:
            if effect.moves:
                position = effect.transformed(position, values[rows], self.context, values[4])
        return position

    def _frictionless_path(self) -> FloatArray:
        """Path (n*substeps,) of a valve without friction: the command, or its mean over each part where it moves."""
        command = self.context.command
        if self.spec.held:
            return command
        means = np.append(command[:1], 0.5 * (command[1:] + command[:-1]))
        rows, before = self.kicked
        means[rows] = before * means[rows - 1] + (1.0 - before) * command[rows]
        return means

    def dynamics(self, values: FloatArray) -> Dynamics:
        dynamics = Dynamics(values[3], values[4], np.zeros(values.shape[1]), self.spec.process == INTEGRATOR,
                            since_s=self.context.start_s)
        for effect, rows in self._effects_in_order():
            if effect.dynamics:
                dynamics = effect.dynamics(dynamics, values[rows])
        return dynamics

    def responses(self, values: FloatArray, position: FloatArray | None = None, *,
                  filtered: bool = True, lent: bool = False) -> tuple[FloatArray, tuple[int, ...]]:
        """Own columns of every candidate stacked in one array (rows, P), with the first row of each column.

        The response of the process comes first, then the columns of linear effects, then start-up transients. A `lent`
        stack holds until the next call (see `scratch` in numerics/jit.py).
        """
        if position is None:
            position = self._frictionless_path()[:, None] if self._follows else self.positions(values, lent=True)
        dynamics = self.dynamics(values)
        respond = partial(free_run, dynamics=dynamics, step_s=self.step_s, substeps=self.parts,
                          ahead=not self.spec.held)
        n = self.loop.samples
        columns: list[FloatArray] = []
        for effect, rows, option in zip(self.effects, self.effect_rows, self.options, strict=True):
            if effect.columns:
                for column in effect.columns(values[rows], self.context_of(option)):
                    if effect.enters_ahead(option):
                        column = respond(np.repeat(column, self.parts, axis=0))
                    columns.append(column)
        # An unknown start decays with every lag and every state of an element.
        lags = [lag for lag in (dynamics.time_constant_s, dynamics.second_time_constant_s) if np.count_nonzero(lag)]
        count = 1 + len(columns) + len(lags) + sum(e.order for e in dynamics.elements)
        base = respond(position, room=(count - 1) * n, lent=lent)
        for i, column in enumerate(columns, 1):
            base[i * n:(i + 1) * n] = column
        at = 1 + len(columns)
        for i, lag in enumerate(lags, at):
            transient(lag, base[i * n:(i + 1) * n], step_s=self.step_s)
        at += len(lags)
        for element in dynamics.elements:
            modes(element, base[at * n:(at + element.order) * n], step_s=self.step_s)
            at += element.order
        if filtered and self.landing is not None:
            self.landing.apply_stack(base, n)
        if filtered and self.taps.size:
            whiten_stack(base, n, self.taps, None if self.links is None else self.links.before)
        return base, tuple(i * n for i in range(count))

    def starts_of(self, values: FloatArray) -> int:
        """Number of start-up columns of values (d,) in one segment: one for every lag and every state of an element."""
        dynamics = self.dynamics(values.reshape(-1, 1))
        lags = (dynamics.time_constant_s, dynamics.second_time_constant_s)
        return sum(bool(lag.any()) for lag in lags) + sum(e.order for e in dynamics.elements)

    def disturbance(self, values: FloatArray, own: FloatArray, *, loads: bool = True) -> FloatArray:
        """Contribution of the linear effects to y (n,), for values (d,) and the coefficients of all own columns.

        Without `loads`, the contribution of those that act behind the process only.
        """
        columns = self.own_columns(*self.responses(values[:, None], filtered=False))[:, :, 0]
        total = np.zeros(self.loop.samples)
        for (_, at), effect, option in zip(self.sizes_at(values), self.effects, self.options, strict=True):
            if loads or not effect.enters_ahead(option):
                total += own[at] @ columns[at]
        return total

    def sizes_at(self, values: FloatArray) -> list[tuple[str, slice]]:
        """Names of the effects, each with where its sizes stand among the own coefficients of values (d,)."""
        found, at = [], 1
        for name, effect, rows, option in zip(self.names, self.effects, self.effect_rows, self.options, strict=True):
            count = len(effect.columns(values[rows, None], self.context_of(option))) if effect.columns else 0
            found.append((name, slice(at, at + count)))
            at += count
        return found

    def sizes_of(self, name: str, values: FloatArray, own: FloatArray) -> FloatArray:
        """Linear coefficients of one effect, out of all own coefficients of values (d,)."""
        return own[dict(self.sizes_at(values))[name]]

    def split(self, rows: NDArray[Kind]) -> list[NDArray[Kind]]:
        """An array (n * parts, …) cut at the segments."""
        return [rows]

    def named(self, values: FloatArray) -> dict[str, float]:
        """Physical values (d,) by name; an effect's parameters carry the effect's name before a colon."""
        return {name: float(v) for name, v in zip(self._labels, values, strict=True)}

    @property
    def follows_y(self) -> bool:
        """True where an effect of the model follows y."""
        return any(effect.follows_y for effect in self.effects)

    def rows_of(self, name: str) -> slice:
        """Rows of the effect of that name in values (d,)."""
        return self.effect_rows[self.names.index(name)]

    def vector(self, named: dict[str, float]) -> FloatArray:
        """The inverse of `named`; parameters that are missing take their neutral value."""
        missing = [name for name in BASE if name not in named]
        if missing:
            raise ModelError(f"the model lacks a value for {missing[0]}", "run stictionid identify again")
        return np.array([named.get(name, p.neutral) for name, p in zip(self._labels, self.space.parameters,
                                                                       strict=True)])

    def describe(self, values: FloatArray) -> dict[str, Any]:
        """Description by which this model runs again without a search (see `rerun` in model/restore.py)."""
        s = self.spec
        written = {e.name: {"file": e.file, "sha256": e.sha256} for e in self.effects if e.file}
        return {"law": s.law, "process": s.process, "effects": list(s.effects), "between": s.between,
                "substeps": s.substeps, "increments": s.increments, "taps": list(s.taps), "fixed": dict(s.fixed),
                "friction_free": s.friction_free, "guides": list(s.guides), "s_max": self.s_max,
                "period_s": self.period_s, "values": self.named(values),
                **({"command": self.loop.followed} if self.loop.followed else {}),
                **({"paths": s.paths.description()} if s.paths is not None else {}),
                **({"written": written} if written else {}),
                **({"written_law": {"file": self.law.file, "sha256": self.law.sha256}} if self.law.file else {})}


def _on_stem(item: tuple[Effect, slice]) -> bool:
    """True for an effect on friction or stem."""
    return item[0].place in _STEM


def _ignores_y(item: tuple[Effect, slice]) -> bool:
    """True for an effect that does not follow y."""
    return not item[0].follows_y
