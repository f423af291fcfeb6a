"""Record of one control loop: read-only arrays of its signals on an even time grid, with their origin."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..typing import BoolArray, FloatArray
from .as_json.shape import inside

LARGEST = 1e38
"""Magnitude beyond which a number is no measurement, in any unit: what single precision holds; squares stay finite."""

# Errors below this share of y are those of arithmetic. Those below this share of its swing no transmitter resolves: its
# accuracy is 0.1 % of a span that is wider. A swing is seen in these stretches, because setpoint moves are no swing.
_ARITHMETIC, RESOLVED, _STRETCHES = 1e-10, 1e-3, 10


@dataclass(frozen=True, slots=True)
class AlikeLaws:
    """Laws that a record can't tell from the one that is kept, and the spans of S and J over them and over all laws."""

    alike: tuple[str, ...]
    kept: str
    S_alike: tuple[float, float]
    J_alike: tuple[float, float]
    S_all: tuple[float, float]
    J_all: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Finding:
    """Something noticed about data or model: a code for scripts, a sentence for people, the evidence as numbers.

    `severity` is "info", "warning" or "serious"; `suggests` names catalogue effects; `source` the test or rule. The
    keys of `evidence` decide nothing. The fields behind `source` do, and JSON holds them inside `evidence`.
    `caps_verdict` forbids a sure verdict. `no_intervals` withholds the intervals, and `ranges` stand for them. Each of
    the `stretches` where a model fails has its start and end in s.
    """

    code: str
    severity: str
    statement: str
    evidence: dict[str, Any] = field(default_factory=dict)
    suggests: tuple[str, ...] = ()
    source: str = ""
    caps_verdict: bool | None = field(default=None, kw_only=True, metadata=inside("evidence"))
    no_intervals: bool | None = field(default=None, kw_only=True, metadata=inside("evidence"))
    stretches: tuple[tuple[float, float], ...] | None = field(default=None, kw_only=True, metadata=inside("evidence"))
    laws: AlikeLaws | None = field(default=None, kw_only=True, metadata=inside("evidence"))


@dataclass(frozen=True, slots=True)
class Origin:
    """File, columns and options from which a loop was read; `report` finds and re-reads the data by them.

    `segment_starts` are the stamps of the first sample of every segment: the time of a Loop leaves the gaps out.
    """

    file: str | None = None
    sha256: str | None = None
    columns: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    rows: int = 0
    start: str | None = None
    end: str | None = None
    findings: tuple[Finding, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)
    segment_starts: tuple[str, ...] = ()


def bridged(signal: FloatArray) -> FloatArray:
    """A signal (n,) with straight lines where it is missing (NaN), so that filters run; 0 where it is all missing."""
    good = np.isfinite(signal)
    if good.all():
        return np.ascontiguousarray(signal, dtype=np.float64)
    if not good.any():
        return np.zeros(signal.size)
    return np.interp(np.arange(signal.size), np.flatnonzero(good), signal[good])


def _frozen(values: Any, dtype: type = np.float64) -> NDArray[Any]:
    if isinstance(values, np.ndarray) and values.dtype == dtype and values.ndim == 1 and values.flags.c_contiguous:
        base = values.base
        ours = base is None or (isinstance(base, np.ndarray) and not base.flags.writeable)
        if ours and not values.flags.writeable:
            return values  # already ours, or nobody's to change
    array: NDArray[Any] = np.array(values, dtype=dtype, order="C", copy=True).reshape(-1)
    array.setflags(write=False)
    return array


Answer = TypeVar("Answer")

MEMORABLE = 128
"""Number of answers that a memory keeps, the latest ones: those of a few rounds over the catalogue of effects."""


def fingerprint(told: object, *signals: NDArray[Any] | None) -> str:
    """A text that is equal for equal signals, and for equal things told beside them."""
    found = hashlib.blake2b(repr(told).encode())
    for signal in signals:
        found.update(b"" if signal is None else np.ascontiguousarray(signal).tobytes())
    return found.hexdigest()


class Memory:
    """Answers of long searches on one record, by a fingerprint of all that went into the question.

    `substitutes` holds coarser models by the model that they stand for, as long as that exists. `commands` holds the
    rebuilt commands of models, as long as one of these exists.
    """

    def __init__(self) -> None:
        self._answers: dict[str, Any] = {}
        self.substitutes: WeakKeyDictionary[Any, dict[int, Any]] = WeakKeyDictionary()
        self.commands: WeakValueDictionary[str, Any] = WeakValueDictionary()

    def __reduce__(self) -> tuple[type[Memory], tuple[()]]:
        # (it stays in its process)
        return Memory, ()

    def get(self, question: str) -> Any:
        """The answer to a question; None where it was not asked, or long ago."""
        return self._answers.get(question)

    def answer(self, question: str, work: Callable[[], Answer]) -> Answer:
        """The answer to a question, worked out where it was not asked, or long ago."""
        found: Answer | None = self.get(question)
        if found is None:
            found = work()
            self.keep(question, found)
        return found

    def keep(self, question: str, answer: Any) -> None:
        """Keep an answer, and forget the oldest one where there are too many."""
        self._answers[question] = answer
        while len(self._answers) > MEMORABLE:
            self._answers.pop(next(iter(self._answers)))


