"""Adapter from functions of plain numpy to an effect: a user's file needs no kernel.

A file gives one of `valve(position, time_s, **parameters)`, `process(input, time_s, **parameters)`, `tf(**parameters)`,
`ss(**parameters)` and `disturbance(time_s, **parameters)`. `valve` returns the position of the trim (n,). `process` is
a unit of gain 1 in series with the process, and its input (n,) begins at 0, at rest. `tf` returns numerator and
denominator of such a unit in falling powers of s, and `ss` its A, B, C and D; both run in a kernel. `disturbance`
returns columns (n,) or (n, k) at the output, whose sizes are fitted.

Functions are called once a candidate, or once for all where they treat a table (n, P) as P separate signals. They get
arrays that they can't write to. A candidate whose output is not finite counts as a valve that never moves.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any

import numpy as np

from ...errors import DataError, StictionidError
from ...numerics.parameters import Parameter
from ...process.linear import Dynamics
from ...process.state_space import Element, element_of
from ...system.user_code import fault, line_in
from ...typing import FloatArray
from . import Context, Disturbance, Effect, Mover, Place, Values

KINDS = ("valve", "process", "tf", "ss", "disturbance")
# Number of signals that a function of each kind takes before its parameters.
SIGNALS = {"valve": 2, "process": 2, "tf": 0, "ss": 0, "disturbance": 1}
# Shares of the ranges at which parameters start where a file has no guess; two are tried for more than two parameters.
_SHARES, _FEW_SHARES = (0.15, 0.5, 0.85), (0.25, 0.75)
# Parts of a sample at which a function with a memory is called in a simulation.
_PARTS = 4


@dataclass(frozen=True, slots=True)
class Function:
    """A function of a user's file; a call that fails is a DataError with file and line."""

    file: str
    kind: str
    call: Callable[..., Any]
    names: tuple[str, ...]

    @property
    def line(self) -> int:
        """Line of the file where the function begins."""
        code = getattr(self.call, "__code__", None)
        return code.co_firstlineno if code is not None else 1

    def __call__(self, *signals: FloatArray, **values: Any) -> Any:
        """The result of the function for signals that it can't write to."""
        given = map(_untouchable, signals)
        try:
            with np.errstate(all="ignore"), redirect_stdout(sys.stderr):
                return self.call(*given, **values)
        except StictionidError:
            raise
        except (Exception, SystemExit) as error:
            words = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
            if "read-only" in words:
                words = "the function changes its input; work on a copy, position.copy()"
            raise fault(self.file, line_in(error, self.file),
                        f"{self.kind}() fails ({words}) for {said(values)}; correct this line") from None

    def signal(self, *signals: FloatArray, **values: Any) -> FloatArray:
        """A result of the shape of the first signal, as numbers."""
        return self._numbers(self(*signals, **values), signals[0].shape, values)

    def columns(self, time_s: FloatArray, **values: Any) -> FloatArray:
        """Columns (n, k) of a disturbance."""
        found = self(time_s, **values)
        return self._numbers(found, (time_s.size, *np.shape(found)[1:2]), values).reshape(time_s.size, -1)

    def _numbers(self, found: Any, shape: tuple[int, ...], values: Mapping[str, Any]) -> FloatArray:
        try:
            if np.iscomplexobj(found):
                raise TypeError
            numbers = np.asarray(found, dtype=np.float64)
        except (TypeError, ValueError):
            what = "complex numbers" if np.iscomplexobj(found) else type(found).__name__
            raise fault(self.file, self.line, f"{self.kind}() returns {what} for {said(values)}; return an array of "
                        "numbers") from None
        if numbers.shape != shape:
            raise fault(self.file, self.line, f"{self.kind}() returns shape {numbers.shape} for {said(values)}; return "
                        f"shape {shape}")
        return numbers


def _untouchable(signal: FloatArray) -> FloatArray:
    """A view of a signal that can't be written to."""
    view = signal.view()
    view.flags.writeable = False
    return view


def said(values: Mapping[str, Any]) -> str:
    """Parameters in words."""
    return ", ".join(f"{k}={float(v):.4g}" if np.ndim(v) == 0 else f"{k}=…" for k, v in values.items()) or "no values"


