"""Loader of user-written effects: a file is run, held to the contract for plain numpy, and turned into an `Effect`.

A file's code runs only here. The command line, the environment variable STICTIONID_EFFECTS and installed packages name
files; a study or a data file never does. Each fault is one line with file, line and the next thing to do.
"""

from __future__ import annotations

import hashlib
import inspect
import math
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...errors import DataError
from ...numerics.parameters import Parameter
from ...system.files import text_of
from ...system.user_code import LIMIT_S, fault, limited, opened, said_by
from ...typing import FloatArray
from . import Context, Effect, Place
from .plain import (
    KINDS,
    SIGNALS,
    Function,
    PlainEffect,
    coefficients,
    disturbance_hooks,
    dynamics_hook,
    guesses,
    one_by_one,
    said,
)

# Samples of the signal that functions are tried on.
_SAMPLES = 240
# Shares of the ranges at which functions are compared with themselves, and at which they must return numbers.
_TRIED, _CALLED = (0.1, 0.5, 0.9), (0.0, 0.01, 0.1, 0.5, 0.9, 1.0)
# Time of a model with a kernel for a sample of a candidate, in s (measured: 4 to 6 ns); the factor from which a
# function is called slow; candidates of a table and times that a function is timed.
_MODEL_S, SLOW, _LANES, _TIMED = 5e-9, 10.0, 64, 3
# Largest difference from its input that counts as none, as a share of the largest value.
_SAME = 1e-9
# The same for coefficients, whose shortest lag may stand for none, at these frequencies. Units: 1, rad / s.
_NEAR, _FREQUENCIES = 1e-3, (1e-3, 0.1, 10.0)
# Factor by which a neutral value is raised to see whether the effect vanishes at infinity only.
_FURTHER = 10.0
_KEYS = {"unit", "range", "neutral", "meaning", "log"}
_EXAMPLE = 'PARAMETERS = {"width": {"unit": "%", "range": (0, 20), "neutral": 0}}'
Tell = Callable[[str], None]


def load(path: Path, taken: Collection[str] = (), tell: Tell | None = None, limit_s: float = LIMIT_S) -> Effect:
    """The effect of a user's file; `taken` are names that it may not have, `tell` hears of every point it passes.

    UsageError where the file can't be read, DataError with file and line where it breaks the contract.
    """
    say = tell or (lambda words: None)
    text = text_of(path, "the effect file", hint="give a Python file with a valve, process or disturbance function",
                   encoding="utf-8-sig")
    with limited(limit_s, str(path)):
        effect = _built(str(path), text, taken, say)
    return replace(effect, file=str(path), sha256=hashlib.sha256(text.encode()).hexdigest())


def _built(file: str, text: str, taken: Collection[str], say: Tell) -> PlainEffect:
    module, lines, name = opened(file, text, taken, "effect", say)
    parameters = _parameters(file, module, lines.get("PARAMETERS", 1))
    function = _function(file, module, tuple(p.name for p in parameters))
    say(f"{name}: {function.kind}() with " + (", ".join(f"{p.name} [{p.unit}] from {p.low:g} to {p.high:g}, neutral "
                                                        f"{p.neutral:g}" for p in parameters) or "no parameters"))
    effect = _adapted(name, function, parameters, _rivals(file, module, lines.get("CONFUSED_WITH", 1)), module)
    context = _example()
    _called(function, parameters, say)
    if function.kind in ("valve", "process"):
        effect = replace(effect, lanewise=_is_lanewise(function, parameters), memory=_has_memory(function, parameters))
        effect = replace(effect, slower=_slower(effect, parameters))
        say("a table of candidates in one call" if effect.lanewise else "one call a candidate, as it treats one signal")
        if effect.slower >= SLOW:
            say(slowness(effect))
    assert effect.guess is not None
    say(f"{len(effect.guess(context))} starting points, all in range")
    return effect