@dataclass(frozen=True, slots=True)
class Loop:
    """Setpoint r, controller output u and process value y sampled every `step_s` seconds.

    Shapes: all arrays (n,). Units: u in % of OP span unless `units["output"]` says otherwise, r and y in the
    unit of `units["process_value"]`, position in the unit of `units["position"]`. `setpoint` and `position` may
    be None. `used` (n,) marks samples that count; a False sample still drives the valve but enters no cost.
    `starts` holds the first index of every segment: nothing is continuous across a segment boundary. `begins_s` are
    the times of those samples in seconds since the first one, gaps included. Where it is empty, gaps take no time.
    `picked` are the first indices of the segments in the record from which `pick` took them. `followed` says which
    command the valve followed where that is known: the output as "rounded" by the controller, or the "full" one, which
    its law rebuilt with an error of the standard deviation `output_sd`. It is empty where nobody asked. `drawn` is True
    where a historian drew straight lines between the process values that it kept, and only these are left. `memory`
    keeps answers of long searches on this record; its parts share it, and no answer depends on it.
    Raises DataError when lengths differ or a used sample is not finite.
    """

    output: FloatArray
    process_value: FloatArray
    setpoint: FloatArray | None = None
    position: FloatArray | None = None
    extras: dict[str, FloatArray] = field(default_factory=dict)
    step_s: float = 1.0
    used: BoolArray = None  # type: ignore[assignment]  # __post_init__ makes one where none is given
    starts: tuple[int, ...] = (0,)
    begins_s: tuple[float, ...] = ()
    picked: tuple[int, ...] = ()
    followed: str = ""
    output_sd: float = 0.0
    drawn: bool = False
    units: dict[str, str] = field(default_factory=dict)
    name: str = "loop"
    origin: Origin = field(default_factory=Origin)
    memory: Memory = field(default_factory=Memory, repr=False, compare=False)

    def __post_init__(self) -> None:
        put = object.__setattr__
        for role in ("output", "process_value", "setpoint", "position"):
            if getattr(self, role) is not None:
                put(self, role, _frozen(getattr(self, role)))
        put(self, "extras", {tag: _frozen(values) for tag, values in self.extras.items()})
        put(self, "used", _frozen(np.ones(self.samples) if self.used is None else self.used, np.bool_))
        lengths = {"output": self.samples, "process value": self.process_value.size, "used": self.used.size}
        lengths |= {r: getattr(self, r).size for r in ("setpoint", "position") if getattr(self, r) is not None}
        lengths |= {tag: values.size for tag, values in self.extras.items()}
        if len(set(lengths.values())) > 1:
            raise DataError(f"signals of one loop differ in length: {lengths}", "give arrays of one length")
        if self.begins_s and len(self.begins_s) != len(self.starts):
            raise DataError(f"{len(self.starts)} segments, but {len(self.begins_s)} times at which they begin",
                            "give one time in seconds for each segment")
        if not (np.isfinite(self.step_s) and self.step_s > 0):
            raise DataError(f"sampling time {self.step_s} s is not a positive number", "give --step SECONDS")
        for tag, values in self.extras.items():
            if (np.abs(values[np.isfinite(values)]) > LARGEST).any():
                raise DataError(f"the further tag {tag} goes beyond {LARGEST:g}: no number there is a measurement",
                                "mask it first; read_loop does so")
        for role in ("output", "process_value", "setpoint"):
            values = getattr(self, role)
            if values is None:
                continue
            if (bad := self.used & ~np.isfinite(values)).any():
                raise DataError(f"{role.replace('_', ' ')} is not a finite number at sample {int(bad.argmax())}",
                                "mask or fill it first; read_loop does so")
            if (large := self.used & (np.abs(values) > LARGEST)).any():
                at = int(large.argmax())
                raise DataError(f"{role.replace('_', ' ')} is {values[at]:g} at sample {at}: beyond {LARGEST:g} no "
                                "number is a measurement", "mask it first; read_loop does so")

    @property
    def arithmetic_error(self) -> float:
        """Error in the unit of y below which a difference is one of arithmetic."""
        y = self.process_value[np.isfinite(self.process_value)]
        return _ARITHMETIC * float(np.abs(y).max(initial=0.0))

    @property
    def resolution(self) -> float:
        """Error in the unit of y that no transmitter resolves: 0.1 % of the middle range of ten stretches of y."""
        y = self.process_value[self.used]
        ranges = [float(np.ptp(part)) for part in np.array_split(y, _STRETCHES) if part.size]
        return max(RESOLVED * float(np.median(ranges)) if ranges else 0.0, self.arithmetic_error)

    @property
    def moving_extras(self) -> tuple[str, ...]:
        """Names of further tags that vary over the samples that count; a constant one disturbs nothing."""
        seen = {tag: values[self.used & np.isfinite(values)] for tag, values in self.extras.items()}
        return tuple(tag for tag, values in seen.items() if values.size and values.min() < values.max())

    @property
    def driven(self) -> BoolArray:
        """Samples (n,) whose output counts: those used, and those at which only the process value is missing."""
        return self.used | (np.isnan(self.process_value) & np.isfinite(self.output))

    @property
    def samples(self) -> int:
        """Number of samples of the record, used or not."""
        return int(self.output.size)

    @property
    def time_s(self) -> FloatArray:
        """Seconds since the first sample without the gaps, shape (n,)."""
        return np.arange(self.samples, dtype=np.float64) * self.step_s

    @property
    def clock_s(self) -> FloatArray:
        """Seconds since the first sample by the clock, gaps included, shape (n,)."""
        clock = self.time_s
        for part, begin in zip(self.segments, self.begins_s, strict=False):
            clock[part] += begin - part.start * self.step_s
        return clock

    @property
    def segments(self) -> tuple[slice, ...]:
        """Segments of the record (no gap inside), in order."""
        ends = (*self.starts[1:], self.samples)
        return tuple(slice(a, b) for a, b in zip(self.starts, ends, strict=True))

    def unit(self, role: str, default: str = "") -> str:
        """Unit of a role ("output", "process_value", "setpoint", "position"), or `default` where unknown."""
        return self.units.get(role) or default

    @property
    def longest(self) -> slice:
        """The samples of the longest segment."""
        return max(self.segments, key=lambda s: s.stop - s.start)

    def longest_segment(self) -> Loop:
        """The longest segment, as a loop of its own."""
        piece = self.longest
        return self if len(self.starts) == 1 else self.cut(piece.start, piece.stop)

    def cut(self, first: int, last: int) -> Loop:
        """Samples first..last-1 as a loop of their own."""
        def part(a: NDArray[Any] | None) -> Any:
            return None if a is None else a[first:last]

        return self._of([slice(first, last)], part, (first, *(s for s in self.starts if first < s < last)))

    def pick(self, pieces: Sequence[slice]) -> Loop:
        """The given segments of this loop, in order, as a loop that keeps their clock times."""
        def part(a: NDArray[Any] | None) -> Any:
            return None if a is None else np.concatenate([a[p] for p in pieces])

        return self._of(pieces, part, tuple(p.start for p in pieces))

    @classmethod
    def joined(cls, parts: Sequence[Loop], *, begins_s: tuple[float, ...] = ()) -> Loop:
        """Loops of one step and the same tags joined to one loop; each is a segment of it."""
        first = parts[0]

        def all_of(arrays: list[Any]) -> Any:
            return None if arrays[0] is None else np.concatenate(arrays)

        starts = tuple(np.cumsum([0, *(part.samples for part in parts[:-1])]).tolist())
        return replace(first, output=all_of([p.output for p in parts]),
                       process_value=all_of([p.process_value for p in parts]),
                       setpoint=all_of([p.setpoint for p in parts]), position=all_of([p.position for p in parts]),
                       used=all_of([p.used for p in parts]), starts=starts, begins_s=begins_s,
                       extras={tag: all_of([p.extras[tag] for p in parts]) for tag in first.extras})

    def _of(self, pieces: Sequence[slice], part: Callable[[Any], Any], firsts: tuple[int, ...]) -> Loop:
        sizes = np.cumsum([0, *(p.stop - p.start for p in pieces)])
        starts = tuple(int(size) + first - p.start for size, p in zip(sizes, pieces, strict=False)
                       for first in firsts if p.start <= first < p.stop)
        begins: tuple[float, ...] = ()
        if len(starts) > 1 and (self.begins_s or len(pieces) > 1):
            clock = self.clock_s
            begins = tuple(float(clock[first] - clock[firsts[0]]) for first in firsts)
        return replace(self, output=part(self.output), process_value=part(self.process_value),
                       setpoint=part(self.setpoint), position=part(self.position), used=part(self.used),
                       extras={tag: part(v) for tag, v in self.extras.items()}, starts=starts, begins_s=begins,
                       picked=firsts if len(pieces) > 1 else ())