@dataclass(frozen=True, slots=True)
class PlainEffect(Effect):
    """An effect whose valve or process is a function of plain numpy.

    `lanewise` is true where the function treats a table (n, P) as P signals; `memory` where its output depends on what
    came before.
    """

    function: Function | None = None
    lanewise: bool = False
    memory: bool = True

    @property
    def moves(self) -> bool:
        """True where the function transforms the valve position."""
        return self.function is not None

    def transformed(self, signal: FloatArray, theta: FloatArray, context: Context,
                    dead_time_s: FloatArray | None = None) -> FloatArray:
        """The whole signal (rows, P) through the function; rejected candidates rest at 0."""
        rows = signal.shape[0]
        part_s = context.step_s * context.process_value.size / rows
        time_s = context.start_s + np.arange(rows, dtype=np.float64) * part_s
        level = signal[:1] if self.place is Place.PROCESS else np.zeros((1, signal.shape[1]))
        out = level + self.across(signal - level, time_s, theta)
        return np.ascontiguousarray(np.where(np.isfinite(out).all(axis=0), out, 0.0))

    def across(self, signal: FloatArray, time_s: FloatArray, theta: FloatArray) -> FloatArray:
        """The function's output (rows, P) for all candidates."""
        assert self.function is not None
        if self.lanewise:
            return self.function.signal(signal, time_s[:, None], **dict(zip(self.function.names, theta, strict=True)))
        return one_by_one(self.function, signal, time_s, theta)

    def mover(self, start: float, theta: FloatArray, step_s: float) -> Mover:
        """The function for a simulation; one with a memory is called at every quarter of a sample with its past."""
        function, process = self.function, self.place is Place.PROCESS
        assert function is not None
        values = dict(zip(function.names, theta[:, 0].tolist(), strict=True))
        level = start if process else 0.0
        past: list[float] = []
        last = [start]

        def move(position: float, y: float, time_s: float, part_s: float) -> float:
            if not self.memory:
                return level + float(function.signal(np.array([position - level]), np.array([time_s]), **values)[0])
            if time_s * _PARTS + 1e-9 * step_s >= len(past) * step_s:
                past.append(position - level)
                at = np.arange(len(past), dtype=np.float64) * (step_s / _PARTS)
                last[0] = level + float(function.signal(np.array(past), at, **values)[-1])
            return last[0]

        return move


def one_by_one(function: Function, signal: FloatArray, time_s: FloatArray, theta: FloatArray) -> FloatArray:
    """Output (rows, P) of a function that is called once a candidate; equal neighbours are called once."""
    out = np.empty(signal.shape)
    for p in range(signal.shape[1]):
        if p and (theta[:, p] == theta[:, p - 1]).all() and (signal[:, p] == signal[:, p - 1]).all():
            out[:, p] = out[:, p - 1]
            continue
        values = dict(zip(function.names, theta[:, p].tolist(), strict=True))
        out[:, p] = function.signal(np.ascontiguousarray(signal[:, p]), time_s, **values)
    return out


def elements_of(function: Function, theta: FloatArray) -> Element:
    """The coefficients of `tf` or `ss` for candidates theta (k, P), filled up to the largest order among them."""
    each = [coefficients(function, dict(zip(function.names, column.tolist(), strict=True))) for column in theta.T]
    order = max(e.order for e in each)
    lanes = len(each)
    A, B = -np.eye(order)[None].repeat(lanes, axis=0), np.zeros((lanes, order))
    C, D = np.zeros((lanes, order)), np.empty(lanes)
    for p, e in enumerate(each):
        m = e.order
        A[p, :m, :m], B[p, :m], C[p, :m], D[p] = e.A[0], e.B[0], e.C[0], e.D[0]
    return Element(A, B, C, D)