def _parameters(file: str, module: ModuleType, line: int) -> tuple[Parameter, ...]:
    given = getattr(module, "PARAMETERS", {})

    def refuse(words: str) -> DataError:
        return fault(file, line, f"PARAMETERS {words}; write {_EXAMPLE}")

    if not isinstance(given, Mapping):
        raise refuse(f"is {type(given).__name__}, not a dictionary")
    found = []
    for name, says in given.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise refuse(f"has a name {name!r} that is no Python name")
        if not isinstance(says, Mapping) or not {"unit", "range", "neutral"} <= set(says) <= _KEYS:
            raise refuse(f"of {name} need unit, range and neutral, and may have meaning and log")
        try:
            low, high = (float(x) for x in says["range"])
            neutral = float(says["neutral"])
        except (TypeError, ValueError):
            raise refuse(f"of {name}: range is not two numbers, or neutral not one") from None
        if not (math.isfinite(low) and math.isfinite(high) and low < high and low <= neutral <= high):
            raise refuse(f"of {name}: range {low:g} to {high:g} does not hold neutral {neutral:g}")
        if says.get("log") and low <= 0.0:
            raise refuse(f"of {name}: a logarithmic range begins above 0")
        found.append(Parameter(name, str(says["unit"]), low, high, neutral, str(says.get("meaning", name)),
                               log=bool(says.get("log", False))))
    return tuple(found)


def _function(file: str, module: ModuleType, names: tuple[str, ...]) -> Function:
    given = [kind for kind in KINDS if callable(getattr(module, kind, None))]
    if len(given) != 1:
        raise fault(file, 1, f"it defines {' and '.join(given) or 'none'} of {', '.join(KINDS)}; define exactly one")
    function = Function(file, given[0], getattr(module, given[0]), names)
    signals = SIGNALS[function.kind]
    try:
        inspect.signature(function.call).bind(*[None] * signals, **dict.fromkeys(names))
    except (TypeError, ValueError) as error:
        first = {"valve": "position, time_s, ", "process": "input, time_s, ", "disturbance": "time_s, "}
        raise fault(file, function.line, f"{function.kind}() does not take its arguments ({error}); write def "
                    f"{function.kind}({first.get(function.kind, '')}{', '.join(names)})") from None
    return function


def _rivals(file: str, module: ModuleType, line: int) -> tuple[str, ...]:
    """Names of the effects that look alike."""
    given = getattr(module, "CONFUSED_WITH", ())
    if isinstance(given, str) or not isinstance(given, Collection) or not all(isinstance(name, str) for name in given):
        raise fault(file, line, 'CONFUSED_WITH holds no names of effects; write CONFUSED_WITH = ("extra-lag",)')
    return tuple(given)


def _adapted(name: str, function: Function, parameters: tuple[Parameter, ...], rivals: tuple[str, ...],
             module: ModuleType) -> PlainEffect:
    summary, equation = said_by(module, f"{name}, a user-written effect")
    call = getattr(module, "guess", None)
    guess = Function(function.file, "guess", call, ()) if callable(call) else None
    searched = parameters

    def starts(context: Context) -> FloatArray:
        return guesses(guess, searched, context)

    sizes: tuple[Parameter, ...] = ()
    hooks: dict[str, Any] = {}
    kind, place = "T", Place.TRIM if function.kind == "valve" else Place.PROCESS
    if function.kind == "disturbance":
        neutral = {p.name: p.neutral for p in parameters}
        count = function.columns(np.arange(4.0), **neutral).shape[1]
        sizes = tuple(Parameter("size" if count == 1 else f"size_{i + 1}", "unit of y", -1e9, 1e9, 0.0,
                                "size of the disturbance") for i in range(count))
        kind, place, hooks = "L", Place.DISTURBANCE, disturbance_hooks(function, searched, sizes)
    elif function.kind in ("tf", "ss"):
        hooks = {"dynamics": dynamics_hook(function)}
    return PlainEffect(
        name=name, kind=kind, place=place, summary=summary,
        equation=equation or f"{function.kind}() of {Path(function.file).name}",
        source=f"user-written, {Path(function.file).name}", parameters=(*parameters, *sizes),
        searched=tuple(p.name for p in parameters), confused_with=rivals, guess=starts,
        function=function if function.kind in ("valve", "process") else None, **hooks)


