"""Model over several segments of a record: restarted in each, with one valve and one process for all.

S, J, the process and the effects are common. Each segment has an initial residual force of its own in the search. It
has a level, a drift (integrators) and start-up transients of its own in the least squares
(numerics/varpro_segments.py). Filters, the rebuilt command and the rows left out at the start begin anew with every
segment: nothing reaches across a gap. Effects that depend on time (drifts, sine waves, ramps) take the clock time,
gaps included.

Wrong where the valve or the process was changed during a gap: then each segment is a record of its own. Source:
docs/details.md, section 6.1; docs/traps.md, export trap 12.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..effects.contract import Context, Record
from ..numerics.jit import output
from ..numerics.varpro import Shared
from ..numerics.varpro_segments import Blockwise, block_columns
from ..record.loop import Loop
from ..typing import FloatArray
from .model import Model
from .response import Kind
from .slips import Paths
from .spec import BASE, Spec


def bind_model(loop: Loop, spec: Spec, *, s_max: float, period_s: float, residual: FloatArray | None = None,
               command: FloatArray | None = None, record: Record | None = None) -> Model:
    """The spec bound to a record: a plain model for one segment, a restarted one for several.

    `record` says where the segment of a plain model stands in a longer record.
    """
    if len(loop.starts) > 1:
        return Restarted(loop, spec, s_max=s_max, period_s=period_s, residual=residual, command=command)
    return Model(loop, spec, s_max=s_max, period_s=period_s, residual=residual, command=command, record=record)


def rebind_model(model: Model, spec: Spec, residual: FloatArray | None = None) -> Model:
    """Another spec bound to the record of a model; `residual` (n,) is that of the model so far."""
    return bind_model(model.loop, spec, s_max=model.s_max, period_s=model.period_s, residual=residual)


class Restarted(Model):
    """A `Spec` bound to several segments. Immutable after construction."""

    shared: Blockwise

    def __init__(self, loop: Loop, spec: Spec, *, s_max: float, period_s: float,
                 residual: FloatArray | None = None, command: FloatArray | None = None) -> None:
        self._name(loop, spec, s_max, period_s)
        self.thinned = command is not None
        self.forces = (*Model.forces, *range(len(BASE), len(BASE) + len(loop.starts) - 1))
        clock = loop.clock_s
        centre = float(np.mean(loop.setpoint if loop.setpoint is not None
                               else loop.process_value[np.isfinite(loop.process_value)]))
        m = 1 if command is None else command.size // loop.samples
        self._pieces = tuple(
            Model(loop.cut(p.start, p.stop), _of_segment(spec, i), s_max=s_max, period_s=period_s,
                  residual=None if residual is None else residual[p],
                  command=None if command is None else command[p.start * m:p.stop * m],
                  record=Record(float(clock[p.start]), float(clock[-1]) + loop.step_s, centre))
            for i, p in enumerate(loop.segments))
        parts = [piece.context for piece in self._pieces]
        self.context = Context(np.concatenate([c.command for c in parts]),
                               np.concatenate([c.process_value for c in parts]), loop.setpoint, loop.step_s,
                               period_s, s_max, dict(loop.extras), residual,
                               None if residual is None else np.concatenate([c.guide for c in parts]),
                               Record(0.0, float(clock[-1]) + loop.step_s, centre), spec.held)
        self._range()
        self.skip = min(piece.skip for piece in self._pieces)
        self.weight = np.concatenate([piece.weight for piece in self._pieces])
        self._join()

    def _join(self) -> None:
        """Put together what the candidates of all segments share."""
        self.target = np.concatenate([piece.target for piece in self._pieces])
        middle = self.values(np.full((1, self.space.size), 0.5))
        common = max([1, *(at.stop for _, at in self.sizes_at(middle[:, 0]))])
        self.shared = Blockwise(tuple(p.shared for p in self._pieces if isinstance(p.shared, Shared)), common)

    @property
    def pieces(self) -> tuple[Model, ...]:
        """The models of the segments."""
        return self._pieces

    def of(self, piece: int, values: FloatArray) -> FloatArray:
        """Values (d, P) of one segment's model, taken from those of all."""
        rows = [0, 1, self.forces[piece], 3, 4, *range(self.head, values.shape[0])]
        return values[rows]

    def split(self, rows: NDArray[Kind]) -> list[NDArray[Kind]]:
        """An array (n * parts, …) cut at the segments."""
        return np.split(rows, [start * (len(rows) // self.loop.samples) for start in self.loop.starts[1:]])

    def filter_columns(self, columns: FloatArray) -> FloatArray:
        """Columns (n, c) passed through the noise filter of the model, which starts anew with every segment."""
        return np.concatenate([piece.filter_columns(part) for piece, part in zip(self._pieces, self.split(columns),
                                                                                 strict=True)])

    def shared_columns(self) -> FloatArray:
        """Level and drift of every segment (n, q): all levels first."""
        return block_columns([piece.shared_columns() for piece in self._pieces])

    def _before_y(self, values: FloatArray, *, lent: bool = False) -> FloatArray:
        """Positions (n*parts, P) before the first effect that follows y, restarted in every segment; never lent."""
        return np.concatenate([piece._before_y(self.of(i, values)) for i, piece in enumerate(self._pieces)])

    def stem(self, values: FloatArray, position: FloatArray) -> FloatArray:
        """Positions (n*parts, P) of the stem, restarted in every segment."""
        return np.concatenate([piece.stem(self.of(i, values), part) for i, (piece, part)
                               in enumerate(zip(self._pieces, self.split(position), strict=True))])

    def _beside_y(self, position: FloatArray, values: FloatArray) -> FloatArray:
        """Positions (n*parts, P) after all effects, from those of `_before_y`."""
        return np.concatenate([piece._beside_y(part, self.of(i, values)) for i, (piece, part)
                               in enumerate(zip(self._pieces, self.split(position), strict=True))])

    def responses(self, values: FloatArray, position: FloatArray | None = None, *,
                  filtered: bool = True, lent: bool = False) -> tuple[FloatArray, tuple[int, ...]]:
        """Own columns of every candidate stacked in one array (rows, P), with the first row of each column.

        Column i of the whole record is made of column i of every segment. A `lent` stack holds until the next call.
        """
        given = [None] * len(self._pieces) if position is None else self.split(position)
        n, base, count = self.loop.samples, np.empty((0, 0)), 0
        for i, (piece, rows, known) in enumerate(zip(self._pieces, self.loop.segments, given, strict=True)):
            own, offsets = piece.responses(self.of(i, values), known, filtered=filtered, lent=True)
            if not count:
                count = len(offsets)
                base = output("segments", count * n, values.shape[1], lent)
            for j, o in enumerate(offsets):
                base[j * n + rows.start:j * n + rows.stop] = own[o:o + rows.stop - rows.start]
        return base, tuple(j * n for j in range(count))

    def piece_costs(self, values: FloatArray, shifts: int = 0) -> FloatArray:
        """Sums of squared residuals (shifts + 1, segments, P) of every segment fitted alone.

        For a dead time 0, 1, … `shifts` samples longer. A sum is lower than the segment's part in `costs_of`, because
        the segment has a gain of its own.
        """
        out = np.empty((shifts + 1, len(self._pieces), values.shape[1]))
        for lanes, part in self.blocks(values):
            base, offsets = self.responses(part, lent=True)
            for (i, (one, rows)), s in product(enumerate(zip(self.shared.blocks, self.loop.segments, strict=True)),
                                               range(shifts + 1)):
                cost = one.costs(base, tuple(o - s + rows.start for o in offsets))[:lanes.stop - lanes.start]
                # A valve that rests throughout a segment explains nothing of it, but may move in another.
                out[s, i, lanes] = np.where(np.isfinite(cost), cost, one.target_energy)
        return out

    def own_columns(self, base: FloatArray, offsets: tuple[int, ...]) -> FloatArray:
        """Columns (k, n, P) stacked by `responses`: common ones first, then every transient segment by segment."""
        whole = super().own_columns(base, offsets)
        common = self.shared.common
        local = np.zeros((len(whole) - common, len(self._pieces), *whole.shape[1:]))
        for i, part in enumerate(self.loop.segments):
            local[:, i, part] = whole[common:, part]
        return np.concatenate([whole[:common], local.reshape(-1, *whole.shape[1:])])

    def follow_guide(self, guide: FloatArray) -> Model:
        """The same model with effects that follow a given y (n,)."""
        other = self._copied()
        other.context = replace(self.context, guide=guide)
        other._pieces = tuple(piece.follow_guide(part)
                              for piece, part in zip(self._pieces, self.split(guide), strict=True))
        return other

    def along(self, paths: Paths | None) -> Model:
        """The same model with valves that slip where the paths, one for each segment, say; none: where the law does."""
        other = self._copied()
        other.spec = replace(self.spec, paths=paths)
        other._pieces = tuple(piece.along(_slips_of(paths, i)) for i, piece in enumerate(self._pieces))
        if any(piece.landing is not None for piece in (*self._pieces, *other._pieces)):
            other._join()
        return other

    def describe(self, values: FloatArray) -> dict[str, Any]:
        """Description by which this model runs again without a search, with its segments."""
        sizes = [p.stop - p.start for p in self.loop.segments]
        return {**super().describe(values),
                "segments": [[first, size] for first, size in zip(self.loop.picked, sizes, strict=True)]}


def _of_segment(spec: Spec, segment: int) -> Spec:
    """Spec of one segment's model: its own slips, and guides that start with the residual force of that segment."""
    spec = replace(spec, paths=_slips_of(spec.paths, segment))
    if not segment or not spec.guides:
        return spec
    name = BASE[2]
    guides = tuple({**guide, "values": {**guide["values"], name: guide["values"].get(f"{name}_{segment + 1}", 0.0)}}
                   for guide in spec.guides)
    return replace(spec, guides=guides)


def _slips_of(paths: Paths | None, segment: int) -> Paths | None:
    """The path of one segment, told with the residual force of that segment."""
    if paths is None:
        return None
    own = paths.of(segment)
    if not segment or own.landing is None:
        return own
    known = dict(own.landing.values)
    known[BASE[2]] = known.get(f"{BASE[2]}_{segment + 1}", 0.0)
    return replace(own, landing=replace(own.landing, values=tuple(known.items())))
