"""Loader of user-written laws: a file is run, held to the contract, and its step turned into a `Law`.

The step is compiled where numba can; else it runs in Python, some hundred times slower. It gets f_s and f_d of the
direction in which the command pulls, with everything that effects on friction add. Stops of travel are kept around it.
Overshoot and rest between scans are the law's own affair.
"""

from __future__ import annotations

import hashlib
import inspect
import math
from collections.abc import Callable, Collection
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
from numba import njit
from numba.core.errors import NumbaError

from ...errors import DataError, StictionidError
from ...system.files import text_of
from ...system.plurals import counted
from ...system.user_code import LIMIT_S, fault, limited, line_in, opened, said_by
from ...typing import FloatArray
from . import (
    FD_DOWN,
    FD_DRIFT,
    FD_UP,
    FS_DOWN,
    FS_DRIFT,
    FS_UP,
    LOWER,
    TIE,
    UPPER,
    Law,
    neutral_friction,
    rest_position,
)

Tell = Callable[[str], None]
Step = Callable[[float, float, float, FloatArray, float, float], float]
ARGUMENTS = "command, before, position, memory, f_s, f_d"
# Rows of the state before the memory: position and last command. Largest memory, in numbers.
_OWN, _MOST = 2, 64
# S and J in % at which a law is tried, and the tolerance of its distance from the command, in %.
_SIZES = ((5.0, 2.0), (4.0, 4.0), (3.0, 0.0), (1.0, 0.5))
_CLOSE = 1e-6


def load(path: Path, taken: Collection[str] = (), tell: Tell | None = None, limit_s: float = LIMIT_S) -> Law:
    """The law of a user's file; `taken` are names that it may not have, `tell` hears of every point it passes.

    UsageError where the file can't be read, DataError with file and line where it breaks the contract.
    """
    say = tell or (lambda words: None)
    text = text_of(path, "the law file", hint=f"give a Python file with def step({ARGUMENTS})",
                   encoding="utf-8-sig")
    file = str(path)
    with limited(limit_s, file):
        module, lines, name = opened(file, text, taken, "law", say)
        memory = _memory(file, module, lines.get("MEMORY", 1))
        step = _step(file, module)
        say(f"{name}: step() with {counted(len(memory), 'number')} of memory")
        law = _law(file, name, module, kernel_of(step), memory, hashlib.sha256(text.encode()).hexdigest())
        # In Python first: a compiled loop that does not end could not be stopped.
        _held(law, file, step.__code__.co_firstlineno, say)
    fast, why = _fast(step)
    if fast is None:
        say(f"it runs in Python, some 100 times slower than compiled: {why}")
        return law
    law = _law(file, name, module, fast, memory, law.sha256)
    _held(law, file, step.__code__.co_firstlineno, lambda words: None)
    say("it compiles")
    return law


def kernel_of(step: Step) -> Callable[..., None]:
    """A kernel over commands (n,) and candidates (P,) that calls a step, in Python."""
    def advance(command: FloatArray, friction: FloatArray, profile: FloatArray, state: FloatArray,
                position: FloatArray) -> None:
        for p in range(friction.shape[1]):
            memory = state[_OWN:, p].copy()
            place, before = float(state[0, p]), float(state[1, p])
            for k in range(command.size):
                u = float(command[k])
                opens = u > place
                fs = (friction[FS_UP, p] if opens else friction[FS_DOWN, p]) + friction[FS_DRIFT, p] * profile[k] + TIE
                fd = (friction[FD_UP, p] if opens else friction[FD_DOWN, p]) + friction[FD_DRIFT, p] * profile[k]
                place = min(max(step(u, before, place, memory, float(fs), float(fd)), friction[LOWER, p]),
                            friction[UPPER, p])
                position[k, p] = place
                before = u
            state[0, p], state[1, p] = place, before
            state[_OWN:, p] = memory

    return advance


def _fast(step: Step) -> tuple[Callable[..., None] | None, str]:
    """The compiled kernel of a step; None and the reason where numba can't compile it."""
    made = njit(error_model="numpy")(kernel_of(njit(error_model="numpy")(step)))
    try:
        made(np.zeros(2), neutral_friction(1.0, 0.5), np.zeros(2), np.zeros((_OWN + _MOST, 1)), np.zeros((2, 1)))
    except (NumbaError, TypeError, ValueError) as error:
        return None, str(error).strip().splitlines()[-1][:200]
    return made, ""