def _called(function: Function, parameters: tuple[Parameter, ...], say: Tell) -> None:
    """Call a function at its neutral values and within its ranges, and compare with what it must return."""
    neutral = {p.name: p.neutral for p in parameters}
    points = [neutral, *({p.name: p.low + share * (p.high - p.low) for p in parameters} for share in _CALLED)]
    position, time_s = _signal()
    shapes = set()
    for values in points:
        if function.kind in ("tf", "ss"):
            element = coefficients(function, values)
            pole = np.linalg.eigvals(element.A[0]).real.max(initial=-np.inf)
            if not pole < 0.0:
                raise fault(function.file, function.line, f"{function.kind}() does not settle for {said(values)}: a "
                            f"pole stands at {pole:.3g} rad/s; return coefficients whose poles are all below 0")
            gain = _gain(element, 0.0)
            if not abs(gain - 1.0) < 1e-6:
                raise fault(function.file, function.line, f"{function.kind}() has a gain of {gain.real:.4g} for "
                            f"{said(values)}; return coefficients of gain 1, as the gain is fitted beside them")
            continue
        signal = position if function.kind == "valve" else position - position[0]
        found, again = (function.columns(time_s, **values) if function.kind == "disturbance" else
                        function.signal(signal, time_s, **values) for _ in range(2))
        shapes.add(found.shape)
        if len(shapes) > 1:
            raise fault(function.file, function.line, f"disturbance() returns other columns for {said(values)} than "
                        f"for {said(neutral)}; return the same number for all values")
        if not np.isfinite(found).all():
            raise fault(function.file, function.line, f"{function.kind}() returns NaN or infinity for {said(values)}; "
                        "return a finite number for every sample")
        still = function.signal(0.0 * signal, time_s, **values) if function.kind == "process" else np.zeros(1)
        if (moved := np.abs(still).max()) > 0.0:
            raise fault(function.file, function.line, f"process() moves by {moved:.3g} while its input rests at 0, for "
                        f"{said(values)}; begin at rest, at 0")
        if not np.array_equal(found, again):
            raise fault(function.file, function.line, f"{function.kind}() returns other numbers when it is called "
                        "again; leave out random numbers and what it remembers")
    say("finite numbers of the right shape, the same for every call, and the input as it was")
    _neutral(function, neutral, position, time_s, say)


def _neutral(function: Function, neutral: dict[str, float], position: FloatArray, time_s: FloatArray,
             say: Tell) -> None:
    """Refuse an effect that does not vanish at its neutral values."""
    if function.kind == "disturbance":
        say("it vanishes at size 0")
        return
    linear = function.kind in ("tf", "ss")
    signal = position if function.kind == "valve" else position - position[0]

    def distance(values: dict[str, float]) -> float:
        if linear:
            element = coefficients(function, values)
            return max(abs(_gain(element, w) - 1.0) for w in _FREQUENCIES)
        return float(np.abs(function.signal(signal, time_s, **values) - signal).max() / np.abs(signal).max())

    away = distance(neutral)
    if not away <= (_NEAR if linear else _SAME):
        endless = _endless(distance, neutral, away)
        raise fault(function.file, function.line, f"{function.kind}() is not neutral at {said(neutral)}: it differs "
                    f"from its input by {100 * away:.3g} %; " + (
                        f"it comes nearer as {endless} grows, so neutral is at infinity: take the rate 1/{endless} as "
                        "the parameter, neutral 0" if endless else
                        "return the input there, or correct neutral in PARAMETERS"))
    say("it vanishes at the neutral values")
    if function.kind == "process":
        say("it rests while its input rests at 0")


