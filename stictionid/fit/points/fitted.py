"""Best point of one model as a fit keeps it: values, restarts that agree, errors and intervals."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ...model.model import Model
from ...model.spec import Evaluated
from ...record.intervals import Span
from ...typing import FloatArray


@dataclass(frozen=True, slots=True)
class Fitted:
    """The best values (d,) of a model, the agreement of its restarts, and what else a step of a study reports."""

    model: Model
    values: FloatArray
    sse: float
    runs: int
    agree: int
    best: Evaluated
    rmse_holdout: float | None
    intervals: dict[str, tuple[float, float]]
    searched: FloatArray
    # Points (k, d) around the best ones and their costs (k,): starts for `widen_intervals`, and for the intervals of a
    # wider model.
    around: tuple[FloatArray, FloatArray] | None = None
    # Pieces of the intervals that have gaps.
    pieces: dict[str, tuple[Span, ...]] = field(default_factory=dict)
    # What was completed from this fit, with the model and values that it was completed from.
    completed: dict[str, tuple[Model, FloatArray, Any]] = field(default_factory=dict, repr=False, compare=False)

    def spans(self, name: str) -> tuple[Span, ...]:
        """The interval of a number in its pieces; none where it has no interval."""
        return self.pieces.get(name) or ((self.intervals[name],) if name in self.intervals else ())


def as_it_stands(model: Model, values: FloatArray) -> Fitted:
    """A model at values (d,) found elsewhere, ready for refits: no search, hold-out or intervals."""
    best = model.evaluate(values)
    return Fitted(model, values, best.sse, 1, 1, best, None, {}, values[None, :2])