def _memory(file: str, module: ModuleType, line: int) -> tuple[float, ...]:
    """The numbers that a law remembers, as they are at the start."""
    found = getattr(module, "MEMORY", ())
    try:
        memory = tuple(float(x) for x in found)
    except (TypeError, ValueError):
        memory = (math.nan,)
    if len(memory) > _MOST or not all(map(math.isfinite, memory)):
        raise fault(file, line, f"MEMORY is {found!r:.60}, not up to {_MOST} numbers; write MEMORY = (0.0,)")
    return memory


def _step(file: str, module: ModuleType) -> Step:
    step: Any = getattr(module, "step", None)
    if not inspect.isfunction(step):
        raise fault(file, 1, f"it defines no function step; write def step({ARGUMENTS})")
    try:
        inspect.signature(step).bind(*[None] * 6)
    except TypeError as error:
        raise fault(file, step.__code__.co_firstlineno,
                    f"step() does not take its arguments ({error}); write def step({ARGUMENTS})") from None
    return cast(Step, step)


def _law(file: str, name: str, module: ModuleType, kernel: Callable[..., None], memory: tuple[float, ...],
         sha256: str) -> Law:
    summary, equation = said_by(module, f"{name}, a user-written law")

    def start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
        """State of a valve at rest with residual force share (P,) of f_s, within its stops."""
        state = np.empty((_OWN + len(memory), friction.shape[1]))
        state[0] = rest_position(command0, friction, share)
        state[1] = command0
        state[_OWN:] = np.array(memory)[:, None]
        return state

    return Law(name=name, summary=summary, equation=equation or f"step() of {Path(file).name}",
               source=f"user-written, {Path(file).name}", checked="held to the contract when it was loaded",
               cannot=str(getattr(module, "CANNOT", "nothing is said in its file")), run=kernel, start=start,
               one_parameter=bool(getattr(module, "ONE_PARAMETER", False)),
               sliding_state=None, file=file, sha256=sha256)


def _held(law: Law, file: str, line: int, say: Tell) -> None:
    """Hold a law to the contract on a command that turns, jumps and rests."""
    command = _command()

    def refuse(words: str) -> DataError:
        return fault(file, line, f"step() {words}")

    for S, J in _SIZES:
        friction = law.friction(S, J)
        first, again = _positions(law, command, friction, file, line), _positions(law, command, friction, file, line)
        size = f"at S = {S:g} and J = {J:g} %"
        if not np.isfinite(first).all():
            raise refuse(f"returns NaN or infinity {size}; return a finite position for every command")
        if not np.array_equal(first, again):
            raise refuse("returns other numbers when it is called again; leave out random numbers, and remember in "
                         "`memory` alone")
        if (far := float(np.abs(command - first).max()) - float(friction[FS_UP, 0])) > _CLOSE:
            raise refuse(f"leaves the stem {far:.3g} % further from the command than f_s {size}; a force above f_s "
                         "must move it")
        rest = np.flatnonzero(np.diff(command) == 0.0) + 1
        if (moved := np.abs(np.diff(first, prepend=first[0])[rest]).max()) > _CLOSE:
            raise refuse(f"moves the stem by {moved:.3g} % while the command rests {size}; a law moves with its "
                         "command only")
    free = _positions(law, command, law.friction(0.0, 0.0), file, line)
    if (off := float(np.abs(free - command)[1:].max())) > _CLOSE:
        raise refuse(f"leaves the stem {off:.3g} % from the command without friction; at S = J = 0 it follows")
    say("finite positions, the same for every call, never further from the command than f_s")
    say("without friction the stem follows, and it rests with its command")


def _positions(law: Law, command: FloatArray, friction: FloatArray, file: str, line: int) -> FloatArray:
    """Positions (n,) of one valve; an error of the step is a fault of its file."""
    try:
        return np.array(law.positions(command, friction, share=0.0)[:, 0])
    except StictionidError:
        raise
    except Exception as error:
        raise fault(file, max(line_in(error, file), line),
                    f"step() fails ({type(error).__name__}: {error}); correct this line") from None


def _command() -> FloatArray:
    """Triangles that shrink, steps both ways, and rests between them, in % (n,)."""
    t = np.arange(200.0)
    triangle = 50.0 + 8.0 * (1.0 - t / 300.0) * (4.0 * np.abs((t / 50.0 + 0.25) % 1.0 - 0.5) - 1.0)
    steps = np.repeat([50.0, 53.0, 47.0, 47.5, 60.0, 50.0], 6)
    return np.concatenate([triangle, np.full(5, triangle[-1]), steps])