def _endless(distance: Callable[[dict[str, float]], float], neutral: dict[str, float], away: float) -> str:
    """The parameter beyond whose neutral value the effect goes on vanishing; empty where there is none."""
    for name, value in neutral.items():
        try:
            if value and distance({**neutral, name: value * _FURTHER}) * _FURTHER < 2.0 * away:
                return name
        except DataError:  # the function was not made for values out of its range
            continue
    return ""


def _gain(element: Any, frequency: float) -> complex:
    """Gain of the first candidate's element at a frequency in rad / s."""
    m = element.order
    states = np.linalg.solve(1j * frequency * np.eye(m) - element.A[0], element.B[0]) if m else np.zeros(0)
    return complex(element.C[0] @ states + element.D[0])


def _signal() -> tuple[FloatArray, FloatArray]:
    """A valve position (n,) with slips, slides and rests between 35 and 65 %, and its time."""
    time_s = np.arange(_SAMPLES, dtype=np.float64)
    wave = 50.0 + 15.0 * np.sin(2.0 * np.pi * time_s / 80.0)
    return np.where(time_s % 40 < 20, np.round(wave / 4.0) * 4.0, wave), time_s


def _inside(parameters: tuple[Parameter, ...]) -> FloatArray:
    """Three points (k, 3) of the ranges."""
    return np.array([[p.low + share * (p.high - p.low) for share in _TRIED] for p in parameters]).reshape(-1, 3)


def _is_lanewise(function: Function, parameters: tuple[Parameter, ...]) -> bool:
    """True where a function treats a table (n, 3) as three signals, bit by bit as one after the other."""
    position, time_s = _signal()
    table = np.stack([position, position[::-1] - 3.0, np.roll(position, 7)], axis=1)
    theta = _inside(parameters)
    try:
        whole = function.signal(table, time_s[:, None], **dict(zip(function.names, theta, strict=True)))
    except DataError:
        return False
    return bool(np.array_equal(whole, one_by_one(function, table, time_s, theta)))


def _slower(effect: PlainEffect, parameters: tuple[Parameter, ...]) -> float:
    """Time of a model with the function, in that of one with a kernel."""
    position, time_s = _signal()
    lanes = _LANES if effect.lanewise else 1
    table = (position - position[0] * (effect.place is Place.PROCESS))[:, None].repeat(lanes, axis=1)
    theta = _inside(parameters)[:, 1:2].repeat(lanes, axis=1)
    taken = []
    for _ in range(_TIMED):
        begin = time.perf_counter()
        effect.across(table, time_s, theta)
        taken.append(time.perf_counter() - begin)
    return float(1.0 + min(taken) / (table.size * _MODEL_S))


def slowness(effect: Effect) -> str:
    """The words for an effect that slows a search down."""
    times = float(f"{effect.slower:.1g}")
    return f"{effect.name} is plain Python, some {times:,.0f} times slower than a kernel: a search with it takes longer"


def _has_memory(function: Function, parameters: tuple[Parameter, ...]) -> bool:
    """True where a function's output depends on more than the same sample."""
    position, time_s = _signal()
    signal = position - (position[0] if function.kind == "process" else 0.0)
    for column in _inside(parameters).T:
        values = dict(zip(function.names, column.tolist(), strict=True))
        whole = function.signal(signal, time_s, **values)
        try:
            each = [function.signal(signal[k:k + 1], time_s[k:k + 1], **values)[0] for k in range(_SAMPLES)]
        except DataError:
            return True
        if not np.array_equal(whole, each):
            return True
    return False


def _example() -> Context:
    """A record for the user's guess."""
    position, _ = _signal()
    return Context(position, np.roll(position, 5), np.full(_SAMPLES, 50.0), 1.0, 80.0, 30.0)