def coefficients(function: Function, values: Mapping[str, float]) -> Element:
    """The element of one candidate; a DataError names what is wrong with its coefficients."""
    found = function(**values)
    form = "numerator and denominator" if function.kind == "tf" else "A, B, C and D"

    def refuse(words: str) -> DataError:
        return fault(function.file, function.line, f"{function.kind}() {words} for {said(values)}; return {form}")

    try:
        parts = [np.asarray(part, dtype=np.float64) for part in found]
    except (TypeError, ValueError):
        raise refuse("returns no numbers") from None
    if len(parts) != (2 if function.kind == "tf" else 4) or not all(np.isfinite(part).all() for part in parts):
        raise refuse("returns something else, or numbers that are not finite")
    if function.kind == "ss":
        A = np.atleast_2d(parts[0])
        m = A.shape[0] if parts[0].size else 0
        if A.size != m * m or parts[1].size != m or parts[2].size != m or parts[3].size != 1:
            raise refuse("returns matrices that don't fit each other")
        return Element(A.reshape(1, m, m), parts[1].reshape(1, m), parts[2].reshape(1, m), parts[3].reshape(1))
    top, bottom = (np.trim_zeros(np.atleast_1d(part), "f") for part in parts)
    if not bottom.size or top.size > bottom.size:
        raise refuse("returns a numerator of higher order than its denominator")
    top = np.concatenate([np.zeros(bottom.size - top.size), top])
    return element_of(top[:, None], bottom[:, None])


def default_guess(parameters: tuple[Parameter, ...]) -> FloatArray:
    """Starting points (g, k) spread over the ranges, for a file without a guess."""
    shares = _SHARES if len(parameters) < 3 else _FEW_SHARES
    if len(parameters) > 4:
        return np.array([[_at(p, share) for p in parameters] for share in _SHARES])
    return np.array([[_at(p, share) for p, share in zip(parameters, point, strict=True)]
                     for point in product(shares, repeat=len(parameters))]).reshape(-1, len(parameters))


def _at(p: Parameter, share: float) -> float:
    return float(p.low * (p.high / p.low) ** share) if p.log else p.low + share * (p.high - p.low)


def guesses(call: Function | None, parameters: tuple[Parameter, ...], context: Context) -> FloatArray:
    """Starting points (g, k) of the user's `guess(record)`, within the ranges."""
    if call is None:
        return default_guess(parameters)
    try:
        arrays: dict[str, Any] = {f.name: _untouchable(getattr(context, f.name)) for f in fields(context)
                                  if isinstance(getattr(context, f.name), np.ndarray)}
        record = replace(context, **arrays)
        found = call.call(record)
        points = [found] if isinstance(found, Mapping) else list(found)
        unknown = {name for point in points for name in point} - {p.name for p in parameters}
        table = np.array([[float(point.get(p.name, p.neutral)) for p in parameters] for point in points])
    except StictionidError:
        raise
    except (Exception, SystemExit) as error:
        raise fault(call.file, max(line_in(error, call.file), call.line),
                    f"guess() fails ({type(error).__name__}: {error}); return a list of {{name: value}}") from None
    if unknown:
        raise fault(call.file, call.line, f"guess() names {', '.join(sorted(map(str, unknown)))}, which is not in "
                    f"PARAMETERS; use {', '.join(p.name for p in parameters) or 'no name'}")
    if not table.size or not np.isfinite(table).all():
        raise fault(call.file, call.line, "guess() returns no finite numbers; return a list of {name: value}")
    low, high = (np.array(ends) for ends in ([p.low for p in parameters], [p.high for p in parameters]))
    return np.asarray(np.minimum(np.maximum(table, low), high), dtype=np.float64)


def disturbance_hooks(function: Function, searched: tuple[Parameter, ...], sizes: tuple[Parameter, ...],
                      ) -> dict[str, Any]:
    """Hooks of an effect that adds columns: columns, and the disturbance of a simulation."""
    names = [p.name for p in searched]

    def columns(theta: FloatArray, context: Context) -> tuple[FloatArray, ...]:
        each = [function.columns(context.time_s, **dict(zip(names, column.tolist(), strict=True)))
                for column in theta.T]
        table = np.nan_to_num(np.stack(each, axis=2), posinf=0.0, neginf=0.0)
        return tuple(np.ascontiguousarray(table[:, i]) for i in range(len(sizes)))

    def disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
        table = function.columns(time_s, **{name: values[name] for name in names})
        wave = table @ np.array([values[p.name] for p in sizes])
        return wave, np.zeros_like(wave), {}

    return {"columns": columns, "disturb": disturb}


def dynamics_hook(function: Function) -> Callable[[Dynamics, FloatArray], Dynamics]:
    """The hook of an effect that is one more linear element of the process."""
    def dynamics(before: Dynamics, theta: FloatArray) -> Dynamics:
        return replace(before, elements=(*before.elements, elements_of(function, theta)))

    return dynamics
